/* What the hand-written C shares: the data that Python fills, and small parts. N is the number of
   nodes of a panel. */
#ifndef CONTACT_SYSTEM_COMMON
#define CONTACT_SYSTEM_COMMON
#include <math.h>
#include <string.h>

#define TURN 6.283185307179586
#define BLOCK 64

typedef struct {
  long n_sigma, n_exponent, power; /* polynomials lowest first; decay gets (sigma0/sigma)^power */
  const double *sigma, *exponent;
} drive_t;

typedef struct {
  double length, tolerance, first, slip, finish; /* see development.Problem */
  double released, reached;                      /* out: when slip was let go, or -1; the last edge */
  const double *node, *integral, *series, *end;  /* xi[N], Q^T[N][N], B^T[N][N] and B's last row, e[2][N] */
  const double *twice;                           /* (Q Q)^T, for NESTED */
  long n_stiff, max_panels, stops;
} method_t;

/* where an integration in panels stands: next panel from tau, of length h at most; a series of
   `length` to start from, or NULL: it ends at tau (the last panel) or begins there (a refused one) */
typedef struct {
  double tau, h, length;
  const double *before;
  long begins;
} step_t;

typedef struct {
  double start, stop;
  drive_t drive;
  long nb, slips, by_length, n_panels, panel_stride, body_stride;
  long n_anchors, double_cover;
  double period_u, period_v;
  const double *constants, *length; /* length: polynomial of the arc length, lowest first */
  const double *w, *v;               /* closed form: of sigma, length; panels: W, V */
  long forced, w_row, v_row;         /* W_1, V are rows of the panels too, from the state's first; 0: none */
  const double *turn;                /* [nb][4], by rows: W = turn W_1; NULL: W = W_1 */
  const double *edges, *coefficients; /* of the first state row of body 0 in panel 0 */
  const double *anchor_at, *anchors; /* [m], [nb][3][m]: where on the panels, and u v theta there */
} track_t;

static inline double horner(const double *c, long n, double x) {
  double y = c[n - 1];
  for (long k = n - 2; k >= 0; k--) y = y * x + c[k];
  return y;
}

/* dy/dx of the same */
static inline double slope(const double *c, long n, double x) {
  double y = 0.0;
  for (long k = n - 1; k >= 1; k--) y = y * x + k * c[k];
  return y;
}

/* lam at a local time */
static inline double gain_at(const drive_t *d, double tau) {
  double lam = slope(d->exponent, d->n_exponent, tau);
  if (d->power) lam += slope(d->sigma, d->n_sigma, tau) / horner(d->sigma, d->n_sigma, tau);
  return lam;
}

/* exp(-(L(tau) - L(0))) at n local times, where sigma is given: profile.GainPiece.decay. Less than
   exp(-100) is nothing, and libm takes 50 ns over an underflow. */
static inline void decays(const drive_t *d, const double *tau, const double *sigma, long n,
                          double *out) {
  for (long i = 0; i < n; i++) out[i] = horner(d->exponent, d->n_exponent, tau[i]);
#pragma omp simd
  for (long i = 0; i < n; i++) out[i] = out[i] < 100 ? exp(-out[i]) : 0.0;
  if (d->power)
    for (long i = 0; i < n; i++)
      if (tau[i] > 0) out[i] *= d->sigma[0] / sigma[i];
}

/* the k of edges[k] <= x < edges[k + 1], ends included, starting the search at a guess */
static inline long interval(const double *edges, long n, double x, long k) {
  if (k < n && x >= edges[k] && (k == n - 1 || x < edges[k + 1])) return k;
  long low = 0, high = n;
  while (high - low > 1) {
    long middle = (low + high) / 2;
    if (x >= edges[middle]) low = middle; else high = middle;
  }
  return low;
}

static inline double wound(double value, double reference, double period) {
  return period > 0 ? value + period * rint((reference - value) / period) : value;
}

/* One point to the branch nearest its reference; half_turn: (-u, pi - v), axes turned by pi. */
static inline void wind(const track_t *k, const double *ref, long stride, double *out, const long *row) {
  double u = wound(out[row[0]], ref[0], k->period_u);
  double v = wound(out[row[1]], ref[stride], k->period_v), turned = 0.0;
  if (k->double_cover) {
    double u2 = wound(-out[row[0]], ref[0], k->period_u);
    double v2 = wound(0.5 * TURN - out[row[1]], ref[stride], k->period_v);
    if (hypot(u2 - ref[0], v2 - ref[stride]) < hypot(u - ref[0], v - ref[stride])) {
      u = u2, v = v2, turned = 0.5 * TURN;
      out[row[2]] = -out[row[2]], out[row[3]] = -out[row[3]];
    }
  }
  out[row[0]] = u, out[row[1]] = v;
  out[row[4]] = wound(out[row[4]] + turned, ref[2 * stride], TURN);
}

#define CHUNK 16
#define WIDTH (BLOCK + CHUNK) /* a run's last chunk may reach past the block */

/* y = start + half q^T f, q[rows][N]. Not inlined, and its outer loop kept a loop: GCC would unroll all of it
   and pack it badly (measured: four times slower). */
static __attribute__((noinline, unused)) void combine(const double *restrict q, long rows,
                                                      const double *restrict f, double start,
                                                      double half, double *restrict y) {
  double sum[N] = {0};
#pragma GCC unroll 1
  for (long j = 0; j < rows; j++) {
    double fj = f[j];
#pragma omp simd
    for (int i = 0; i < N; i++) sum[i] += q[j * N + i] * fj;
  }
#pragma omp simd
  for (int i = 0; i < N; i++) y[i] = start + half * sum[i];
}

/* P_0 .. P_N at n points and up to the chunk after them */
static inline void legendre(const double *xi, long n, double basis[N + 1][WIDTH]) {
  n = (n / CHUNK + 1) * CHUNK < WIDTH ? (n / CHUNK + 1) * CHUNK : WIDTH;
  for (long i = 0; i < n; i++) basis[0][i] = 1.0, basis[1][i] = xi[i];
  for (long k = 1; k < N; k++) {
    double a = (2 * k + 1) / (k + 1.0), b = k / (k + 1.0);
    for (long i = 0; i < n; i++) basis[k + 1][i] = a * xi[i] * basis[k][i] - b * basis[k - 1][i];
  }
}

/* x[q] = sum_j c[j] P_j(q), j < count, for q in [from, to) and up to the next chunk, a chunk at a
   time in registers, as in combine. */
static __attribute__((noinline, unused)) void series(const double *restrict c, long count,
                                                     const double (*restrict basis)[WIDTH],
                                                     long from, long to, double *restrict x) {
  for (long q = from; q < to; q += CHUNK) {
    double sum[CHUNK] = {0};
#pragma GCC unroll 1
    for (long j = 0; j < count; j++) {
      double cj = c[j];
#pragma omp simd
      for (long i = 0; i < CHUNK; i++) sum[i] += cj * basis[j][q + i];
    }
#pragma omp simd
    for (long i = 0; i < CHUNK; i++) x[q + i] = sum[i];
  }
}

#endif
