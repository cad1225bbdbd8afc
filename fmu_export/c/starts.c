/* Puts the frames at the start onto their surfaces, whatever values an importer has set. Tangents
   are carried along if derivatives are asked for. */

/* Loads a table with constants that lie in c->scratch; returns its registers, which hold the point
   first. */
static double *load_table(component_t *c, const table_t *t) {
  double *r = c->registers;
  memcpy(r + t->n_in, c->scratch, (size_t)t->n_const * sizeof *r);
  c->engine->load(t, r);
  return r;
}

/* Loads a table of a body's surface; derive: whether its parameters have tangents. */
static double *load_surface(component_t *c, long i, int side, const table_t *t, int derive) {
  const size_t n = n_parameters(c->model, i, side);
  const int64_t at = c->model->contacts[i].parameters[side];
  c->scratch[0] = c->model->scene[(long)body_of(c->model, i, side)[B_NUMBERS]]; /* sign */
  memcpy(c->scratch + 1, c->value + at, n * sizeof *c->value);
  double *r = load_table(c, t);
  memset(c->surface_tangents, 0, (size_t)t->n_regs * sizeof *c->surface_tangents);
  if (derive) memcpy(c->surface_tangents + t->n_in + 1, c->tangents + at, n * sizeof *c->tangents);
  c->engine->step_tangents(&(program_t){t->prologue, r}, c->surface_tangents);
  return r;
}

/* Puts a frame in space onto its surface, as its start values or parameters of the surface may have
   been set. The scene's own frame keeps its u, v and theta, others move along the gradient. */
static const char *put_frame(component_t *c, long i, int side, double frame[6],
                             double (*tangents)[L]) {
  const double *starts = data_at(c->model, c->model->head->starts), *row = row_of(c->model, i);
  const table_t *const *tables = surface_of(c->model, i, side)->tables[IN_SPACE],
                       *t = tables[A_START];
  const double *own =
      starts + at_of(c->model, i, OF_STATES) + (side ? frame_of(c->model, i, 0) : 0);
  if (t && !memcmp(frame, own, 6 * sizeof *frame)) {
    double *r = load_surface(c, i, side, t, tangents != NULL);
    memcpy(r, row + (side ? K_PLACE_2 : K_PLACE_1), 2 * sizeof *r);
    r[2] = side ? 0.0 : -row[K_ANGLE];
    c->engine->step_tangents(&(program_t){t->body, r}, c->surface_tangents);
    const int found = all_finite(r + t->first_out, 6);
    if (found) memcpy(frame, r + t->first_out, 6 * sizeof *frame);
    for (int a = 0; a < 6 && tangents && found; a++)
      for (int k = 0; k < L; k++) tangents[a][k] += c->surface_tangents[t->first_out + a][k];
  }
  double *r = load_surface(c, i, side, t = tables[A_RESTORE], tangents != NULL), change = 1.0;
  memcpy(r, frame, 6 * sizeof *r);
  if (tangents) memcpy(c->surface_tangents, tangents, 6 * sizeof *tangents);
  for (int k = 0; k < 50 && change > 1e-12; k++) {
    c->engine->step_tangents(&(program_t){t->body, r}, c->surface_tangents);
    const double *y = r + t->first_out;
    change = 0.0;
    for (int a = 0; a < 6; a++)
      change += fabs(y[a] - r[a]) / (a < 3 ? body_of(c->model, i, side)[B_SIZE] : 1.0);
    memcpy(r, y, 6 * sizeof *r);
    memcpy(c->surface_tangents, c->surface_tangents + t->first_out, 6 * sizeof *tangents);
  }
  if (!(change <= 1e-12))
    return side ? "the object's frame is not on its surface"
                : "the finger's frame is not on its surface";
  memcpy(frame, r, 6 * sizeof *frame);
  if (tangents) memcpy(tangents, c->surface_tangents, 6 * sizeof *tangents);
  return NULL;
}

/* u v theta of a frame in space, in principal values */
static void find_place(component_t *c, long i, int side, const double frame[6], double place[3]) {
  const table_t *t = surface_of(c->model, i, side)->tables[IN_SPACE][M_COORDINATES];
  double *r = load_surface(c, i, side, t, 0);
  memset(r, 0, (size_t)t->n_in * sizeof *r); /* no velocity */
  memcpy(r, frame, 6 * sizeof *r);
  UNTRAPPED(c->engine->step(&(program_t){t->body, r}));
  place[0] = r[t->first_out], place[1] = r[t->first_out + 1], place[2] = r[t->first_out + 4];
}

/* Puts those frames of contact i among these states onto their surfaces that are in space.
   tangents: of the states, or NULL. */
static const char *put_frames(component_t *c, long i, double *states, double (*tangents)[L]) {
  const char *wrong = NULL;
  for (int side = 0; side < 2 && !wrong; side++) {
    const size_t n = frame_of(c->model, i, side);
    if (n == 6) UNTRAPPED(wrong = put_frame(c, i, side, states, tangents));
    states += n, tangents = tangents ? tangents + n : NULL;
  }
  return wrong;
}
