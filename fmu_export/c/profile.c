/* What changes with time alone: sigma, where it turns and ends, and windows. */

#include "polynomial.h"

enum { MAX_PROFILE = 64 };
#define LOOK_AHEAD 1.05 /* a solver may look this far beyond sigma's end, within its last step */

static const double *sigma_of(const component_t *c) { return c->value + PROFILE; }

static double sigma_at_time(const component_t *c, double t) {
  return horner(sigma_of(c), c->model->n_profile, t);
}

static double sigma_now(const component_t *c) { return sigma_at_time(c, c->now->acts_at); }

/* the same, or 0 where its sign cannot be told from rounding */
static double clear_sigma(const component_t *c, double t) {
  return clear_value(sigma_of(c), c->model->n_profile, t, sigma_at_time(c, t));
}

/* where sigma, or its rate for order 1, changes its sign from now to some time, ascending */
static long signs_of(const component_t *c, int order, double to, double found[2 * MAX_PROFILE]) {
  const long n = c->model->n_profile;
  return (long)sign_changes(sigma_of(c), n, order, c->now->time, to, found);
}

static void study_profile(component_t *c) {
  const double begin = c->now->time, far = begin + 1e3 * c->model->data[D_HORIZON];
  double at[2 * MAX_PROFILE];
  const long n = signs_of(c, 0, far, at);
  const double first = clear_sigma(c, 0.5 * (begin + (n ? at[0] : far)));
  c->now->limit = first < 0 ? begin : n ? at[0] : HUGE_VAL;
}

static int rests(const component_t *c) { return clear_sigma(c, c->now->time) <= 0; }

/* Whether the path leaves a rest under a law that makes up for growth, which no slip does. */
static int leaves_slip_behind(const component_t *c) {
  return c->model->data[D_MAKES_UP] > 0 && rests(c);
}

/* Times this near are one time: steps of 0.1 s do not add up to 1 s. The edge may be infinite; a
   tolerance of its size would be too, and inf - inf ends programs that trap invalid operations. */
static inline int reached(double time, double edge) {
  return edge - time <= 8 * DBL_EPSILON * fmax(1.0, fabs(time));
}

static int past_end(const component_t *c) {
  const memory_t *now = c->now;
  const double end = now->limit;
  if (now->stepping || !(now->time > end) || reached(end, now->time)) return 0;
  return now->ended || now->phase != CONTINUOUS || now->time > LOOK_AHEAD * end;
}

/* ---- windows ---- */

static const double *window_of(const component_t *c, long k) {
  return section(c->model, D_WINDOWS) + k * V_SIZE;
}

static const double *window_values(const component_t *c, long k) {
  return c->value + (long)window_of(c, k)[V_VALUES];
}

static double next_window(const component_t *c) {
  double next = HUGE_VAL;
  for (long k = 0; k < c->model->n_windows; k++)
    for (int side = 0; side < 2; side++) {
      const double edge = window_values(c, k)[side];
      if (!reached(c->now->time, edge) && edge < next) next = edge;
    }
  return next;
}

/* The same, and of a system of equations where its law changes its form and where sigma ends */
static double next_edge(const component_t *c) {
  const memory_t *now = c->now;
  double next = next_window(c), turn[2 * MAX_PROFILE];
  if (now->stepping) return next;
  if (!reached(now->time, now->limit)) next = fmin(next, now->limit);
  if (c->model->data[D_MAKES_UP] > 0) {
    const double far = fmin(now->limit, now->time + 1e3 * c->model->data[D_HORIZON]);
    const long n = signs_of(c, 1, far, turn);
    for (long k = 0; k < n; k++)
      if (!reached(now->time, turn[k]) && turn[k] < next) next = turn[k];
  }
  return next;
}

/* The time, or the edge of a window that it is but for rounding */
static double snapped(const component_t *c, double time) {
  for (long k = 0; k < c->model->n_windows; k++)
    for (int side = 0; side < 2; side++) {
      const double edge = window_values(c, k)[side];
      if (reached(time, edge) && reached(edge, time)) return edge;
    }
  return time;
}

/* Whether a window acts on contact i at the time that values are of */
static int acts(const component_t *c, long k, long i) {
  const double *edge = window_values(c, k), at = c->now->acts_at;
  return (long)window_of(c, k)[V_CONTACT] == i && edge[0] <= at && at < edge[1];
}

static void enter_windows(component_t *c) {
  memory_t *now = c->now;
  const double before = now->acts_at;
  now->acts_at = snapped(c, now->time);
  forget_values(c);
  now->pending = 0;
  if (!now->stepping) now->ended = reached(now->time, now->limit);
  for (long k = 0; k < c->model->n_windows; k++)
    for (int side = 0; side < 2; side++) {
      const double edge = window_values(c, k)[side];
      c->jumped |= before < edge && edge <= now->acts_at;
    }
}

/* Whether windows have begun or ended since this was asked last */
static int take_jump(component_t *c) {
  const int jumped = c->jumped;
  c->jumped = 0;
  return jumped;
}
