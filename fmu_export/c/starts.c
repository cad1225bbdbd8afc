/* Frames at the start, which belong to their surfaces, whatever is set. */

/* Puts a frame in space, whose start values anybody may have set, or a parameter of its surface,
   back on the surface. Returns what is wrong, or NULL. */
static const char *put_on_surface(component_t *c, long i, int side, double frame[6]) {
  const double *body = body_of_contact(c->model, i, side);
  const table_t *t = surface_of(c->model, i, side)->ambient[A_RESTORE];
  double *next = c->buffer, row[BODY_SIZE], moved = 1.0;
  put_body(c, body, &next, row);
  double *r = load_table(c, t);
  if (!r) return "there is no memory";
  memcpy(r, frame, 6 * sizeof *r);
  for (int k = 0; k < 50 && moved > 1e-12; k++) {
    c->engine->step(&(program_t){t->body, r});
    const double *y = r + t->first_out;
    moved = 0.0;
    for (int a = 0; a < 6; a++) moved += fabs(y[a] - r[a]) / (a < 3 ? body[Q_LENGTH] : 1.0);
    memcpy(r, y, 6 * sizeof *r);
  }
  if (!(moved <= 1e-12))
    return side ? "the object's frame is not on its surface"
                : "the finger's frame is not on its surface";
  memcpy(frame, r, 6 * sizeof *frame);
  return NULL;
}

/* A frame of the scene's own keeps its u, v and theta where parameters of its surface are set. */
static void keep_coordinates(component_t *c, long i, int side, double frame[6]) {
  const double *q = body_of_contact(c->model, i, side), *starts = section(c->model, D_STARTS);
  const layout_t *l = c->model->layout + i;
  const long at = (long)q[Q_VALUES], size = (long)q[Q_N_VALUES] * (long)sizeof *starts;
  const table_t *const *ambient = surface_of(c->model, i, side)->ambient;
  if (!ambient[A_START] || !memcmp(c->value + at, starts + at, (size_t)size)) return;
  if (memcmp(frame, starts + l->at[OF_STATES] + side * l->frame[0], 6 * sizeof *frame)) return;
  double place[3];
  for (int k = 0; k < 2; k++) {
    const table_t *t = ambient[k ? A_START : A_COORDINATES];
    c->buffer[0] = q[Q_SIGN];
    memcpy(c->buffer + 1, (k ? c->value : starts) + at, (size_t)size);
    double *r = load_table(c, t);
    if (!r) return;
    const double *y = r + t->first_out;
    memcpy(r, k ? place : frame, (k ? 3 : 6) * sizeof *r);
    if (!k) r[6] = r[7] = 0.0; /* velocity, which does not matter */
    c->engine->step(&(program_t){t->body, r});
    if (!k) place[0] = y[0], place[1] = y[1], place[2] = y[4];
    if (k && all_finite(y, 6)) memcpy(frame, y, 6 * sizeof *y);
  }
}

/* Both frames of contact i, where they are in space. Returns what is wrong, or NULL. */
static const char *put_frames(component_t *c, long i) {
  const layout_t *l = c->model->layout + i;
  const char *wrong = NULL;
  for (int side = 0; side < 2 && !wrong; side++) {
    double *frame = c->value + l->at[OF_STATES] + side * l->frame[0];
    if (l->frame[side] == 6)
      UNTRAPPED(keep_coordinates(c, i, side, frame); wrong = put_on_surface(c, i, side, frame));
  }
  return wrong;
}

/* Results before the start are those of the frames put on their surfaces; the frames themselves
   stay as they were set until then. */
static void find_before_start(component_t *c, long i) {
  const layout_t *l = c->model->layout + i;
  double *x = c->value + l->at[OF_STATES], kept[12];
  const size_t size = (size_t)(l->frame[0] + l->frame[1]) * sizeof *x;
  memcpy(kept, x, size);
  put_frames(c, i);
  find_system(c, i);
  memcpy(x, kept, size);
}
