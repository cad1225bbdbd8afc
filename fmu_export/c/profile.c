/* What depends on time alone: sigma, its extrema and its end, legs and windows. */

#include "polynomial.h"

#define AGES 1e9        /* s, 30 years: later zeros and extrema of sigma are ignored */
#define LOOK_AHEAD 1.05 /* a solver may look this far beyond sigma's end, within its last step */

/* ---- legs ---- */

/* A leg of a contact's path: its start; sigma, in time since then; cosine and sine of the angle by
   which the path turns at the start */
typedef struct {
  double start;
  const double *sigma, *turn;
  long n;
} leg_t;

static long n_legs(const model_t *m, long i) { return (long)row_of(m, i)[K_LEGS_SIZE]; }

/* Leg k of contact i; a contact without legs of its own has one, with the scene's profile. */
static leg_t leg_of(const component_t *c, long i, long k) {
  const double *scene = c->model->scene;
  const double *row = scene + (long)row_of(c->model, i)[K_LEGS] + k * LEG_SIZE;
  const int own = c->model->contacts[i].own_legs > 0;
  return (leg_t){row[G_START], own ? scene + (long)row[G_PROFILE] : c->value + PROFILE,
                 row + G_TURN, (long)row[G_PROFILE_SIZE]};
}

/* The leg that contact i is on at the time that values are of */
static leg_t leg_now(const component_t *c, long i) {
  long k = 0;
  while (k + 1 < n_legs(c->model, i) && leg_of(c, i, k + 1).start <= c->now->acts_at) k++;
  return leg_of(c, i, k);
}

static double sigma_now(const component_t *c, long i) {
  const leg_t leg = leg_now(c, i);
  return horner(leg.sigma, leg.n, c->now->acts_at - leg.start);
}

/* sigma of a leg at a time since its start, or 0 if it is no more than rounding */
static double clear_sigma(const leg_t *leg, double t) {
  return clear_value(leg->sigma, leg->n, t, horner(leg->sigma, leg->n, t));
}

/* Puts the times, ascending, at which the leg's sigma, or for order 1 its rate, changes its sign
   between two times into c->scratch; returns how many there are. */
static long signs_of(const component_t *c, const leg_t *leg, int order, double from, double to) {
  const double a = from - leg->start, b = to - leg->start;
  const long n = (long)sign_changes(leg->sigma, leg->n, order, a, b, c->scratch);
  for (long k = 0; k < n; k++) c->scratch[k] += leg->start;
  return n;
}

/* Finds when the first sigma turns negative. Only that of a last leg may. */
static void study_profiles(component_t *c) {
  c->now->limit = HUGE_VAL;
  for (long i = 0; i < c->model->n_contacts; i++) {
    const leg_t leg = leg_of(c, i, n_legs(c->model, i) - 1);
    const double begin = fmax(c->now->time, leg.start);
    const double far = begin + AGES;
    const long n = signs_of(c, &leg, 0, begin, far);
    const double first = n ? c->scratch[0] : far;
    const int ends = clear_sigma(&leg, 0.5 * (begin + first) - leg.start) < 0;
    if (ends || n) c->now->limit = fmin(c->now->limit, ends ? begin : first);
  }
}

/* whether sigma is zero but for rounding */
static int rests(const component_t *c, long i) {
  const leg_t leg = leg_now(c, i);
  return clear_sigma(&leg, c->now->time - leg.start) <= 0;
}

/* Whether the path is at rest under a law that cancels growth: slip is then gone for good. */
static int leaves_slip_behind(const component_t *c, long i) {
  return cancels_growth(c->model) && rests(c, i);
}

/* Whether a time is at an edge or later, but for rounding: steps of 0.1 s do not add up to 1 s. The
   tolerance is relative to `time`, as the edge may be infinite, and inf - inf may be trapped. */
static inline int reached(double time, double edge) {
  return edge - time <= 8 * DBL_EPSILON * fmax(1.0, fabs(time));
}

static int past_end(const component_t *c) {
  const memory_t *now = c->now;
  if (now->stepping || reached(now->limit, now->time)) return 0;
  return now->ended || now->phase != CONTINUOUS || now->time > LOOK_AHEAD * now->limit;
}

/* ---- windows ---- */

static const double *window_values(const component_t *c, long k) {
  return c->value + c->model->windows[k].values;
}

/* The edges of windows, then the corners of legs */
static long n_edges(const model_t *m) { return 2 * m->n_windows + (long)m->head->corners.count; }

static double edge_of(const component_t *c, long k) {
  const long corner = k - 2 * c->model->n_windows;
  const double *corners = data_at(c->model, c->model->head->corners.at);
  return corner < 0 ? window_values(c, k / 2)[k % 2] : corners[corner];
}

/* The next edge; in Model Exchange also where the gain law changes its form or sigma ends */
static double next_edge(const component_t *c) {
  const memory_t *now = c->now;
  double next = HUGE_VAL;
  for (long k = 0; k < n_edges(c->model); k++)
    if (!reached(now->time, edge_of(c, k))) next = fmin(next, edge_of(c, k));
  if (now->stepping) return next;
  if (!reached(now->time, now->limit)) next = fmin(next, now->limit);
  for (long i = 0; i < c->model->n_contacts && cancels_growth(c->model); i++) {
    const leg_t leg = leg_now(c, i);
    const long n = signs_of(c, &leg, 1, now->time, fmin(now->limit, now->time + AGES));
    for (long k = 0; k < n; k++)
      if (!reached(now->time, c->scratch[k])) next = fmin(next, c->scratch[k]);
  }
  return next;
}

/* The first or last edge that equals a time but for rounding, as 0.3 equals 0.1 + 0.2; infinite if
   there is none */
static double edge_at(const component_t *c, double time, int last) {
  double found = last ? -HUGE_VAL : HUGE_VAL;
  for (long k = 0; k < n_edges(c->model); k++) {
    const double edge = edge_of(c, k);
    if (reached(time, edge) && reached(edge, time))
      found = last ? fmax(found, edge) : fmin(found, edge);
  }
  return found;
}

static double snapped(const component_t *c, double time) {
  const double edge = edge_at(c, time, 1);
  return isfinite(edge) ? edge : time;
}

/* Whether window k acts on contact i at the time that values are of */
static int acts(const component_t *c, long k, long i) {
  const double *edge = window_values(c, k), at = c->now->acts_at;
  return c->model->windows[k].contact == i && edge[0] <= at && at < edge[1];
}
