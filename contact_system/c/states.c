/* Chart states of contacts that slip, in one call: integrate the object (panels.c), turn both motions
   into series of chart states, panel by panel, and evaluate those at all times.

   A number at a time costs 16 multiplications this way; converting the motion there costs two or
   three arc tangents a body. Decay may fall within a panel by any amount, so the object's rates are
   kept as two smooth parts, u2' = a - decay b. Generic: kernels come as pointers to panels and
   evaluate. */
#define OUT 9   /* u1 v1 u1' v1' u2 v2 u2' v2' psi */
#define ROWS 11 /* the same with a for u2' v2', then b */
#define SIDE 5  /* u v u' v' theta */
#define DEPTH 10

typedef long (*evaluate_t)(const track_t *, long, const double *, double *, const long *, long);
typedef long (*panels_t)(long, double *, const double *, const double *, const drive_t *, method_t *,
                         double *, double *, double *, double *);

typedef struct {
  panels_t integrate;
  evaluate_t finger, object;
  track_t *tip, *body, *aside; /* aside: the body driven by V; edges, coefficients filled here */
  method_t *method;
  long nx, room; /* states of a body; room for series */
  double tolerance;
  const double *start, *constants, *scale, *begin, *angle; /* [nb][nx] ... [nb][3], [nb] */
  const double *project;                                   /* [N][N], node values -> coefficients */
  double *state, *spare, *work, *edges, *motion;           /* see panels */
  double *cuts, *series;                                   /* [room + 1], [room][nb][ROWS][N] */
  long n_series;                                           /* out */
} program_t;

/* Chart states at the nodes of [a, b]: values [nb][ROWS][N]; last: [nb][3], continued. */
static int sample(const program_t *p, double a, double b, double *last, double *values) {
  static const long row[SIDE] = {0, N, 2 * N, 3 * N, 4 * N};
  double times[N], raw[SIDE * N * 3 * MOST];
  const long nb = p->body->nb;
  for (int i = 0; i < N; i++) {
    double t = p->body->start + a + 0.5 * (b - a) * (1.0 + p->method->node[i]);
    times[i] = t < p->body->stop ? t : p->body->stop;
  }
  double *tip = raw, *body = raw + SIDE * N * nb, *aside = body + SIDE * N * nb;
  if (p->finger(p->tip, N, times, tip, row, SIDE * N)) return 1;
  if (p->object(p->body, N, times, body, row, SIDE * N)) return 1;
  /* once exp(-40) of the slip is left, its part of the rates is below rounding */
  int slips = horner(p->body->drive.exponent, p->body->drive.n_exponent, a) < 40.0;
  if (slips && p->object(p->aside, N, times, aside, row, SIDE * N)) return 1;
  for (long k = 0; k < nb; k++, tip += SIDE * N, body += SIDE * N, aside += SIDE * N) {
    double *ref = last + 3 * k, *out = values + k * ROWS * N;
    for (int i = 0; i < N; i++) {
      if (slips) wind(p->body, ref, 1, aside + i, row);
      wind(p->body, ref, 1, body + i, row);
      ref[0] = body[i], ref[1] = body[N + i], ref[2] = body[4 * N + i];
      out[8 * N + i] = p->angle[k] - tip[4 * N + i] - body[4 * N + i];
    }
    memcpy(out, tip, 4 * N * sizeof(double));
    memcpy(out + 4 * N, body, 4 * N * sizeof(double));
    if (slips)
      memcpy(out + 9 * N, aside + 2 * N, 2 * N * sizeof(double));
    else
      memset(out + 9 * N, 0, 2 * N * sizeof(double));
  }
  return 0;
}

/* Series of the chart states on [a, b], divided until their tails are below the tolerance. */
static int resolve(program_t *p, double a, double b, double *last, int depth) {
  const long nb = p->body->nb, count = nb * ROWS;
  double values[ROWS * N * MOST], before[3 * MOST];
  if (p->n_series == p->room) return 1;
  memcpy(before, last, 3 * nb * sizeof(double));
  if (sample(p, a, b, last, values)) return 1;
  double *out = p->series + p->n_series * count * N, worst = 0.0;
  for (long r = 0; r < count; r++) {
    double *c = out + r * N, *v = values + r * N, size = 0.0;
    for (int j = 0; j < N; j++) size = fabs(v[j]) > size ? fabs(v[j]) : size;
    combine(p->project, N, v, 0.0, 1.0, c);
    double tail = fmax(fabs(c[N - 1]), 0.1 * fabs(c[N - 2]));
    static const int angle[ROWS] = {1, 1, 0, 0, 1, 1, 0, 0, 1, 0, 0};
    if (angle[r % ROWS] && size < 1.0) size = 1.0;
    tail /= size > 0 ? size : 1.0;
    worst = tail > worst ? tail : worst;
  }
  if (worst <= p->tolerance) {
    p->cuts[++p->n_series] = b;
    return 0;
  }
  if (depth >= DEPTH) return 1;
  memcpy(last, before, 3 * nb * sizeof(double));
  /* halving divides the tail by about 2^15 */
  int parts = worst > 32768.0 * p->tolerance ? 4 : 2;
  for (int i = 0; i < parts; i++) {
    double from = a + (b - a) * i / parts, to = i + 1 < parts ? a + (b - a) * (i + 1) / parts : b;
    if (resolve(p, from, to, last, depth + parts / 2)) return 1;
  }
  return 0;
}

/* States of body b go to out[(b * OUT + r) * nt + i]. Returns 0; 1 + the index of the first time
   outside the track; -1 or -2 as panels does; -3 where the series do not resolve the states. */
long states(program_t *p, long nt, const double *t, double *out) {
  track_t *k = p->body;
  const long nb = k->nb;
  memcpy(p->state, p->start, nb * p->nx * sizeof(double));
  long panels = p->integrate(nb, p->state, p->constants, p->scale, &k->drive, p->method, p->edges,
                             p->motion, p->work, p->spare);
  if (panels < 0) return panels;
  k->n_panels = panels, k->edges = p->edges, k->coefficients = p->motion;
  *p->aside = *k;
  p->aside->w = k->v;
  double last[3 * MOST];
  memcpy(last, p->begin, 3 * nb * sizeof(double));
  p->n_series = 0, p->cuts[0] = 0.0;
  for (long i = 0; i < panels; i++)
    if (resolve(p, p->edges[i], p->edges[i + 1], last, 0)) return -3;
  double xi[WIDTH] = {0}, basis[N + 1][WIDTH], sums[ROWS][WIDTH], tau[BLOCK], sigma[BLOCK], decay[BLOCK];
  long where[BLOCK], near = 0;
  for (long from = 0; from < nt; from += BLOCK) {
    long n = nt - from < BLOCK ? nt - from : BLOCK;
    for (long i = 0; i < n; i++) {
      double x = t[from + i] - k->start, end = p->cuts[p->n_series];
      if (!(t[from + i] >= k->start && t[from + i] <= k->stop)) return from + i + 1;
      tau[i] = x, sigma[i] = horner(k->drive.sigma, k->drive.n_sigma, x);
      x = x < end ? x : end;
      where[i] = near = interval(p->cuts, p->n_series, x, near);
      xi[i] = 2.0 * (x - p->cuts[near]) / (p->cuts[near + 1] - p->cuts[near]) - 1.0;
    }
    legendre(xi, n, basis);
    decays(&k->drive, tau, sigma, n, decay);
    for (long b = 0; b < nb; b++) {
      for (long i = 0, stop; i < n; i = stop) {
        for (stop = i + 1; stop < n && where[stop] == where[i];) stop++;
        const double *c = p->series + (where[i] * nb + b) * ROWS * N;
        for (long r = 0; r < ROWS; r++) series(c + r * N, N, basis, i, stop, sums[r]);
      }
      for (long r = 6; r < 8; r++)
        for (long i = 0; i < n; i++) sums[r][i] -= decay[i] * sums[r + 3][i];
      for (long r = 0; r < OUT; r++)
        memcpy(out + (b * OUT + r) * nt + from, sums[r], n * sizeof(double));
    }
  }
  return 0;
}
