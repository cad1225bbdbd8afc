/* The horizon of a contact, cut where a leg or a window begins or ends and where its gain law
   changes its form; sigma and the gain on each piece, in local time.

   Everything is local to a piece, so that a large gain loses nothing to cancellation. Shifts and
   products of polynomials are formed in doubled precision and rounded once: terms of sigma may
   cancel. */

/* ---- at local times ---- */

static inline void horners(const double *c, int64_t n, const double *x, double *restrict y) {
  for (int i = 0; i < L; i++) y[i] = c[n - 1];
  for (int64_t k = n - 2; k >= 0; k--)
    EACH_LANE(i) y[i] = y[i] * x[i] + c[k];
}

static inline double sigma_at(const drive_t *d, double tau) {
  return horner(d->sigma, d->n_sigma, tau);
}
static inline double length_at(const drive_t *d, double tau) {
  return horner(d->length, d->n_sigma + 1, tau);
}
static inline double exponent_at(const drive_t *d, double tau) {
  return horner(d->exponent, d->n_exponent, tau);
}

/* lam at a local time */
static inline double gain_at(const drive_t *d, double tau) {
  double lam = slope_of(d->exponent, d->n_exponent, tau);
  if (d->grows) lam += slope_of(d->sigma, d->n_sigma, tau) / sigma_at(d, tau);
  return lam;
}

/* The decay exp(-(L(tau) - L(0))); sigma: at the same times */
static void decays(const drive_t *d, const double *tau, const double *sigma, double *out) {
  double lost[L];
  horners(d->exponent, d->n_exponent, tau, lost);
  EACH_LANE(i) out[i] = v_exp(-lost[i]);
  if (d->grows)
    for (int i = 0; i < L; i++)
      if (tau[i] > 0) out[i] *= d->sigma[0] / sigma[i];
}

static double decay_at(const drive_t *d, double tau) {
  double t[L], sigma[L], out[L];
  fill_lanes(t, tau);
  horners(d->sigma, d->n_sigma, t, sigma);
  decays(d, t, sigma, out);
  return out[0];
}

/* ---- the pieces ---- */

/* Taylor's shift of a polynomial to start, by repeated Horner's schemes */
static void shift(const double *c, int64_t n, double start, twofold_t *out) {
  for (int64_t i = 0; i < n; i++) out[i] = twofold(c[i]);
  for (int64_t i = 0; i + 1 < n; i++)
    for (int64_t j = n - 2; j >= i; j--) out[j] = plus(out[j], times(twofold(start), out[j + 1]));
}

/* Coefficients of int value sigma^power; returns how many */
static int64_t exponent_of(work_t *w, const twofold_t *sigma, int64_t n, double value,
                           int64_t power, const double **out) {
  const int64_t size = power * (n - 1) + 1;
  double *found = keep(w, size + 1, sizeof *found);
  twofold_t *rate = keep(w, 2 * size, sizeof *rate), *next = rate + size;
  rate[0] = twofold(value);
  int64_t terms = 1;
  for (int64_t p = 0; p < power; p++, terms += n - 1) {
    for (int64_t k = 0; k < terms + n - 1; k++) next[k] = twofold(0.0);
    for (int64_t i = 0; i < terms; i++)
      for (int64_t j = 0; j < n; j++) next[i + j] = plus(next[i + j], times(rate[i], sigma[j]));
    memcpy(rate, next, (size_t)(terms + n - 1) * sizeof *rate);
  }
  found[0] = 0.0;
  for (int64_t k = 0; k < size; k++) found[k + 1] = (rate[k].high + rate[k].low) / (double)(k + 1);
  *out = found;
  return size + 1;
}

/* sigma and the gain from start to stop, within a leg */
static const drive_t *drive_on(work_t *w, const double *leg, double start, double stop) {
  const double *scene = w->plan->scene, *c = scene + (int64_t)leg[G_PROFILE];
  const int64_t n = (int64_t)leg[G_PROFILE_SIZE], power = (int64_t)scene[S_GAIN_POWER];
  const double from = start - leg[G_START], to = stop - leg[G_START];
  drive_t *d = keep(w, 1, sizeof *d);
  twofold_t *shifted = keep(w, n, sizeof *shifted);
  double *sigma = keep(w, 2 * n + 1, sizeof *sigma), *length = sigma + n;
  shift(c, n, from, shifted);
  for (int64_t i = 0; i < n; i++) sigma[i] = shifted[i].high + shifted[i].low;
  *d = (drive_t){.leg = leg, .start = start, .stop = stop, .sigma = sigma, .length = length};
  d->n_sigma = n;
  if (scene[S_CANCELS_GROWTH] > 0) {
    /* decay has the factor sigma[0]/sigma: where sigma starts at 0, it must be 0, not rounding */
    sigma[0] = clear_value(c, n, from, sigma[0]);
    d->grows = slope_of(c, n, 0.5 * (from + to)) > 0;
  }
  length[0] = 0.0;
  for (int64_t i = 0; i < n; i++) length[i + 1] = sigma[i] / (double)(i + 1);
  d->n_exponent = exponent_of(w, shifted, n, scene[S_GAIN], power, &d->exponent);

  const double span = stop - start, last = sigma_at(d, span);
  double least = fmin(sigma[0], last), greatest = fmax(sigma[0], last);
  double *turns = keep(w, 2 * n, sizeof *turns);
  const int64_t n_turns = sign_changes(c, n, 1, from, to, turns);
  for (int64_t k = 0; k < n_turns; k++) {
    const double value = sigma_at(d, turns[k] - from);
    least = fmin(least, value), greatest = fmax(greatest, value);
  }
  d->least = least;
  /* lam/sigma is gain sigma^(power - 1): if power is 0, it is least where sigma is greatest */
  const double base = power > 1 ? least : fmax(greatest, 1e-300);
  d->per_metre =
      fmax(scene[S_GAIN] * pow(base, (double)(power - 1)), 1.0 / fmax(length_at(d, span), 1e-300));
  return d;
}

static int ascending(const void *a, const void *b) {
  const double x = *(const double *)a, y = *(const double *)b;
  return (x > y) - (x < y);
}

/* The times at which something changes for a contact, each one once, ascending; returns how many */
static int64_t knots_of(work_t *w, const double *row, double **out) {
  const double *scene = w->plan->scene, *windows = scene + (int64_t)row[K_WINDOWS];
  const double *legs = scene + (int64_t)row[K_LEGS];
  const double begin = scene[S_BEGIN], end = scene[S_END];
  const int64_t n = (int64_t)row[K_WINDOWS_SIZE], n_legs = (int64_t)row[K_LEGS_SIZE];
  const int cut = scene[S_CANCELS_GROWTH] > 0; /* the law changes its form at extrema of sigma */
  int64_t room = 2 + 2 * n + n_legs, count = 0;
  for (int64_t k = 0; k < n_legs && cut; k++)
    room += 2 * (int64_t)legs[k * LEG_SIZE + G_PROFILE_SIZE];
  double *knots = *out = keep(w, room, sizeof *knots);
  knots[count++] = begin, knots[count++] = end;
  for (int64_t k = 0; k < n; k++)
    for (int j = 0; j < 2; j++) knots[count++] = windows[k * WINDOW_SIZE + W_START + j];
  for (int64_t k = 0; k < n_legs; k++) {
    const double *leg = legs + k * LEG_SIZE, start = leg[G_START];
    const double stop = k + 1 < n_legs ? leg[LEG_SIZE + G_START] : end;
    const double *c = scene + (int64_t)leg[G_PROFILE];
    double *turns = knots + ++count;
    turns[-1] = start;
    if (cut) count += sign_changes(c, (int64_t)leg[G_PROFILE_SIZE], 1, 0.0, stop - start, turns);
    while (turns < knots + count) *turns++ += start;
  }
  int64_t inside = 0;
  for (int64_t k = 0; k < count; k++)
    if (knots[k] >= begin && knots[k] <= end) knots[inside++] = knots[k];
  qsort(knots, (size_t)inside, sizeof *knots, ascending);
  count = 0;
  for (int64_t k = 0; k < inside; k++)
    if (k == 0 || knots[k] > knots[count - 1]) knots[count++] = knots[k];
  return count;
}

/* The segments of a contact */
static void schedule(work_t *w, contact_t *c) {
  const double *row = c->row, *scene = w->plan->scene;
  const double *windows = scene + (int64_t)row[K_WINDOWS];
  const double *leg = scene + (int64_t)row[K_LEGS];
  const double *last = leg + ((int64_t)row[K_LEGS_SIZE] - 1) * LEG_SIZE;
  double *edges;
  c->n_segments = knots_of(w, row, &edges) - 1;
  c->segments = keep(w, c->n_segments, sizeof *c->segments);
  for (int64_t k = 0; k < c->n_segments; k++) {
    segment_t *s = c->segments + k;
    const double start = edges[k], stop = edges[k + 1];
    while (leg < last && leg[LEG_SIZE + G_START] <= start) leg += LEG_SIZE;
    s->drive = drive_on(w, leg, start, stop);
    /* at the scene's start W_1 already has the direction of its leg */
    if (leg[G_START] == start && start > scene[S_BEGIN]) s->turn = leg + G_TURN;
    for (int64_t i = 0; i < (int64_t)row[K_WINDOWS_SIZE]; i++) {
      const double *window = windows + i * WINDOW_SIZE;
      if (!(window[W_START] <= start && stop <= window[W_STOP])) continue;
      for (int a = 0; a < 2; a++) s->acting[2 * (int)window[W_SLOT] + a] += window[W_VALUE + a];
    }
  }
  edges[c->n_segments] = HUGE_VAL;
  c->segment_edges = edges;
}
