/* Evaluation of a track at many times: the compiled twin of Track.coordinates, .points, .frames.

   The includer defines KERNEL (a loop, see Kernel.loop_source) with NP inputs a point, NC constants
   a body and NR results, ROWS (offsets of the inputs); CLOSED for closed forms, whose inputs are v length,
   w sigma, v length; else NS states in panels of N nodes, followed by the drive if NP > NS; WINDS where
   results 0, 1, 4 are u, v, theta to be continued along the path (closed forms do that themselves). */
#define COORDINATES 5 /* results: u v u' v' theta */
#ifdef CLOSED
#define POINTS BLOCK
#define BY_LENGTH 1
#else
#define POINTS WIDTH
#define BY_LENGTH k->by_length
#define SPLIT (NP - NS == 4) /* sigma W and sigma V apart */
#endif

#if !defined(CLOSED) && NP > NS
/* Two rows of the panels at n points */
static void rows_at(const track_t *k, long b, long row, long n_runs, const run_t *runs,
                    const double *xi, double (*out)[POINTS]) {
  const double *c = k->coefficients + b * k->body_stride + row * (N + 1);
  for (long r = 0, from = 0; r < n_runs; from = runs[r++].stop)
    series(c + runs[r].panel * k->panel_stride, 2, xi + from, runs[r].stop - from, out[0] + from, POINTS);
}

/* sigma (W - V) of a body under accelerations */
static void forced_drive(const track_t *k, long b, long n, long n_runs, const run_t *runs,
                         const double *xi, const double *sigma, double (*drive)[POINTS]) {
  double w[2][POINTS], v[2][POINTS];
  if (k->w_row)
    rows_at(k, b, k->w_row, n_runs, runs, xi, w);
  else
    for (long i = 0; i < n; i++) w[0][i] = k->w[2 * b], w[1][i] = k->w[2 * b + 1];
  if (k->v_row)
    rows_at(k, b, k->v_row, n_runs, runs, xi, v);
  else
    memset(v, 0, sizeof v);
  const double whole[] = {1.0, 0.0, 0.0, 1.0}, *r = k->w_row && k->turn ? k->turn + 4 * b : whole;
  for (long i = 0; i < n; i++) {
    drive[0][i] = sigma[i] * (r[0] * w[0][i] + r[1] * w[1][i] - v[0][i]);
    drive[1][i] = sigma[i] * (r[2] * w[0][i] + r[3] * w[1][i] - v[1][i]);
  }
}
#endif

#if defined(WINDS) && !defined(CLOSED)
static long place_on(const void *track, double x, double *value);

/* One body of a track in the panels' variable, whatever that is; rates are not wanted */
static track_t plain_track(const track_t *k, long b) {
  static const double one[] = {1.0}, same[] = {0.0, 1.0};
  track_t plain = *k;
  plain.start = 0.0, plain.stop = k->edges[k->n_panels], plain.by_length = plain.slips = plain.n_anchors = 0;
  plain.nb = 1, plain.forced = 0, plain.offset = NULL;
  plain.drive.sigma = one, plain.drive.n_sigma = 1, plain.length = same;
  plain.constants += b * NC, plain.coefficients += b * k->body_stride, plain.w += 2 * b, plain.v += 2 * b;
  return plain;
}

/* n points of body b at places x, in principal coordinates, to their branches; those between two anchors in one
   go */
static void wind_all(const track_t *k, long b, long n, const double *x, double *out, const long *row) {
  const track_t plain = plain_track(k, b);
  const long m = k->n_anchors;
  const double *at = k->anchor_at;
  for (long i = 0, near = 0; i < n;) {
    near = interval(at, m, x[i], near);
    const int inside = near + 1 < m;
    const double *before = k->anchors + b * 3 * m + near, low = at[near], high = inside ? at[near + 1] : HUGE_VAL;
    const between_t beside = between(k, before, before + inside, m);
    do {
      wind_beside(k, &beside, place_on, &plain, low, m, high - x[i] < x[i] - low, x[i], out + i, row);
      i++;
    } while (i < n && x[i] >= low && x[i] < high);
  }
}
#endif

/* Results of body b at time i go to out[b * out_body + out_row[r] + i]. Returns 0, or 1 + the index
   of the first time outside [start, stop], or -1 - the index of the first time whose result is not
   finite. */
long evaluate(const track_t *k, long nt, const double *t, double *out, const long *out_row,
              long out_body) {
  static const long rows[] = {ROWS};
  const drive_t *d = &k->drive;
  double point[NP][POINTS], tau[BLOCK], sigma[BLOCK], length[BLOCK];
#ifndef CLOSED
  double decay[BLOCK], xi[WIDTH] = {0};
  run_t runs[BLOCK];
  long n_runs, last = 0;
#endif
  for (long from = 0; from < nt; from += BLOCK) {
    long n = nt - from < BLOCK ? nt - from : BLOCK, outside = 0;
    for (long i = 0; i < n; i++) {
      double x = t[from + i];
      outside += !(x >= k->start && x <= k->stop);
      tau[i] = x - k->start;
    }
    if (outside)
      for (long i = 0; i < n; i++)
        if (!(t[from + i] >= k->start && t[from + i] <= k->stop)) return from + i + 1;
    horners(d->sigma, d->n_sigma, tau, n, sigma);
    if (BY_LENGTH) lengths(k, tau, n, length);
#ifndef CLOSED
    if (k->slips && !SPLIT) {
      decays(d, tau, sigma, n, decay);
      for (long i = 0; i < n; i++) decay[i] *= sigma[i];
    }
    n_runs = find_runs(k->edges, k->n_panels, k->by_length ? length : tau, n, &last, xi, runs);
#endif
    for (long b = 0; b < k->nb; b++) {
#ifdef CLOSED
      for (long i = 0; i < n; i++) {
        point[0][i] = point[2][i] = k->v[b] * length[i];
        point[1][i] = k->w[b] * sigma[i];
      }
#else
      const double *c = k->coefficients + b * k->body_stride;
      for (long r = 0, i = 0; r < n_runs; i = runs[r++].stop)
        series(c + runs[r].panel * k->panel_stride, NS, xi + i, runs[r].stop - i, point[0] + i, POINTS);
#if NP > NS
      if (k->forced) forced_drive(k, b, n, n_runs, runs, xi, sigma, point + NS);
      else
        for (long a = 0; a < 2; a++) {
          const double w = k->w[2 * b + a], v = k->v[2 * b + a];
          double *c = point[NS + a];
          for (long i = 0; i < n; i++) c[i] = w * sigma[i] - (k->slips && !SPLIT ? v * decay[i] : 0.0);
          for (long i = 0; i < n && SPLIT; i++) c[2 * POINTS + i] = v * sigma[i];
        }
#endif
#endif
      double *block = out + b * out_body + from;
      KERNEL(1, n, &point[0][0], rows, 0, k->constants + b * NC, block, out_row, 0);
      double sum = 0.0;
      for (long r = 0; r < NR; r++) {
        const double *row = block + out_row[r];
#pragma omp simd reduction(+ : sum)
        for (long i = 0; i < n; i++) sum += 0.0 * row[i];
      }
      if (sum != 0.0)
        for (long i = 0; i < n; i++)
          for (long r = 0; r < NR; r++)
            if (!isfinite(block[out_row[r] + i])) return -1 - (from + i);
      for (long a = 0; a < 2 && k->offset && NR == COORDINATES; a++)
        for (long i = 0; i < n; i++) block[out_row[2 + a] + i] += k->offset[2 * b + a];
#if defined(WINDS) && !defined(CLOSED)
      if (k->n_anchors) wind_all(k, b, n, k->by_length ? length : tau, block, out_row);
#endif
    }
  }
  return 0;
}

#if defined(WINDS) && !defined(CLOSED)
static long place_on(const void *track, double x, double *value) {
  static const long row[] = {0, 1, 2, 3, 4};
  return evaluate(track, 1, &x, value, row, COORDINATES);
}

/* Whether |y|, [m], falls towards the interval before place i from both sides */
static int bends(const double *y, long m, long i) {
  const int falls = i < 2 || fabs(y[i - 2]) >= fabs(y[i - 1]);
  return falls && (i + 1 == m || fabs(y[i + 1]) >= fabs(y[i]));
}

/* Fill the anchors of a track: four times a panel, between which coordinates move by less than half a
   period, continued from begin [nb][3]. at [m], anchors [nb][3][m], work [nb][5][m],
   m = 4 n_panels + 1. */
void anchor(track_t *k, const double *begin, double *at, double *anchors, double *work) {
  const long m = 4 * k->n_panels + 1;
  long row[] = {0, m, 2 * m, 3 * m, 4 * m};
  for (long p = 0; p < k->n_panels; p++)
    for (long q = 0; q < 4; q++)
      at[4 * p + q] = k->edges[p] + 0.25 * q * (k->edges[p + 1] - k->edges[p]);
  at[m - 1] = k->edges[k->n_panels];
  track_t plain = plain_track(k, 0);
  plain.nb = k->nb;
  const long pole = evaluate(&plain, m, at, work, row, 5 * m);
  for (long b = 0; b < k->nb; b++) {
    double *raw = work + b * 5 * m, *to = anchors + b * 3 * m, *y = raw + 3 * m; /* for rates, which are not */
    plain = plain_track(k, b);
    for (long i = 0; i < m && pole; i++) { /* an anchor at a pole is where the one before it is */
      double value[COORDINATES];
      const double *ref = begin + 3 * b, before[] = {ref[0], ref[1], 0.0, 0.0, ref[2]};
      const int regular = !place_on(&plain, at[i], value);
      for (long r = 0; r < COORDINATES; r++)
        raw[r * m + i] = regular ? value[r] : i ? raw[r * m + i - 1] : before[r];
    }
    for (long i = 0; i < m && k->double_cover; i++) y[i] = side_of(raw[i], raw[m + i]);
    const double *ref = begin + 3 * b;
    for (long i = 0, stride = 1; i < m; i++, stride = m) {
      if (i)
        wind_along(k, place_on, &plain, at[i - 1], y[i - 1], ref, m, at[i], y[i],
                   k->double_cover && bends(y, m, i), raw + i, row);
      else
        wind(k, ref, stride, raw + i, row);
      to[i] = raw[i], to[m + i] = raw[m + i], to[2 * m + i] = raw[4 * m + i];
      ref = to + i;
    }
  }
  k->n_anchors = m, k->anchor_at = at, k->anchors = anchors;
}
#endif
