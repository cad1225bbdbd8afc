/* What lets a contact go on otherwise than planned: inputs, the gain, what was measured of it. */

/* Whether an input accelerates a path that rests; it has no rates, and can be looked at without. */
static int pushed_at_rest(const component_t *c, long i) {
  for (int j = 0; j < 4; j++)
    if (c->value[c->model->layout[i].at[OF_INPUTS] + j] != 0.0) return rests(c, i);
  return 0;
}

/* Loads a table; returns its registers, which hold the point first, or NULL without memory. */
static double *load_table(component_t *c, const table_t *t, const double *constants) {
  if (c->room < t->n_regs) {
    free(c->registers);
    c->registers = malloc((size_t)t->n_regs * sizeof *c->registers);
    c->room = c->registers ? t->n_regs : 0;
  }
  double *r = c->registers;
  if (!r) return NULL;
  memset(r, 0, (size_t)t->n_in * sizeof *r);
  memcpy(r + t->n_in, constants, (size_t)t->n_const * sizeof *r);
  if (t->n_lit) memcpy(r + t->first_lit, t->literals, (size_t)t->n_lit * sizeof *r);
  c->engine->step(&(program_t){t->prologue, r});
  return r;
}

/* A chart's rates as a velocity in its contact frame, M (u', v'); not finite at poles */
static void velocity_of(component_t *c, long i, int side, const double *place, const double *rate,
                        double *out) {
  const surface_t *s = surface_of(c->model, i, side);
  const int ambient = !s->chart[C_VECTOR]; /* (x, p) does not tell the covers of a chart apart */
  double in[6] = {place[0], place[1], 0.0}, body[BODY_SIZE], *next = c->buffer, *r;
  put_body(c, body_of_contact(c->model, i, side), &next, body);
  out[0] = out[1] = NAN;
  for (int last = !ambient; last < 2; last++) {
    const table_t *t = !last     ? s->ambient[A_START]
                       : ambient ? s->ambient[A_VECTOR]
                                 : s->chart[C_VECTOR];
    const int n = last && ambient ? 6 : 3;
    if (!(r = load_table(c, t, c->buffer))) return;
    memcpy(r, in, (size_t)n * sizeof *r);
    if (last) memcpy(r + n, rate, 2 * sizeof *r);
    c->engine->step(&(program_t){t->body, r});
    memcpy(last ? out : in, r + t->first_out, (last ? 2 : 6) * sizeof *r);
  }
}

/* places among the inputs of what is measured: behind the trigger states, or twist and pose, that
   as the rows of a rotation and a position */
enum { TRIGGER, MEASURED };
enum { U1, V1, DU1, DV1, U2, V2, DU2, DV2, PSI, N_STATES };
enum { ROTATION = 6, POSITION = 15, TWIST_AND_POSE = 18 };

/* Newton's method of contact_sensor.py for the states of contact i, from places near it, or from
   coordinates. Returns what is wrong, or NULL. */
static const char *sense(component_t *c, long i, const double *given, const double *points,
                         double states[N_STATES]) {
  const double *row = contact_of(c->model, i), *limit = section(c->model, D_SENSOR);
  const table_t *t = c->model->systems + (long)row[P_SENSOR];
  double *next = c->buffer, body[BODY_SIZE];
  for (int side = 0; side < 2; side++)
    put_body(c, body_of_contact(c->model, i, side), &next, body), *next++ = body[B_LENGTH];
  double *const r = load_table(c, t, c->buffer), *x = r;
  if (!r) return "there is no memory";
  const double *y = r + t->first_out;
  for (int side = 0; side < 2; side++) {
    const long n = (long)row[P_UNKNOWN_1 + side];
    memcpy(x, n == 3 ? points + 3 * side : states + 4 * side, (size_t)n * sizeof *x), x += n;
  }
  const long unknowns = x - r;
  for (int k = 0; k < 3; k++, x += 4)
    memcpy(x, given + ROTATION + 3 * k, 3 * sizeof *x), x[3] = given[POSITION + k];
  memcpy(x, given, 6 * sizeof *x);
  for (int k = 0;; k++) {
    c->engine->step(&(program_t){t->body, r});
    if (!(y[unknowns] > limit[N_SMALL]) || k >= (int)limit[N_MOST_STEPS]) break;
    memcpy(r, y, (size_t)unknowns * sizeof *r);
  }
  y += unknowns; /* length of the step, relative curvature, states */
  memcpy(states, y + 2, N_STATES * sizeof *states);
  if (fabs(y[1]) <= limit[N_CONFORMAL])
    return "the surfaces conform at the contact, so that a twist does not tell where they touch; "
           "measure states";
  if (!(y[0] <= limit[N_SETTLED]))
    return "near its planned place no common normal of the surfaces is found at the measured pose; "
           "give X_OF, the finger's frame in the object's, or resynchronise sooner";
  return all_finite(states, N_STATES) ? NULL
                                      : "it is measured at a pole or an umbilic of a chart, where "
                                        "there is no contact frame; measure a moment later";
}

/* States of contact i from what was measured, on the side of its charts that it is planned on.
   Returns what is wrong, or NULL. */
static const char *read_measured(component_t *c, long i, double states[N_STATES]) {
  const layout_t *l = c->model->layout + i;
  const double *given = c->value + l->at[OF_MEASURED] + MEASURED;
  const int posed = l->at[OF_STATES] - l->at[OF_MEASURED] > TWIST_AND_POSE;
  double planned[N_STATES] = {0}, points[6], *out[N_OUTPUTS] = {0};
  int sided =
      posed || surface_of(c->model, i, 0)->double_cover || surface_of(c->model, i, 1)->double_cover;
  memcpy(states, given, N_STATES * sizeof *states);
  if (sided) out[STATES] = planned;
  if (posed) out[POINTS] = points;
  if (sided && !cover(c, i, c->now->acts_at)) {
    commit(c, i, 1);
    sided = !look_at(c, i, out);
  }
  if (posed && !sided) return "its plan has no coordinates there; measure a moment later";
  if (posed) memcpy(states, planned, sizeof planned);
  const char *wrong = posed ? sense(c, i, given, points, states) : NULL;
  for (int side = 0; side < 2 && sided && !wrong; side++) {
    double *own = states + 4 * side, place[5] = {own[0], own[1], own[2], own[3], states[PSI]};
    const double beside[3] = {planned[4 * side], planned[4 * side + 1], planned[PSI]};
    c->engine->wind(surface_of(c->model, i, side), beside, place);
    memcpy(own, place, 4 * sizeof *own), states[PSI] = place[4];
  }
  return wrong;
}

/* Contact i goes on from what was measured. Returns not 0, with c->unmeasured, where that is no
   place to start from. */
static int resynchronize(component_t *c, long i, segment_t *s) {
  const double sigma = sigma_now(c, i);
  double *to = s->row - K_PLACE_1, acting[DISTURBANCES], x[N_STATES] = {0}, w[2], y[2];
  fenv_t traps;
  feholdexcept(&traps);
  c->unmeasured = sigma > 0 ? read_measured(c, i, x)
                            : "sigma is zero, so that rates do not determine path velocities; "
                              "measure while sigma > 0";
  acting_on(c, i, acting);
  const double own[2] = {x[DU2] - acting[4], x[DV2] - acting[5]}; /* what drives the feedback */
  if (!c->unmeasured) {
    velocity_of(c, i, 0, x + U1, x + DU1, w), velocity_of(c, i, 1, x + U2, own, y);
    if (!all_finite(w, 2) || !all_finite(y, 2))
      c->unmeasured = "it is measured at a singular point of a chart; measure a moment later";
  }
  fesetenv(&traps);
  c->failure = (failure_t){.code = STUCK};
  if (c->unmeasured) return 1;
  memset(s->row, 0, sizeof s->row);
  memcpy(to + K_PLACE_1, x + U1, 2 * sizeof *x);
  memcpy(to + K_PLACE_2, x + U2, 2 * sizeof *x);
  to[K_ANGLE] = x[PSI];
  for (int a = 0; a < 2; a++) to[K_W1 + a] = w[a] / sigma, to[K_Y + a] = y[a] / sigma;
  s->begin = c->now->acts_at, s->moment = s->frames = 0.0;
  return 0;
}

/* Contacts whose inputs or gain are no longer those of their segment begin another. Returns 0, or
   with c->failure which cannot, from 1 on. */
static int settle(component_t *c) {
  memory_t *now = c->now;
  if (now->settled) return 0;
  int rest = 0;
  for (long i = 0; i < c->model->n_contacts; i++) {
    segment_t *s = c->segment + i;
    const int pushed = pushed_at_rest(c, i);
    rest |= pushed;
    const layout_t *l = c->model->layout + i;
    double acting[DISTURBANCES];
    for (int j = 0; j < DISTURBANCES; j++)
      acting[j] = pushed && j < 4 ? 0.0 : c->value[l->at[OF_INPUTS] + j];
    const int measures = l->at[OF_MEASURED] < l->at[OF_STATES];
    const double heard = measures ? c->value[l->at[OF_MEASURED] + TRIGGER] : 0.0;
    const int again = heard != 0.0 && heard != s->trigger;
    s->trigger = heard;
    if (!again && s->gain == c->value[GAIN] && !memcmp(s->acting, acting, sizeof acting)) continue;
    const double at = now->acts_at, lasted = at - s->begin;
    if (again || !reached(s->begin, at)) {
      if (again) {
        if (resynchronize(c, i, s)) return (int)i + 1;
      } else {
        if (cover(c, i, at)) return (int)i + 1;
        commit(c, i, 1);
        if (go_on(c, i, c->live[i].plan, time_on(c, i), s)) return (int)i + 1;
      }
      s->end = at + lasted; /* where events follow each other closely, it is no use to plan far */
    }
    s->end = -fabs(s->end);
    s->gain = c->value[GAIN];
    memcpy(s->acting, acting, sizeof acting);
    drop_plans(c, i);
  }
  forget_values(c);
  now->settled = !rest;
  return 0;
}
