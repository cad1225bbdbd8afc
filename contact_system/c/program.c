/* Whole plans in one call: integrate what has not been yet (panels.c), evaluate every track (tracks.c).
   Generic: kernels come as pointers to panels and evaluate. */

typedef long (*evaluate_t)(const track_t *, long, const double *, double *, const long *, long);
typedef long (*panels_t)(long, double *, const double *, const double *, const drive_t *, method_t *,
                         double *, double *, double *, double *);

/* A track that is integrated when it is asked for (development.Motion). */
typedef struct {
  track_t track; /* edges, coefficients are filled here */
  panels_t integrate;
  drive_t drive; /* in the panels' variable */
  method_t method;
  long nx, room, done; /* states of a body; panels; whether it is integrated */
  double tolerance, slip, share; /* see development.Problem: share is `finish` */
  const double *start, *constants, *scale;
  double *block; /* room: state, spare, work, edges, coefficients */
} motion_t;

/* Returns 0, or the code of panels. */
long move(motion_t *m) {
  if (m->done) return 0;
  track_t *k = &m->track;
  const long size = k->nb * m->nx;
  double *spare = m->block + size, *work = spare + size, *edges = work + (2 * m->nx + 2) * N;
  double *series = edges + m->room + 1, finish = m->share * m->tolerance;
  method_t *method = &m->method;
  /* below 4e-16 a series' tail is rounding noise */
  method->tolerance = m->tolerance > 4e-15 ? 0.1 * m->tolerance : 4e-16;
  method->finish = finish, method->slip = m->slip > finish ? m->slip : 0.0;
  method->released = -1.0, method->max_panels = m->room, k->n_anchors = 0;
  memcpy(m->block, m->start, size * sizeof(double));
  long count = m->integrate(k->nb, m->block, m->constants, m->scale, &m->drive, &m->method, edges,
                            series, work, spare);
  if (count < 0) return count;
  k->n_panels = count, k->edges = edges, k->coefficients = series;
  k->panel_stride = size * (N + 1), k->body_stride = m->nx * (N + 1);
  m->done = 1;
  return 0;
}

/* A track of a plan and where its rows go. */
typedef struct {
  evaluate_t evaluate;
  track_t *track;
  long moves;          /* k > 0: it is the track of motion k - 1 */
  long offset, stride; /* of body 0, from body to body, in blocks of rows */
  long first, last;    /* the first, the last track of its side */
} part_t;

static long earlier(const double *t, long nt, double edge) {
  long low = 0, high = nt;
  while (low < high) {
    long middle = (low + high) / 2;
    if (t[middle] < edge) low = middle + 1; else high = middle;
  }
  return low;
}

#define MOST_ROWS 5

/* Write `count` rows of every track: out[block][count][nt]. Returns 0; 1 + the index of a time outside
   the plan; -1 - the index of a time with a result that is not finite. at[0]: the code of panels, if
   that is what failed, of motion at[1]; 1 if the times are not in order. From at[2] on: the motions. */
long fill(const part_t *parts, long n_parts, long count, long nt, const double *t, double *out,
          long *at) {
  long rows[MOST_ROWS], ordered = 0;
  for (long r = 0; r < count; r++) rows[r] = r * nt;
  at[0] = 0;
  for (long p = 0; p < n_parts; p++) {
    const part_t *part = parts + p;
    track_t *track = part->track;
    if (part->moves) {
      motion_t *motion = (motion_t *)at[1 + part->moves];
      at[1] = part->moves - 1;
      if ((at[0] = move(motion))) return -1;
      track = &motion->track;
    }
    long from = 0, to = nt;
    if (!part->first || !part->last) {
      for (long i = ordered; i + 1 < nt; i++)
        if (!(t[i] <= t[i + 1])) {
          at[0] = 1;
          return -1;
        }
      ordered = nt;
      if (!part->first) from = earlier(t, nt, track->start);
      if (!part->last) to = earlier(t, nt, track->stop);
      if (from >= to) continue;
    }
    long code = part->evaluate(track, to - from, t + from,
                               out + part->offset * count * nt + from, rows,
                               part->stride * count * nt);
    if (code) return code > 0 ? code + from : code - from;
  }
  return 0;
}

/* Chart states of contacts that slip: turn both motions into series of chart states, panel by panel, and
   evaluate those at all times.

   A number at a time costs 16 multiplications this way; converting the motion there costs two or
   three arc tangents a body. Decay may fall within a panel by any amount, so the object's rates are
   kept as two smooth parts, u2' = a - decay b. */
#define OUT 9   /* u1 v1 u1' v1' u2 v2 u2' v2' psi */
#define ROWS 11 /* the same with a for u2' v2', then b */
#define SIDE 5  /* u v u' v' theta */
#define DEPTH 10

typedef struct {
  evaluate_t finger, object;
  track_t *tip;
  motion_t *motion;
  long room; /* for series */
  double tolerance;
  const double *begin, *angle; /* [nb][3], [nb] */
  const double *project;       /* [N][N], node values -> coefficients */
  double *cuts, *series;       /* [room + 1], [room][nb][ROWS][N] */
  track_t body, aside;         /* driven by W alone, by V alone; filled here */
  long n_series;               /* out */
} states_t;

/* Chart states at the nodes of [a, b]: values [nb][ROWS][N]; last: [nb][3], continued. */
static int sample(const states_t *p, double a, double b, double *last, double *values) {
  static const long row[SIDE] = {0, N, 2 * N, 3 * N, 4 * N};
  double times[N], raw[SIDE * N * 3 * MOST];
  const track_t *k = &p->body;
  const long nb = k->nb;
  for (int i = 0; i < N; i++) {
    double t = k->start + a + 0.5 * (b - a) * (1.0 + p->motion->method.node[i]);
    times[i] = t < k->stop ? t : k->stop;
  }
  double *tip = raw, *body = raw + SIDE * N * nb, *aside = body + SIDE * N * nb;
  if (p->finger(p->tip, N, times, tip, row, SIDE * N)) return 1;
  if (p->object(k, N, times, body, row, SIDE * N)) return 1;
  /* once exp(-40) of the slip is left, its part of the rates is below rounding */
  int slips = horner(k->drive.exponent, k->drive.n_exponent, a) < 40.0;
  if (slips && p->object(&p->aside, N, times, aside, row, SIDE * N)) return 1;
  for (long j = 0; j < nb; j++, tip += SIDE * N, body += SIDE * N, aside += SIDE * N) {
    double *ref = last + 3 * j, *out = values + j * ROWS * N;
    for (int i = 0; i < N; i++) {
      if (slips) wind(k, ref, 1, aside + i, row);
      wind(k, ref, 1, body + i, row);
      ref[0] = body[i], ref[1] = body[N + i], ref[2] = body[4 * N + i];
      out[8 * N + i] = p->angle[j] - tip[4 * N + i] - body[4 * N + i];
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
static int resolve(states_t *p, double a, double b, double *last, int depth) {
  const long nb = p->motion->track.nb, count = nb * ROWS;
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
   outside the track; -1 to -3 as panels does; -4 where the series do not resolve the states. */
long states(states_t *p, long nt, const double *t, double *out) {
  const track_t *k = &p->motion->track;
  const long nb = k->nb;
  long failed = move(p->motion);
  if (failed) return failed;
  p->body = *k, p->body.slips = 0;
  p->aside = p->body, p->aside.w = k->v;
  double last[3 * MOST];
  memcpy(last, p->begin, 3 * nb * sizeof(double));
  p->n_series = 0, p->cuts[0] = 0.0;
  for (long i = 0; i < k->n_panels; i++)
    if (resolve(p, k->edges[i], k->edges[i + 1], last, 0)) return -4;
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
