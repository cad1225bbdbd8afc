/* What changes with time alone: where sigma grows and ends, and windows. */
#include "component.h"

#define LOOK_AHEAD 1.05 /* a solver may look this far beyond sigma's end, within its last step */

/* the value, or 0 where its sign cannot be told from rounding: theory/profile.py */
static double clear_value(const double *c, long n, double t) {
  const double value = horner(c, n, t);
  return t == 0.0 || fabs(value) > 4e-16 * n * magnitude(c, n, t) ? value : 0.0;
}

/* sign changes of a polynomial in (a, b), ascending; between those of its derivative it is
   monotone. A root at an end, or one that only touches zero, is none. */
static long sign_changes(const double *c, long n, double a, double b, double *found) {
  double derivative[MAX_SIGMA], knot[MAX_SIGMA + 1], low = a, at_low = 0.0;
  if (n < 2) return 0;
  for (long k = 1; k < n; k++) derivative[k - 1] = k * c[k];
  long count = 0, inner = sign_changes(derivative, n - 1, a, b, knot + 1) + 1;
  knot[0] = a, knot[inner] = b;
  for (long k = 0; k <= inner; k++) {
    const double at_knot = clear_value(c, n, knot[k]);
    double high = knot[k];
    if (at_knot == 0.0) continue;
    if ((at_low < 0) == (at_knot > 0) && at_low != 0.0) {
      for (int i = 0; i < 200; i++) {
        const double middle = 0.5 * (low + high);
        if (middle <= low || middle >= high) break;
        if ((horner(c, n, middle) > 0) == (at_low > 0))
          low = middle;
        else
          high = middle;
      }
      found[count++] = high;
    }
    low = knot[k], at_low = at_knot;
  }
  return count;
}

void study_profile(memory_t *now) {
  const double *sigma = law(now) + 1;
  double far = now->time + 1e3 * HORIZON, at[MAX_SIGMA + 2], rate[MAX_SIGMA];
  long n = sign_changes(sigma, N_PROFILE, now->time, far, at);
  const double first = clear_value(sigma, N_PROFILE, 0.5 * (now->time + (n ? at[0] : far)));
  now->limit = first < 0 ? now->time : n ? at[0] : HUGE_VAL;
  now->n_knots = 0;
  if (GAIN_LAW != GUARANTEED || N_PROFILE < 2) return;
  for (long k = 1; k < N_PROFILE; k++) rate[k - 1] = k * sigma[k];
  n = sign_changes(rate, N_PROFILE - 1, now->time, far, at + 1);
  at[0] = now->time, at[n + 1] = far;
  for (long k = 0; k <= n; k++)
    if (horner(rate, N_PROFILE - 1, 0.5 * (at[k] + at[k + 1])) > 0) {
      now->knots[now->n_knots++] = at[k];
      now->knots[now->n_knots++] = at[k + 1];
    }
}

int past_end(const memory_t *now) {
  const double end = now->limit;
  if (now->stepping || !(now->time > end) || reached(end, now->time)) return 0;
  return now->ended || now->phase != CONTINUOUS || now->time > LOOK_AHEAD * end;
}

double next_window(const memory_t *now) {
  double next = HUGE_VAL;
  for (long k = 0; k < N_WINDOWS; k++)
    for (int side = 0; side < 2; side++) {
      double edge = side ? windows[k].stop : windows[k].start;
      if (!reached(now->time, edge) && edge < next) next = edge;
    }
  return next;
}

double next_edge(const memory_t *now) {
  double next = next_window(now);
  if (!now->stepping && !reached(now->time, now->limit)) next = fmin(next, now->limit);
  for (long k = 0; k < now->n_knots; k++)
    if (!reached(now->time, now->knots[k]) && now->knots[k] < next) next = now->knots[k];
  return next;
}

void enter_windows(component_t *c) {
  memory_t *now = &c->now;
  memset(now->window, 0, sizeof now->window);
  for (long k = 0; k < N_WINDOWS; k++)
    if (reached(now->time, windows[k].start) && !reached(now->time, windows[k].stop))
      for (int j = 0; j < 6; j++) now->window[windows[k].contact][j] += windows[k].value[j];
  memset(now->valid, 0, sizeof now->valid);
  now->settled = now->pending = 0;
  if (!now->stepping) now->ended = reached(now->time, now->limit);
}
