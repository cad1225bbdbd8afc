/* Plans of contacts by the engine, each from the beginning of the contact's segment. */

/* Puts a body into `row`, its size and least radius scaled, and its numbers to *next. */
static void put_body(component_t *c, long i, int side, double **next, double *row) {
  const model_t *m = c->model;
  const int has_lengths = surface_of(m, i, side)->name[0] != 0; /* else it is a user's */
  const double *given = c->value + m->contacts[i].parameters[side];
  double larger = 1.0, smaller = 1.0;
  memcpy(row, body_of(m, i, side), BODY_SIZE * sizeof *row);
  const double *own = m->scene + (long)row[B_NUMBERS];
  row[B_NUMBERS] = (double)(*next - c->scene);
  *(*next)++ = *own++; /* the sign */
  for (size_t j = 0; j < n_parameters(m, i, side); j++) {
    const double ratio = has_lengths && own[j] != 0.0 ? fabs(given[j] / own[j]) : 1.0;
    larger = j ? fmax(larger, ratio) : ratio, smaller = j ? fmin(smaller, ratio) : ratio;
    *(*next)++ = given[j];
  }
  row[B_SIZE] *= larger, row[B_LEAST_RADIUS] *= smaller;
}

static void put_window(double **next, double slot, double start, double stop, const double *value,
                       double scale) {
  double *row = *next;
  row[W_SLOT] = slot, row[W_START] = start, row[W_STOP] = stop;
  row[W_VALUE] = scale * value[0], row[W_VALUE + 1] = scale * value[1];
  *next += WINDOW_SIZE;
}

/* A plan of contact i from a segment; NULL, with c->failure, if there is none. */
static plan_t *plan_of(component_t *c, long i, const segment_t *s) {
  const model_t *m = c->model;
  const leg_t leg = leg_of(c, i, 0); /* only this leg's profile can be set */
  double *b = c->scene, *row = b + S_HEADER, *next = c->scratch;
  plan_t *found;
  memcpy(row, row_of(m, i), CONTACT_SIZE * sizeof *row);
  b[S_BEGIN] = s->begin, b[S_END] = s->end, b[S_GAIN] = s->gain;
  memcpy(b + (long)b[(long)row[K_LEGS] + G_PROFILE], leg.sigma, (size_t)leg.n * sizeof *b);
  put_body(c, i, 1, &next, b + S_OBJECT);
  put_body(c, i, 0, &next, row + K_FINGER);
  row[K_MOMENT] = s->row[K_MOMENT], row[K_FOLLOWS] = 0, row[K_WINDOWS] = (double)(next - b);
  memcpy(row + K_PLACE_1, s->row + K_PLACE_1, MOMENT_SIZE * sizeof *row);
  double *const first = next;
  for (long k = 0; k < m->n_windows; k++) {
    const window_t *w = m->windows + k;
    const double *v = window_values(c, k);
    if (w->contact == i && v[1] > s->begin)
      put_window(&next, (double)w->slot, v[0], v[1], v + 2, c->value[SCALE]);
  }
  for (int slot = 0; slot < 3; slot++)
    if (s->acting[2 * slot] != 0.0 || s->acting[2 * slot + 1] != 0.0)
      put_window(&next, slot, s->begin, s->end, s->acting + 2 * slot, 1.0);
  row[K_WINDOWS_SIZE] = (double)((next - first) / WINDOW_SIZE);
  UNTRAPPED(found = c->engine->plan(b, next - b, m->surfaces, &c->failure));
  return found;
}

/* The time that values of contact i are of, or the nearest one on its segment */
static double time_on(const component_t *c, long i) {
  return fmin(fmax(c->now->acts_at, c->segment[i].begin), c->segment[i].end);
}

/* Lets segment s begin at time t, from the plan's moment there. Returns nonzero if that fails. */
static int restart_segment(component_t *c, plan_t *plan, double t, segment_t *s) {
  int wrong;
  UNTRAPPED(wrong = c->engine->moments(plan, t, s->row + K_PLACE_1, &c->failure));
  if (!wrong) s->begin = t, s->row[K_MOMENT] = 1.0;
  return wrong;
}

#define BIT(group) (1u << (group))

static void put_states(const model_t *m, long i, const double *row, double *to) {
  const int frame[2] = {K_FRAME_1, K_FRAME_2}, place[2] = {K_PLACE_1, K_PLACE_2};
  for (int side = 0; side < 2; to += frame_of(m, i, side++)) {
    const size_t n = frame_of(m, i, side);
    memcpy(to, row + (n == 6 ? frame : place)[side], n * sizeof *to);
  }
  memcpy(to, row + K_W1, 4 * sizeof *to);
}

/* Evaluates groups of contact i at time t; returns nonzero if one of them has no values there. */
static int evaluate(component_t *c, long i, double t, unsigned groups) {
  plan_t *plan = c->live[i].plan;
  segment_t now;
  int wrong;
  double pose[16], *out[N_OUTPUTS] = {0};
  if (groups & BIT(OF_COORDINATES)) out[STATES] = values_of(c, i, OF_COORDINATES);
  if (groups & BIT(OF_SLIP)) out[SLIP] = values_of(c, i, OF_SLIP);
  if (groups & BIT(OF_TWIST)) out[TWIST] = values_of(c, i, OF_TWIST);
  if (groups & BIT(OF_POSE)) out[POSE] = pose;
  if (groups & BIT(OF_POINTS)) out[POINTS] = values_of(c, i, OF_POINTS);
  if (groups & BIT(OF_SLIP_SPEED)) out[SLIP_SPEED] = values_of(c, i, OF_SLIP_SPEED);
  UNTRAPPED(wrong = c->engine->evaluate_at(plan, t, out, &c->failure));
  if (wrong || (groups & BIT(OF_STATES) && restart_segment(c, plan, t, &now))) return 1;
  if (groups & BIT(OF_STATES)) put_states(c->model, i, now.row, values_of(c, i, OF_STATES));
  for (int r = 0; r < 3 && out[POSE]; r++) {
    memcpy(values_of(c, i, OF_POSE) + 3 * r, pose + 4 * r, 3 * sizeof *pose);
    values_of(c, i, OF_POSE)[9 + r] = pose[4 * r + 3];
  }
  return 0;
}

/* The shortest segment from t on */
static double least_span(double t) { return 8 * DBL_EPSILON * fmax(1.0, t); }

/* A segment's end; at an edge it is a bit later, as values at an edge are those after it. One that
   begins where sigma turns negative is as short as can be, and has the values there. */
static double end_of(const component_t *c, double begin, double end, double target) {
  end = fmin(fmax(end, target), c->now->limit);
  const double edge = edge_at(c, end, 1);
  if (isfinite(edge)) end = edge + fmax(0.01 * (edge - begin), least_span(edge));
  return fmax(fmin(end, c->now->limit), begin + least_span(begin));
}

/* Plans a segment to its end or, if that fails, to an earlier time not before the target. */
static plan_t *plan_ahead(component_t *c, long i, segment_t *s, double target) {
  const double end = s->end;
  plan_t *found = plan_of(c, i, s);
  for (int k = 0; k < 2 && !found; k++) {
    s->end = end_of(c, s->begin, k ? target : fmin(end, target + 0.125 * (end - target)), target);
    if (s->end < end) found = plan_of(c, i, s);
  }
  if (!found) s->end = end;
  return found;
}

/* Makes sure that contact i has a plan to the target: of its segment, or of a new one from now on.
   Returns nonzero, with the contact as it was, if there is none. */
static int plan_to(component_t *c, long i, double target) {
  live_t *k = c->live + i;
  segment_t *s = c->segment + i, next;
  if (!k->plan) k->plan = plan_ahead(c, i, s, fmax(target, s->begin));
  if (!k->plan) return 1;
  if (reached(s->end, target)) return 0;
  next = *s;
  if (restart_segment(c, k->plan, time_on(c, i), &next)) return 1;
  next.end = end_of(c, next.begin, next.begin + 2 * (next.begin - s->begin), target);
  plan_t *found = plan_ahead(c, i, &next, target);
  if (!found) return 1;
  drop_plan(c, i);
  k->plan = found, *s = next;
  return 0;
}

#define PAST_END "sigma is negative from t = %.9g s on; end there, or change the profile"
#define AT_REST                                                                                    \
  "sigma is zero, and an acceleration cannot act on a path that rests; accelerate "                \
  "while sigma > 0, or disturb the object's rates"

/* Logs why there is no plan to time t: `why` or, if that is NULL, the engine's failure. */
static status_t refuse_motion(component_t *c, status_t status, long i, double t, const char *why) {
  const failure_t *f = &c->failure;
  const char *side = why ? "" : f->side ? ".object" : ".finger"; /* of the engine's failure */
  const char *what = t > c->now->time ? "step to" : "values at";
  char where[160] = "";
  if (!why && f->code == STUCK && !f->by_length && f->t > 0)
    snprintf(where, sizeof where, ", at t = %.9g s", f->t);
  if (!why)
    why = f->code == NO_MEMORY  ? "there is no memory"
          : f->code == TOO_LONG ? "the path is so long that rounding would leave less "
                                  "than four digits of its position; make shorter steps"
          : f->at_rest          ? AT_REST
          : f->code == TOO_MANY_PANELS
              ? "a step is too long, it would take too many pieces of motion; make shorter steps"
              : "the path reaches a singular point of its chart or its surface, or moves too fast "
                "for double precision; set smaller inputs, end before or start elsewhere";
  return report(c, status, "contact[%ld]%s: no %s t = %.17g s%s: %s", i + 1, side, what, t, where,
                why);
}
