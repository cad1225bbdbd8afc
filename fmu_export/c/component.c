/* Values and steps over the engine's plans: see component.h. */
#include "component.h"

#include <fenv.h>
#include <stdarg.h>

#include "model.c"
/* */
#include "profile.c"
/* */
#include "system.c"

#define MOST_PANELS 20000.0 /* of one plan: a second of work, kilometres of path */

/* groups of results, bits of live_t.valid */
enum {
  OF_STATE = 1,
  OF_COORDINATES = 2,
  OF_RATES = 4,
  OF_SLIPS = 8,
  OF_TWISTS = 16,
  OF_POSES = 32,
  OF_PLACES = 64,
  OF_CONDITION = 128,
  ALL_RESULTS = 255
};

static status_t report(component_t *c, status_t status, const char *category, const char *format,
                       ...) {
  char text[512];
  va_list arguments;
  va_start(arguments, format);
  vsnprintf(text, sizeof text, format, arguments);
  va_end(arguments);
  c->report(c, status, category, text);
  return status;
}

/* ---- memory ---- */

static size_t memory_size(const model_t *m) {
  return sizeof(memory_t) + (size_t)m->n_values * sizeof(double) +
         (size_t)m->n_contacts * sizeof(segment_t);
}

static void drop_plans(component_t *c, long i) {
  live_t *k = c->live + i;
  c->engine->drop(k->plan), c->engine->drop(k->next);
  k->plan = k->next = NULL;
}

static void free_component(component_t *c) {
  for (long i = 0; c->live && i < c->model->n_contacts; i++) {
    drop_plans(c, i);
    free(c->live[i].registers);
  }
  free(c->now), free(c->live), free(c->buffer), free(c->seed), free(c->grown), free(c->tangents);
  free_model(c->model);
}

/* Nothing is known any more of what was planned. */
static void forget(component_t *c) {
  for (long i = 0; i < c->model->n_contacts; i++) {
    live_t *k = c->live + i;
    drop_plans(c, i);
    k->valid = k->asked = k->before = 0, k->prepared = k->anchored = 0;
    k->warned[0] = k->warned[1] = 0;
  }
}

static void reset(component_t *c, int stepping) {
  const model_t *m = c->model;
  memset(c->now, 0, memory_size(m));
  memcpy(c->value, section(m, D_STARTS), (size_t)m->n_values * sizeof(double));
  c->now->stepping = stepping, c->now->phase = INSTANTIATED;
  c->now->stop_time = c->now->limit = HUGE_VAL;
  forget(c);
}

/* Returns NULL, or what is wrong. */
static const char *make_component(component_t *c, const char *resources) {
  const char *wrong;
  if (!(c->model = read_model(resources, &wrong))) return wrong;
  const model_t *m = c->model;
  const size_t values = (size_t)m->n_values * sizeof(double);
  size_t registers = 1, legs = 0;
  for (long i = 0; i < m->n_contacts; i++) {
    const double *row = contact_of(m, i), size = m->data[(long)row[P_LEGS] + G_PROFILE_SIZE];
    legs = (size_t)fmax((double)legs, row[P_N_LEGS] * (LEG_SIZE + size));
  }
  c->engine = contact_engine();
  c->now = calloc(1, memory_size(m)), c->live = calloc((size_t)m->n_contacts, sizeof *c->live);
  c->buffer = malloc((legs + (size_t)(S_HEADER + m->n_values + CONTACT_SIZE +
                                      WINDOW_SIZE * (m->n_windows + 3) + 4)) *
                     sizeof(double));
  c->seed = calloc(1, values), c->grown = calloc(1, values);
  for (long i = 0; c->live && i < m->n_contacts; i++) {
    const table_t *t = system_of(m, i);
    if ((size_t)t->n_regs > registers) registers = (size_t)t->n_regs;
    c->live[i].registers = calloc((size_t)t->n_regs, sizeof(double));
    if (!c->live[i].registers) return "no memory";
    memcpy(c->live[i].registers + t->first_lit, t->literals, (size_t)t->n_lit * sizeof(double));
  }
  c->tangents = malloc(registers * sizeof *c->tangents);
  if (!c->now || !c->live || !c->buffer || !c->seed || !c->grown || !c->tangents)
    return "no memory";
  c->value = (double *)(c->now + 1), c->segment = (segment_t *)(c->value + m->n_values);
  return NULL;
}

/* ---- a contact for the engine ---- */

/* The body's row of the engine's buffer; its numbers go to *next. Scales follow its lengths. */
static void put_body(component_t *c, const double *q, double **next, double *row) {
  const long n = (long)q[Q_N_VALUES], at = (long)q[Q_VALUES];
  const double *starts = section(c->model, D_STARTS), *given = c->value + at;
  const surface_t *s = c->model->surfaces[(long)q[Q_SURFACE]];
  double larger = 1.0, smaller = 1.0;
  row[B_SURFACE] = q[Q_SURFACE], row[B_NUMBERS] = (double)(*next - c->buffer);
  *(*next)++ = q[Q_SIGN];
  for (long j = 0; j < n; j++) {
    const double ratio =
        s->name[0] && starts[at + j] != 0.0 ? fabs(given[j] / starts[at + j]) : 1.0;
    larger = j ? fmax(larger, ratio) : ratio, smaller = j ? fmin(smaller, ratio) : ratio;
    *(*next)++ = given[j];
  }
  row[B_LENGTH] = q[Q_LENGTH] * larger, row[B_BEND] = q[Q_BEND] * smaller;
  row[B_REACH] = q[Q_REACH];
}

static void put_window(double **next, double slot, double start, double stop, const double *value,
                       double scale) {
  double *row = *next;
  row[W_SLOT] = slot, row[W_START] = start, row[W_STOP] = stop;
  row[W_VALUE] = scale * value[0], row[W_VALUE + 1] = scale * value[1];
  *next += WINDOW_SIZE;
}

/* Whether sigma of contact i is all but zero somewhere between two times */
static int rests_between(const component_t *c, long i, double from, double to) {
  double at[2 * MAX_PROFILE + 2];
  for (long k = 0, count = n_legs(c->model, i); k < count; k++) {
    const leg_t leg = leg_of(c, i, k);
    const double first = fmax(from, leg.start);
    const double last = k + 1 < count ? fmin(to, leg_of(c, i, k + 1).start) : to;
    double largest = 0.0;
    if (!(first < last)) continue;
    const long n = signs_of(&leg, 1, first, last, at + 1);
    at[0] = first, at[n + 1] = last;
    for (long j = 0; j < leg.n; j++) largest = fmax(largest, fabs(leg.sigma[j]));
    for (long j = 0; j < n + 2; j++)
      if (horner(leg.sigma, leg.n, at[j] - leg.start) <= 1e-9 * largest) return 1;
  }
  return 0;
}

/* The engine's plan of contact i under a segment; NULL, with c->failure, where there is none. */
static plan_t *plan_of(component_t *c, long i, const segment_t *s) {
  const model_t *m = c->model;
  double *b = c->buffer, *next = b + S_HEADER, row[CONTACT_SIZE] = {0};
  fenv_t traps;
  c->failure = (failure_t){.code = STUCK};
  if (!(s->end > s->begin)) return NULL;
  memset(b, 0, S_HEADER * sizeof *b);
  b[S_VERSION] = SCENE_VERSION, b[S_CONTACTS] = 1, b[S_TOLERANCE] = m->data[D_TOLERANCE];
  b[S_PANELS] = MOST_PANELS;
  b[S_BEGIN] = s->begin, b[S_END] = s->end;
  b[S_GAIN] = s->gain, b[S_GAIN_POWER] = m->data[D_POWER], b[S_MAKES_UP] = m->data[D_MAKES_UP];
  row[K_LEGS] = (double)(next - b), row[K_LEGS_SIZE] = (double)n_legs(m, i);
  next += n_legs(m, i) * LEG_SIZE;
  for (long k = 0; k < n_legs(m, i); k++) {
    const leg_t leg = leg_of(c, i, k);
    double *to = b + (long)row[K_LEGS] + k * LEG_SIZE;
    to[G_START] = leg.start, to[G_TURN] = leg.turn[0], to[G_TURN + 1] = leg.turn[1];
    to[G_PROFILE] = (double)(next - b), to[G_PROFILE_SIZE] = (double)leg.n;
    memcpy(next, leg.sigma, (size_t)leg.n * sizeof *next), next += leg.n;
  }
  put_body(c, m->data + D_OBJECT, &next, b + S_OBJECT);
  put_body(c, contact_of(m, i) + P_FINGER, &next, row + K_FINGER);
  row[K_MOMENT] = s->moment, row[K_FRAMES] = s->frames, row[K_WINDOWS] = (double)(next - b);
  memcpy(row + K_PLACE_1, s->row, sizeof s->row);
  double *const first = next;
  for (long k = 0; k < m->n_windows; k++) {
    const double *w = window_of(c, k), *v = window_values(c, k);
    if ((long)w[V_CONTACT] == i && v[1] > s->begin)
      put_window(&next, w[V_SLOT], v[0], v[1], v + 2, c->value[(long)m->data[D_SCALE]]);
  }
  for (int slot = 0; slot < 3; slot++)
    if (s->acting[2 * slot] != 0.0 || s->acting[2 * slot + 1] != 0.0)
      put_window(&next, slot, s->begin, s->end, s->acting + 2 * slot, 1.0);
  row[K_WINDOWS_SIZE] = (double)((next - first) / WINDOW_SIZE);
  for (const double *w = first; w < next; w += WINDOW_SIZE) {
    const double from = fmax(w[W_START], s->begin), to = fmin(w[W_STOP], s->end);
    if (w[W_SLOT] > 1 || from >= to || (w[W_VALUE] == 0.0 && w[W_VALUE + 1] == 0.0)) continue;
    if (!rests_between(c, i, from, to)) continue;
    c->failure = (failure_t){.code = STUCK, .pushed = 1}; /* the engine would try for long */
    return NULL;
  }
  b[S_AT_CONTACTS] = (double)(next - b);
  memcpy(next, row, sizeof row), next += CONTACT_SIZE;
  feholdexcept(&traps); /* what the engine looks at may be no number; importers may trap that */
  plan_t *found = c->engine->plan(b, next - b, m->surfaces, &c->failure);
  fesetenv(&traps);
  return found;
}

/* Where contact i has come to by a plan; returns not 0 where that cannot be told. */
static int moment_at(component_t *c, plan_t *plan, double t, double *out) {
  fenv_t traps;
  feholdexcept(&traps);
  const int wrong = c->engine->moments(plan, t, out, &c->failure);
  fesetenv(&traps);
  return wrong;
}

/* A segment goes on at time t from where a plan of it has come to. */
static int go_on(component_t *c, long i, plan_t *plan, double t, segment_t *s) {
  double m[MOMENT_SIZE];
  if (moment_at(c, plan, t, m)) return 1;
  double *to = s->row - K_PLACE_1; /* indices of the engine's contact */
  s->begin = t, s->moment = 1.0, s->frames = 0.0;
  for (int side = 0; side < 2; side++)
    if (surface_of(c->model, i, side)->ambient[A_MOTION]) s->frames += 1 << side;
  memcpy(to + K_PLACE_1, m + M_PLACE_1, 6 * sizeof *m);
  to[K_ANGLE] = m[M_ANGLE];
  memcpy(to + K_W1, m + M_W1, 4 * sizeof *m);
  memcpy(to + K_FRAME_1, m + M_FRAME_1, 12 * sizeof *m);
  return 0;
}

/* A segment's end, at an edge a bit later: values there are those after it. */
static double end_of(const component_t *c, double begin, double end, double target) {
  end = fmin(fmax(end, target), c->now->limit);
  const double edge = snapped(c, end);
  for (long k = 0; k < n_edges(c->model); k++)
    if (edge_of(c, k) == edge) return fmin(edge + 0.01 * (edge - begin), c->now->limit);
  return end;
}

/* Plans a segment to its end; to the target at least, where something stands in the way behind. */
static plan_t *plan_ahead(component_t *c, long i, segment_t *s, double target) {
  const double end = s->end;
  plan_t *found = plan_of(c, i, s);
  for (int k = 0; k < 2 && !found; k++) {
    s->end = end_of(c, s->begin, k ? target : fmin(end, target + 0.125 * (end - target)), target);
    if (s->end < end && s->end > s->begin) found = plan_of(c, i, s);
  }
  if (!found) s->end = -end;
  return found;
}

/* Sees to a plan of contact i that reaches the target, in live_t.next where it is another
   segment's. Returns not 0 where there is none. */
static int cover(component_t *c, long i, double target) {
  live_t *k = c->live + i;
  segment_t *s = c->segment + i;
  const double least = s->begin + 8 * DBL_EPSILON * fmax(1.0, s->begin);
  if (!k->plan) {
    if (s->end < s->begin) s->end = end_of(c, s->begin, fmax(-s->end, least), target);
    k->plan = plan_ahead(c, i, s, fmax(target, least)), k->anchored = 0;
    if (!k->plan) return 1;
  }
  k->following = *s;
  plan_t *last = k->plan;
  for (int tries = 0; !reached(k->following.end, target); tries++) {
    c->failure = (failure_t){.code = TOO_MANY_PANELS};
    if (tries > 60) return 1;
    segment_t next = k->following;
    const double at = next.end;
    if (go_on(c, i, last, at, &next)) return 1;
    next.end = end_of(c, at, at + 2 * (at - k->following.begin),
                      fmin(target, at + 1e3 * c->model->data[D_HORIZON]));
    plan_t *found = plan_ahead(c, i, &next, fmin(target, next.end));
    if (!found) return 1;
    c->engine->drop(k->next);
    k->next = last = found, k->next_anchored = 0, k->following = next;
  }
  return 0;
}

static void commit(component_t *c, long i, int taken) {
  live_t *k = c->live + i;
  if (!k->next) return;
  if (taken) {
    c->engine->drop(k->plan);
    k->plan = k->next, k->anchored = 0;
    c->segment[i] = k->following;
  } else {
    c->engine->drop(k->next);
  }
  k->next = NULL;
}

/* ---- what acts ---- */

#define AT_REST                                                                                    \
  "sigma is zero, and an acceleration cannot act on a path that rests; accelerate "                \
  "while sigma > 0, or disturb the object's rates"

/* Whether an input accelerates a path that rests; it has no rates, and can be looked at without. */
static int pushed_at_rest(const component_t *c, long i) {
  for (int j = 0; j < 4; j++)
    if (c->value[c->model->layout[i].input + j] != 0.0) return rests(c, i);
  return 0;
}

/* A chart's rates as a velocity in its contact frame, M (u', v'); not finite at poles */
static void velocity_of(component_t *c, long i, int side, const double *place, const double *rate,
                        double *out) {
  const double *q = body_of_contact(c->model, i, side);
  const surface_t *s = surface_of(c->model, i, side);
  const long n = (long)q[Q_N_VALUES];
  double in[8] = {place[0], place[1], 0.0}, *numbers = c->buffer;
  numbers[0] = q[Q_SIGN];
  memcpy(numbers + 1, c->value + (long)q[Q_VALUES], (size_t)n * sizeof *numbers);
  const int ambient = !s->chart[C_VECTOR]; /* (x, p) does not tell the covers of a chart apart */
  if (ambient) c->engine->run(s->ambient[A_START], 1, in, numbers, 0, in);
  memcpy(in + (ambient ? 6 : 3), rate, 2 * sizeof *rate);
  c->engine->run(ambient ? s->ambient[A_VECTOR] : s->chart[C_VECTOR], 1, in, numbers, 0, out);
}

/* Contact i goes on from what was measured. Returns not 0 where that is no place to start from. */
static int resynchronize(component_t *c, long i, segment_t *s) {
  const double *x = c->value + c->model->layout[i].measured, sigma = sigma_now(c, i);
  double *to = s->row - K_PLACE_1, acting[DISTURBANCES], w[2], y[2];
  acting_on(c, i, acting);
  const double own[2] = {x[DU2] - acting[4], x[DV2] - acting[5]}; /* what drives the feedback */
  fenv_t traps;
  feholdexcept(&traps);
  velocity_of(c, i, 0, x + U1, x + DU1, w);
  velocity_of(c, i, 1, x + U2, own, y);
  fesetenv(&traps);
  c->failure = (failure_t){.code = STUCK};
  if (!(sigma > 0) || !all_finite(w, 2) || !all_finite(y, 2)) return 1;
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
    double acting[DISTURBANCES];
    for (int j = 0; j < DISTURBANCES; j++)
      acting[j] = pushed && j < 4 ? 0.0 : c->value[c->model->layout[i].input + j];
    const int measures = c->model->data[D_MEASURED] > 0;
    const double heard = measures ? c->value[c->model->layout[i].measured + TRIGGER] : 0.0;
    const int again = heard != 0.0 && heard != s->trigger;
    s->trigger = heard;
    if (!again && s->gain == c->value[GAIN] && !memcmp(s->acting, acting, sizeof acting)) continue;
    const double at = now->acts_at, lasted = at - s->begin;
    if (again) {
      if (resynchronize(c, i, s)) return (int)i + 1;
      s->end = -(at + 0.02 * c->model->data[D_HORIZON]); /* more may be measured soon */
    } else if (!reached(s->begin, at)) {
      if (cover(c, i, at)) return (int)i + 1;
      commit(c, i, 1);
      if (go_on(c, i, c->live[i].plan, fmin(fmax(at, s->begin), s->end), s)) return (int)i + 1;
      s->end =
          -(at + lasted); /* where events follow each other closely, it is no use to plan far */
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

/* Why the engine has no plan, as a line in the log. */
static status_t refuse_motion(component_t *c, long i, const char *what, double target) {
  const failure_t *f = &c->failure;
  const char *side = f->side ? "object" : "finger";
  char where[160] = "";
  if (f->code == STUCK && !f->by_length && f->t > 0)
    snprintf(where, sizeof where, ", at t = %.9g s", f->t);
  const char *why =
      f->code == NO_MEMORY  ? "there is no memory"
      : f->code == TOO_LONG ? "the path is so long that rounding would leave less "
                              "than four digits of its position; make shorter steps"
      : f->code == TOO_MANY_PANELS
          ? "a step is too long, it would take more than 20000 pieces of motion; make shorter steps"
      : f->pushed && f->value <= 1e-5
          ? AT_REST
          : "the path reaches a singular point of its chart or its surface, or moves too fast for "
            "double precision; set smaller inputs, end before or start elsewhere";
  return report(c, DISCARD, "logStatusDiscard", "contact[%ld].%s: no %s to t = %.17g s%s: %s",
                i + 1, side, what, target, where, why);
}

/* ---- results of plans ---- */

/* Evaluates groups of contact i at the present time into its values; returns not 0 where a group
   has none. */
static int look(component_t *c, long i, unsigned groups) {
  const model_t *m = c->model;
  const layout_t *l = m->layout + i;
  live_t *k = c->live + i;
  const segment_t *s = c->segment + i;
  double states[9], points[6], pose[16], carried[6], moment[MOMENT_SIZE], *v = c->value;
  double *out[N_OUTPUTS] = {0};
  const double t = fmin(fmax(c->now->acts_at, s->begin), s->end);
  fenv_t traps;
  int wrong = 0;
  if (groups & (m->frames ? OF_COORDINATES : OF_STATE)) out[STATES] = states;
  if (groups & OF_STATE && !m->frames) out[CARRIED] = carried;
  if (groups & OF_SLIPS) out[SLIP] = v + l->slip;
  if (groups & OF_TWISTS) out[TWIST] = v + l->twist;
  if (groups & OF_POSES) out[POSE] = pose;
  if (groups & OF_PLACES) out[POINTS] = points;
  if (groups & OF_CONDITION) out[SLIP_SPEED] = v + l->condition + 1;
  feholdexcept(&traps);
  if (!k->anchored && groups & (OF_STATE | OF_COORDINATES | OF_SLIPS)) {
    wrong = c->engine->anchor(k->plan, &c->failure);
    k->anchored = !wrong;
  }
  if (!wrong) wrong = c->engine->look(k->plan, t, out, &c->failure);
  if (!wrong && groups & OF_STATE && m->frames)
    wrong = c->engine->moments(k->plan, t, moment, &c->failure);
  fesetenv(&traps);
  if (wrong) return wrong;
  if (groups & OF_STATE && !m->frames) {
    for (int side = 0; side < 2; side++) {
      double *state = v + l->state + BODY * side, *rate = v + l->rate + BODY * side;
      memcpy(state, states + 4 * side, 2 * sizeof *state);
      memcpy(rate, states + 4 * side + 2, 2 * sizeof *rate);
      memcpy(state + FRAME_ANGLE, carried + 3 * side, 3 * sizeof *state);
    }
    v[l->state + ANGLE] = states[8];
  }
  if (groups & OF_COORDINATES && m->frames) memcpy(v + l->coordinates, states, sizeof states);
  if (groups & OF_STATE && m->frames) {
    double *to = v + l->state;
    for (int side = 0; side < 2; to += l->frame[side++])
      memcpy(to,
             moment + (l->frame[side] == 6 ? side ? M_FRAME_2 : M_FRAME_1
                       : side              ? M_PLACE_2
                                           : M_PLACE_1),
             (size_t)l->frame[side] * sizeof *to);
    memcpy(to, moment + M_W1, 4 * sizeof *to);
  }
  for (int r = 0; r < 3 && groups & OF_POSES; r++) {
    memcpy(v + l->pose + 3 * r, pose + 4 * r, 3 * sizeof *v);
    v[l->pose + 9 + r] = pose[4 * r + 3];
  }
  if (groups & OF_PLACES) memcpy(v + l->points, points, sizeof points);
  return 0;
}

static void no_values(component_t *c, long i, unsigned groups) {
  const layout_t *l = c->model->layout + i;
  const long at[] = {l->state, l->coordinates, l->rate,   l->slip,
                     l->twist, l->pose,        l->points, l->condition};
  const long to[] = {l->rate, l->slip,   l->coordinates, l->twist,
                     l->pose, l->points, l->condition,   l->end};
  for (int g = 0; g < 8; g++)
    for (long j = at[g]; groups >> g & 1 && j < to[g]; j++) c->value[j] = NAN;
}

/* The rates that are not those of coordinates, from the equations; sigma and what follows from it
 */
static void find_rates(component_t *c, long i, unsigned groups) {
  const layout_t *l = c->model->layout + i;
  const double *found = run_system(c, i);
  for (int j = 0; j < 4 && groups & OF_CONDITION; j++)
    if (j != 1) c->value[l->condition + j] = found[l->condition - l->rate + j];
  if (!(groups & OF_RATES)) return;
  for (long j = 0; j < l->states; j++)
    if (c->model->frames || j % BODY > 1 || j == ANGLE) c->value[l->rate + j] = found[j];
}

/* Brings groups of contact i up to date; with them goes what was asked for at the time before. */
static status_t find(component_t *c, long i, unsigned groups) {
  live_t *k = c->live + i;
  if (SYSTEM(c->now)) {
    if (!k->valid && groups) find_system(c, i), k->valid = ALL_RESULTS;
    return OK;
  }
  if (groups & OF_RATES) groups |= OF_STATE;
  k->asked |= groups & ~k->valid;
  const unsigned missing = groups & ~k->valid, asked = missing & ~OF_RATES;
  const unsigned more = (k->before & ~k->valid & ~OF_RATES) | asked; /* in one pass */
  if (asked) {
    if (!k->plan && cover(c, i, c->now->time)) return refuse_motion(c, i, "values", c->now->time);
    commit(c, i, 1);
    if (more != asked && !look(c, i, more))
      k->valid |= more & ~OF_CONDITION;
    else if (look(c, i, asked))
      no_values(c, i, missing | (missing & OF_STATE ? OF_RATES : 0));
  }
  if (missing & (OF_RATES | OF_CONDITION)) find_rates(c, i, missing);
  k->valid |= missing;
  return OK;
}

static unsigned group_of(const component_t *c, long i, long reference) {
  const layout_t *l = c->model->layout + i;
  if (SYSTEM(c->now)) return reference < l->rate ? 0 : ALL_RESULTS;
  if (reference < l->state) return 0;
  if (reference < l->rate) return OF_STATE;
  if (reference < l->coordinates) {
    const long j = reference - l->rate;
    return !c->model->frames && j % BODY < 2 && j != ANGLE ? OF_STATE : OF_RATES;
  }
  return reference < l->slip        ? OF_COORDINATES
         : reference < l->twist     ? OF_SLIPS
         : reference < l->pose      ? OF_TWISTS
         : reference < l->points    ? OF_POSES
         : reference < l->condition ? OF_PLACES
                                    : OF_CONDITION;
}

/* The contact whose value this is, or -1 */
static long owner_of(const model_t *m, long reference) {
  if (reference < m->layout[0].input) return -1;
  long i = 0;
  while (reference >= m->layout[i].end) i++;
  return i;
}

/* The first of these values that there is not; count where there are all */
static long without_value(const component_t *c, unsigned reference, const double *value,
                          long count) {
  const long owner = owner_of(c->model, reference);
  long i = 0;
  for (; i < count; i++) {
    if (fabs(value[i]) <= 1e200) continue; /* tables divide an acceleration by 1e-300 at rest */
    if (!(fabs(value[i]) <= DBL_MAX) ||
        (kind_of(c->model, reference + i) == CALCULATED && rests(c, owner)))
      break;
  }
  return i;
}

/* Says why there is no value. */
static status_t refuse(component_t *c, unsigned reference) {
  const memory_t *now = c->now;
  const char *what = c->model->names[reference];
  const long i = owner_of(c->model, reference);
  if (past_end(c))
    return report(
        c, DISCARD, "logStatusDiscard",
        "%s has no value at t = %.17g s: sigma is negative from t = %.9g s on; end there, "
        "or change the profile",
        what, now->time, now->limit);
  const int framed =
      i < 0 || !SYSTEM(now) || (c->live[i].regularity[0] > 0 && c->live[i].regularity[1] > 0);
  if (i >= 0 && rests(c, i) && framed)
    return report(c, DISCARD, "logStatusDiscard", "%s has no value at t = %.17g s: " AT_REST, what,
                  now->time);
  const char *where =
      SYSTEM(now) ? "or beyond a singular point of a chart (a pole or an umbilic); start "
                    "elsewhere, run the Co-Simulation, which passes such points, or export with "
                    "states=\"frame\""
                  : "a singular point of a chart (a pole or an umbilic); ask a moment later";
  return report(c, DISCARD, "logStatusDiscard", "%s has no value at t = %.17g s, at %s", what,
                now->time, where);
}

static status_t get_values(component_t *c, unsigned reference, long count, double *value) {
  const long i = owner_of(c->model, reference);
  if (i >= 0) {
    const unsigned group = group_of(c, i, reference);
    const int stuck = group && !SYSTEM(c->now) ? settle(c) : 0;
    if (stuck) return refuse_motion(c, stuck - 1, "values", c->now->time);
    if (group & ~c->live[i].valid) {
      const status_t s = find(c, i, group);
      if (s) return s;
    }
    c->live[i].asked |= group;
  }
  memcpy(value, c->value + reference, (size_t)count * sizeof *value);
  const long wrong = without_value(c, reference, value, count);
  return wrong == count ? OK : refuse(c, reference + (unsigned)wrong);
}

static status_t check_value(component_t *c, unsigned reference, double value) {
  const double least = section(c->model, D_LEAST)[reference];
  if (!(fabs(value) <= DBL_MAX))
    return report(c, DISCARD, "logStatusDiscard", "%s = %g is refused; give a finite number",
                  c->model->names[reference], value);
  if (value < least)
    return report(c, DISCARD, "logStatusDiscard", "%s = %.9g is refused; give %g or more",
                  c->model->names[reference], value, least);
  return OK;
}

static void set_value(component_t *c, unsigned reference, double value) {
  if (c->value[reference] == value) return;
  c->value[reference] = value;
  forget_values(c);
  if (reference < c->model->layout[0].input)
    for (long i = 0; i < c->model->n_contacts; i++) c->live[i].prepared = 0;
  c->now->settled = 0;
}

/* ---- time ---- */

static void set_time(component_t *c, double time) {
  if (c->now->time == time && c->value[TIME_VALUE] == time) return;
  c->now->time = c->value[TIME_VALUE] = time;
  if (c->now->stepping) c->now->acts_at = snapped(c, time);
  for (long i = 0; i < c->model->n_contacts; i++) {
    live_t *k = c->live + i;
    k->before = k->asked, k->asked = 0, k->valid = 0;
  }
}

/* ---- start ---- */

/* Where contact i starts, from its states. Returns what is wrong, or NULL. */
static const char *place_contact(component_t *c, long i) {
  const model_t *m = c->model;
  const layout_t *l = m->layout + i;
  segment_t *s = c->segment + i;
  double *x = c->value + l->state, *to = s->row - K_PLACE_1;
  find_system(c, i);
  for (int side = 0; side < 2; side++)
    if (!(c->live[i].regularity[side] > 1e-12))
      return side ? "the object has no outward contact frame at (u, v)"
                  : "the finger has no outward contact frame at (u, v)";
  memset(s, 0, sizeof *s);
  s->begin = c->now->time, s->gain = c->value[GAIN];
  if (leaves_slip_behind(c, i)) no_slip(m, i, x);
  if (!m->frames) {
    for (int side = 0; side < 2; side++) {
      const double *own = x + BODY * side;
      memcpy(to + (side ? K_PLACE_2 : K_PLACE_1), own, 3 * sizeof *own);
      memcpy(to + (side ? K_Y : K_W1), own + VELOCITY, 2 * sizeof *own);
    }
    to[K_ANGLE] = x[ANGLE] + x[FRAME_ANGLE] + x[BODY + FRAME_ANGLE];
  } else {
    const double *coordinates = c->value + l->coordinates;
    s->moment = 1.0; /* psi = -theta_1 - theta_2, R_0 = diag(1, -1) */
    for (int side = 0; side < 2; x += l->frame[side++]) {
      double *place = to + (side ? K_PLACE_2 : K_PLACE_1);
      if (l->frame[side] == 3) {
        memcpy(place, x, 3 * sizeof *x);
        continue;
      }
      s->frames += 1 << side;
      memcpy(to + (side ? K_FRAME_2 : K_FRAME_1), x, 6 * sizeof *x);
      place[0] = coordinates[4 * side], place[1] = coordinates[4 * side + 1];
      place[2] = side ? c->live[i].theta : -coordinates[8] - c->live[i].theta;
    }
    memcpy(to + K_W1, x, 4 * sizeof *x);
  }
  if (!all_finite(s->row, ROW)) return "the start is not finite";
  const double stop = c->now->stop_time, horizon = m->data[D_HORIZON];
  s->end = -(stop < HUGE_VAL ? stop : s->begin < horizon ? horizon : s->begin + horizon);
  return NULL;
}

/* Looks at the contact in every form that it will have, so that steps allocate nothing. */
static void warm(component_t *c, long i) {
  const double at = c->now->acts_at;
  look(c, i, ALL_RESULTS & ~OF_RATES);
  for (long k = 0; k < n_edges(c->model); k++) {
    c->now->acts_at = edge_of(c, k);
    look(c, i, ALL_RESULTS & ~OF_RATES);
  }
  c->now->acts_at = at;
}

static status_t start(component_t *c) {
  memory_t *now = c->now;
  const model_t *m = c->model;
  const double *order = section(m, D_ORDERS), *starts = section(m, D_STARTS);
  study_profiles(c);
  if (now->limit <= now->time)
    return report(c, FAILED, "logStatusError",
                  "sigma is negative from t = %.9g s on; change the profile", now->time);
  for (long k = 0; k < (long)m->data[D_N_ORDERS]; k++, order += 2) {
    const long greater = (long)order[0], less = (long)order[1];
    if (less == greater && c->value[less] != starts[less])
      return report(c, FAILED, "logStatusError",
                    "%s = %.9g is refused: the parameters of this surface depend on each other and "
                    "cannot be set individually; export a scene with another surface",
                    m->names[less], c->value[less]);
    if (less != greater && !(c->value[greater] > c->value[less]))
      return report(c, FAILED, "logStatusError",
                    "%s = %.9g is refused: it must be greater than %s = %.9g, or the surface is of "
                    "another kind; export a scene that has it",
                    m->names[greater], c->value[greater], m->names[less], c->value[less]);
  }
  enter_windows(c);
  for (long i = 0; i < m->n_contacts; i++) {
    const char *wrong = place_contact(c, i);
    if (wrong)
      return report(c, FAILED, "logStatusError",
                    "contact %ld cannot start: %s; change its coordinates or the parameters of the "
                    "surface",
                    i + 1, wrong);
    if (now->stepping && cover(c, i, now->time)) {
      refuse_motion(c, i, "motion", now->time);
      return FAILED;
    }
    if (now->stepping) warm(c, i);
  }
  now->settled = 0; /* inputs act from here on */
  forget_values(c);
  return OK;
}

/* ---- steps ---- */

static void tell_edges(component_t *c, double from) {
  for (long k = 0; k < n_edges(c->model); k++) {
    const double edge = edge_of(c, k);
    if (reached(from, edge) || !reached(c->now->time, edge)) continue;
    if (k < 2 * c->model->n_windows)
      report(c, OK, "logEvents", "the disturbance of contact %g %s at t = %.17g s",
             window_of(c, k / 2)[V_CONTACT] + 1, k % 2 ? "ends" : "begins", edge);
    else
      report(c, OK, "logEvents", "a leg begins at t = %.17g s", edge);
  }
}

/* All contacts to a time, or none. */
static status_t step(component_t *c, double target, int stop_at_windows, int *edge) {
  memory_t *now = c->now;
  const double began = now->time;
  const long n = c->model->n_contacts;
  *edge = 0;
  now->ended = target > now->limit && !reached(now->limit, target);
  if (now->ended)
    return report(c, DISCARD, "logStatusDiscard",
                  "no step to t = %.9g s: sigma is negative from t = %.9g s on; end there, or "
                  "change the profile",
                  target, now->limit);
  if (now->pending) enter_windows(c);
  for (long i = 0; i < n; i++)
    if (pushed_at_rest(c, i))
      return report(c, DISCARD, "logStatusDiscard", "no step to t = %.9g s: " AT_REST, target);
  const int stuck = settle(c);
  if (stuck) return refuse_motion(c, stuck - 1, "step", target);
  double goal = fmin(target, now->limit);
  if (stop_at_windows) {
    const double window = next_window(c);
    if ((*edge = reached(target, window))) goal = window;
  }
  for (long i = 0; i < n; i++) {
    if (c->live[i].plan && reached(c->segment[i].end, goal)) continue;
    if (!cover(c, i, goal)) continue;
    for (long j = 0; j <= i; j++) commit(c, j, 0);
    return refuse_motion(c, i, "step", target);
  }
  for (long i = 0; i < n; i++) commit(c, i, 1);
  set_time(c, goal);
  if (*edge) now->pending = 1, now->acts_at = nextafter(now->acts_at, -HUGE_VAL);
  if (n_edges(c->model)) tell_edges(c, began);
  return OK;
}
