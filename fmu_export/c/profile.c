/* What changes with time alone: sigma, where it turns and ends, and windows. */

enum { MAX_PROFILE = 64 };
#define LOOK_AHEAD 1.05 /* a solver may look this far beyond sigma's end, within its last step */

static double horner_at(const double *c, long n, double x) {
  double y = c[n - 1];
  for (long k = n - 2; k >= 0; k--) y = y * x + c[k];
  return y;
}

/* the sum of the sizes of a polynomial's terms, which its rounding errors are a fraction of */
static double magnitude(const double *c, long n, double t) {
  double size = 0.0;
  for (long j = n - 1; j >= 0; j--) size = size * fabs(t) + fabs(c[j]);
  return size;
}

/* the value, or 0 where its sign cannot be told from rounding: theory/profile.py */
static double told_value(const double *c, long n, double t) {
  const double value = horner_at(c, n, t);
  return t == 0.0 || fabs(value) > 4e-16 * (double)n * magnitude(c, n, t) ? value : 0.0;
}

/* sign changes of a polynomial in (a, b), ascending; between those of its derivative it is
   monotone. A root at an end, or one that only touches zero, is none. */
static long sign_changes(const double *c, long n, double a, double b, double *found) {
  double derivative[MAX_PROFILE], knot[MAX_PROFILE + 1], low = a, at_low = 0.0;
  if (n < 2) return 0;
  for (long k = 1; k < n; k++) derivative[k - 1] = (double)k * c[k];
  long count = 0, inner = sign_changes(derivative, n - 1, a, b, knot + 1) + 1;
  knot[0] = a, knot[inner] = b;
  for (long k = 0; k <= inner; k++) {
    const double at_knot = told_value(c, n, knot[k]);
    double high = knot[k];
    if (at_knot == 0.0) continue;
    if ((at_low < 0) == (at_knot > 0) && at_low != 0.0) {
      for (int i = 0; i < 200; i++) {
        const double middle = 0.5 * (low + high);
        if (middle <= low || middle >= high) break;
        if ((horner_at(c, n, middle) > 0) == (at_low > 0))
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

/* where sigma turns inside (a, b), ascending */
static long turns_of(const double *sigma, long n, double a, double b, double *found) {
  double rate[MAX_PROFILE];
  for (long k = 1; k < n; k++) rate[k - 1] = (double)k * sigma[k];
  return sign_changes(rate, n - 1, a, b, found);
}

static const double *sigma_of(const component_t *c) { return c->value + PROFILE; }

static void study_profile(component_t *c) {
  const double *sigma = sigma_of(c), begin = c->now->time;
  const double far = begin + 1e3 * c->model->data[D_HORIZON];
  double at[MAX_PROFILE];
  const long np = c->model->n_profile, n = sign_changes(sigma, np, begin, far, at);
  const double first = told_value(sigma, np, 0.5 * (begin + (n ? at[0] : far)));
  c->now->limit = first < 0 ? begin : n ? at[0] : HUGE_VAL;
}

static double sigma_now(const component_t *c) {
  return horner_at(sigma_of(c), c->model->n_profile, c->now->acts_at);
}

/* whether sigma is zero but for rounding */
static int rests(const component_t *c) {
  const double *sigma = sigma_of(c), t = c->now->time;
  const long n = c->model->n_profile;
  return horner_at(sigma, n, t) <= 1e-15 * magnitude(sigma, n, t);
}

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
  double next = next_window(c), turn[MAX_PROFILE];
  if (now->stepping) return next;
  if (!reached(now->time, now->limit)) next = fmin(next, now->limit);
  if (c->model->data[D_MAKES_UP] > 0) {
    const double far = fmin(now->limit, now->time + 1e3 * c->model->data[D_HORIZON]);
    const long n = turns_of(sigma_of(c), c->model->n_profile, now->time, far, turn);
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
