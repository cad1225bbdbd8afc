/* What the hand-written C shares: the data that Python fills, and small parts. N is the number of
   nodes of a panel. */
#ifndef CONTACT_SYSTEM_COMMON
#define CONTACT_SYSTEM_COMMON
#include <float.h>
#include <math.h>
#include <string.h>

/* omp simd is for compilers that are told of it (-fopenmp-simd) */
#if defined(__GNUC__)
#pragma GCC diagnostic ignored "-Wunknown-pragmas"
#endif

#define TURN 6.283185307179586
#define BLOCK 64

typedef struct {
  long n_sigma, n_exponent, power; /* polynomials lowest first; decay gets (sigma0/sigma)^power */
  const double *sigma, *exponent;
} drive_t;

typedef struct {
  double length, tolerance, first, slip, finish; /* see panels.Problem */
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
  long n_constants, n_drive; /* numbers of a body in constants; in w and in v */
  long n_anchors, double_cover;
  double period_u, period_v;
  const double *constants, *length; /* length: polynomial of the arc length, lowest first */
  const double *w, *v;               /* closed form: of sigma, length; panels: W, V */
  long forced, w_row, v_row;         /* W_1, V are rows of the panels too, from the state's first; 0: none */
  const double *turn;                /* [nb][4], by rows: W = turn W_1; NULL: W = W_1 */
  const double *offset;              /* [nb][2], added to u', v'; or NULL */
  const double *edges, *coefficients; /* of the first state row of body 0 in panel 0 */
  const double *anchor_at, *anchors; /* [m], [nb][3][m]: where on the panels, and u v theta there */
} track_t;

/* A step's length, or half of what is left: a short last one costs as much as a long one. */
static inline double shared(double h, double left) {
  if (!(h < left && left < 2.0 * h)) return h;
  return left < 1.03 * h ? left : 0.5 * left; /* 1.03: the tail that is expected stays in tolerance */
}

static inline double horner(const double *c, long n, double x) {
  double y = c[n - 1];
  for (long k = n - 2; k >= 0; k--) y = y * x + c[k];
  return y;
}

/* the same at many places */
static inline void horners(const double *restrict c, long n, const double *restrict x, long count,
                           double *restrict y) {
  for (long i = 0; i < count; i++) y[i] = c[n - 1];
  for (long k = n - 2; k >= 0; k--)
    for (long i = 0; i < count; i++) y[i] = y[i] * x[i] + c[k];
}

/* The length of a path at BLOCK local times at most. Where fma is an instruction, what each step rounds off is
   summed and put back (Graillat, Langlois, Louvet, Algorithms for accurate, validated and fast polynomial
   evaluation, 2009): rounded lengths would be most of the error of great circles. */
static inline void lengths(const track_t *k, const double *restrict tau, long n, double *restrict out) {
#if defined(__FP_FAST_FMA) || defined(__FMA__)
  double lost[BLOCK] = {0};
  for (long i = 0; i < n; i++) out[i] = k->length[k->drive.n_sigma];
  for (long j = k->drive.n_sigma - 1; j >= 0; j--) {
    const double c = k->length[j];
#pragma omp simd
    for (long i = 0; i < n; i++) {
      const double product = out[i] * tau[i], sum = product + c, part = sum - product;
      const double off = (product - (sum - part)) + (c - part);
      lost[i] = lost[i] * tau[i] + (fma(out[i], tau[i], -product) + off);
      out[i] = sum;
    }
  }
  for (long i = 0; i < n; i++) out[i] += lost[i];
#else
  horners(k->length, k->drive.n_sigma + 1, tau, n, out);
#endif
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
  horners(d->exponent, d->n_exponent, tau, n, out);
#pragma omp simd
  for (long i = 0; i < n; i++) out[i] = out[i] < 100 ? exp(-out[i]) : 0.0;
  if (d->power)
    for (long i = 0; i < n; i++)
      if (tau[i] > 0) out[i] *= d->sigma[0] / sigma[i];
}

/* the k of edges[k] <= x < edges[k + 1], ends included, where a guess and the next are looked at first */
static inline long interval(const double *edges, long n, double x, long k) {
  for (const long next = k + 2; k < n && k < next && x >= edges[k]; k++)
    if (k == n - 1 || x < edges[k + 1]) return k;
  long low = 0, high = n;
  while (high - low > 1) {
    long middle = (low + high) / 2;
    if (x >= edges[middle]) low = middle; else high = middle;
  }
  return low;
}

/* Times in a row that lie in one panel: up to `stop`. */
typedef struct {
  long stop, panel;
} run_t;

/* The runs of n places x, clipped to the panels, and where in their panels they are, xi in [-1, 1].
   last: the panel to begin the search at. */
static inline long find_runs(const double *edges, long n_panels, const double *x, long n, long *last,
                             double *xi, run_t *runs) {
  const double end = edges[n_panels];
  long count = 0;
  for (long i = 0, stop; i < n; i = stop) {
    const double at = x[i] < 0 ? 0 : x[i] > end ? end : x[i];
    const long k = *last = interval(edges, n_panels, at, *last);
    const double low = edges[k], high = edges[k + 1];
    /* an interval may be so short that its inverse is infinite */
    const double pace = high - low > 1e-300 ? 2.0 / (high - low) : 0.0;
    const double from = k ? low : -HUGE_VAL, to = k + 1 < n_panels ? high : HUGE_VAL;
    for (stop = i + 1; stop < n && x[stop] >= from && x[stop] < to;) stop++;
    for (long q = i; q < stop; q++) {
      const double place = (x[q] - low) * pace - 1.0;
      xi[q] = place < -1.0 ? -1.0 : place > 1.0 ? 1.0 : place;
    }
    runs[count].stop = stop, runs[count++].panel = k;
  }
  return count;
}

static inline double wound(double value, double reference, double period) {
  const double far = reference - value;
  return fabs(far) <= 0.5 * period || period <= 0 ? value : value + period * rint(far / period);
}

/* Of a chart that covers its surface twice: whether cos v < 0, and whether sin u cos v < 0. They change where a
   path crosses cos v = 0 or sin u = 0, and nowhere else. */
static inline int second_cover(double v) { return (long long)floor(2.0 * v / TURN + 0.5) & 1; }
static inline int beyond(double u, double v) {
  return ((long long)floor(2.0 * u / TURN) + second_cover(v)) & 1;
}

/* beyond(u, 0) of a principal u, which is within pi: no division */
static inline int principal_beyond(double u) { return u < 0.0 || u >= 0.5 * TURN; }

/* y, whose sign says that; it is the same on both covers */
static inline double side_of(double u, double v) { return sin(u) * cos(v); }

/* Whether a point is on cos v = 0 or sin u = 0 but for rounding: signs tell nothing there. */
static inline int on_seam(double u, double v) {
  const double a = 2.0 * u / TURN, b = 2.0 * v / TURN - 0.5;
  return fabs(a - rint(a)) < 1e-12 || fabs(b - rint(b)) < 1e-12;
}

/* One point to (-u, pi - v), where the axes are turned by pi, or not, and whole turns nearest its reference */
static inline void wind_to(const track_t *k, int turned, const double *ref, long stride, double *out,
                           const long *row) {
  const double half = turned ? 0.5 * TURN : 0.0, sign = turned ? -1.0 : 1.0;
  out[row[0]] = wound(sign * out[row[0]], ref[0], k->period_u);
  out[row[1]] = wound(half + sign * out[row[1]], ref[stride], k->period_v);
  out[row[2]] *= sign, out[row[3]] *= sign;
  out[row[4]] = wound(out[row[4]] + half, ref[2 * stride], TURN);
}

/* One point, in principal coordinates, to its reference's branch: known where sin u cos v has the same sign,
   else taken as the nearest. Returns whether it was turned. */
static inline int wind(const track_t *k, const double *ref, long stride, double *out, const long *row) {
  const double u = out[row[0]], v = out[row[1]];
  int turned = k->double_cover && second_cover(ref[stride]);
  if (k->double_cover && (principal_beyond(u) != beyond(ref[0], ref[stride]) || on_seam(u, v) ||
                          on_seam(ref[0], ref[stride]))) {
    const double du = wound(u, ref[0], k->period_u) - ref[0];
    const double dv = wound(v, ref[stride], k->period_v) - ref[stride];
    const double du2 = wound(-u, ref[0], k->period_u) - ref[0];
    const double dv2 = wound(0.5 * TURN - v, ref[stride], k->period_v) - ref[stride];
    turned = du2 * du2 + dv2 * dv2 < du * du + dv * dv;
  }
  wind_to(k, turned, ref, stride, out, row);
  return turned;
}

/* u v u' v' theta of a path at a place x, in principal coordinates; returns not 0 if it has none */
typedef long (*place_on_t)(const void *path, double x, double *value);

/* Whether a path crosses cos v = 0, not sin u = 0, between two places x where sin u cos v = y has different
   signs, negative is the first: told where it crosses, by regula falsi (Illinois), so that it is right beside
   umbilics. */
static inline int over_seam(place_on_t place_on, const void *path, double x, double y, int negative, double x2,
                            double y2) {
  double value[5], last = 0.0, s = 0.0, c = 1.0;
  y = negative ? -fabs(y) : fabs(y), y2 = negative ? fabs(y2) : -fabs(y2); /* of pi/2 even that is rounded */
  for (int i = 0; i < 100; i++) {
    double at = x + (x2 - x) * (y / (y - y2));
    if (!(at > x && at < x2)) at = 0.5 * (x + x2);
    if (i && !(at > x && at < x2)) break; /* to rounding: a path may run along a seam and cross it elsewhere */
    if (place_on(path, at, value)) return 0;
    s = sin(value[0]), c = cos(value[1]);
    const double found = s * c;
    if (fmin(fabs(s), c) <= 1e-15 * fmax(fabs(s), c)) break;
    if ((found < 0.0) == negative) {
      if (last == y) y2 *= 0.5;
      x = at, last = y = found;
    } else {
      if (last == y2) y *= 0.5;
      x2 = at, last = y2 = found;
    }
  }
  return c < fabs(s);
}

/* Whether a path leaves its side of y = sin u cos v = 0 and comes back between two places x, told with y at one
   place where it is beyond: by parabolas towards the least |y|. */
static inline int comes_back(place_on_t place_on, const void *path, int negative, double x, double y, double x2,
                             double y2, double *there, double *found) {
  const double sign = negative ? -1.0 : 1.0;
  double a = x, c = x2, b = 0.5 * (a + c), at = b, value[5], ya = sign * y, yc = sign * y2, yb = HUGE_VAL;
  if (fmin(ya, yc) > 0.25) return 0; /* too far for less than half a radian */
  for (int i = 0; i < 30; i++) {
    if (!(at > a && at < c) || place_on(path, at, value)) return 0;
    *there = at, *found = side_of(value[0], value[1]);
    const double now = sign * *found;
    if (now < 0.0) return 1;
    if (i && at < b) {
      if (now < yb) c = b, yc = yb, b = at, yb = now; else a = at, ya = now;
    } else if (i) {
      if (now < yb) a = b, ya = yb, b = at, yb = now; else c = at, yc = now;
    } else
      yb = now;
    const double s1 = (yb - ya) / (b - a), s2 = (yc - yb) / (c - b), bend = (s2 - s1) / (c - a);
    at = 0.5 * (a + b) - 0.5 * s1 / bend;
    if (!(bend > 0.0) || ya + (at - a) * (s1 + bend * (at - b)) > 0.1 * fmax(ya, yc)) return 0;
  }
  return 0;
}

/* One point of a path at x2, in principal coordinates, to the branch that it is on coming from ref at x; y, y2:
   side_of both; bends: whether the path may come back between them */
static inline void wind_along(const track_t *k, place_on_t place_on, const void *path, double x, double y,
                              const double *ref, long stride, double x2, double y2, int bends, double *out,
                              const long *row) {
  const int side = beyond(ref[0], ref[stride]);
  double there, found;
  if (!k->double_cover || on_seam(ref[0], ref[stride]) || on_seam(out[row[0]], out[row[1]])) {
    wind(k, ref, stride, out, row);
    return;
  }
  int turned = second_cover(ref[stride]);
  if (principal_beyond(out[row[0]]) != side)
    turned ^= over_seam(place_on, path, x, y, side, x2, y2);
  else if (bends && comes_back(place_on, path, side, x, y, x2, y2, &there, &found)) {
    turned ^= over_seam(place_on, path, x, y, side, there, found);
    turned ^= over_seam(place_on, path, there, found, !side, x2, y2);
  }
  wind_to(k, turned, ref, stride, out, row);
}

/* How points between two anchors are told their branch: where both are on one branch and one side of y = 0,
   points there too are on it; where they are on two sides, by the one on the same side; where one side has two
   branches, by following the path; and by the nearer where signs tell nothing. Beside a pole v and theta swing
   by half a turn: a point is on the branch of the anchor that is nearer in theta. */
typedef struct {
  const double *before, *after;
  int signs, sides, covers; /* whether signs tell; whether sides, covers of the surface differ */
  int side, cover;          /* of the first */
  int swings;
} between_t;

static inline between_t between(const track_t *k, const double *before, const double *after, long stride) {
  between_t w = {.before = before, .after = after};
  w.signs = k->double_cover && !on_seam(before[0], before[stride]) && !on_seam(after[0], after[stride]);
  w.swings = !k->double_cover && fabs(after[2 * stride] - before[2 * stride]) > 0.25 * TURN;
  if (!w.signs) return w;
  w.side = beyond(before[0], before[stride]), w.sides = w.side != beyond(after[0], after[stride]);
  w.cover = second_cover(before[stride]), w.covers = w.cover != second_cover(after[stride]);
  return w;
}

/* One point of a path at x, in principal coordinates, to its branch, the first anchor being at x1, the nearer
   being the later or not */
static inline void wind_beside(const track_t *k, const between_t *w, place_on_t place_on, const void *path,
                               double x1, long stride, int later, double x, double *out, const long *row) {
  if (w->swings) {
    const double theta = out[row[4]], a = w->before[2 * stride], b = w->after[2 * stride];
    later = fabs(wound(theta, b, TURN) - b) < fabs(wound(theta, a, TURN) - a);
  }
  const double *ref = later ? w->after : w->before, u = out[row[0]], v = out[row[1]];
  if (w->signs) {
    const int differs = principal_beyond(u) != w->side;
    if (!differs && !w->sides && !w->covers) {
      wind_to(k, w->cover, ref, stride, out, row);
      return;
    }
    if (!on_seam(u, v)) {
      if (!w->sides) {
        const double *r = w->before;
        wind_along(k, place_on, path, x1, side_of(r[0], r[stride]), r, stride, x, side_of(u, v), 1, out, row);
        return;
      }
      ref = differs ? w->after : w->before;
    }
  }
  wind(k, ref, stride, out, row);
}

/* Numbers side by side in the machine's registers: the vector extension of GCC and Clang, where there is
   one, and where doubles are not computed as long doubles (on x86 of 32 bits they are). */
#if !defined(__GNUC__) || defined(PLAIN_C) || FLT_EVAL_METHOD == 2 || FLT_EVAL_METHOD < 0
#define LANES 1
#elif defined(__AVX512F__)
#define LANES 8
#elif defined(__AVX__)
#define LANES 4
#else
#define LANES 2
#endif
#define WIDTH (BLOCK + 16) /* a run's last lanes may reach past the block */
#if LANES > 1
typedef double lanes_t __attribute__((vector_size(8 * LANES), aligned(8), may_alias));
#define INLINE static inline __attribute__((always_inline, unused))
#define UNROLL _Pragma("GCC unroll 16")
#else
typedef double lanes_t;
#define INLINE static inline
#define UNROLL
#endif

#define PARTS (N / LANES)
#define GROUP (LANES == 8 ? 10 : LANES == 4 ? 3 : 1) /* rows whose sums fit the registers */

INLINE void combine_group(const double *q, long terms, int rows, const double *f, long f_row,
                          const double *start, double half, double *y, long y_row) {
  lanes_t sum[GROUP][PARTS];
  UNROLL for (int r = 0; r < rows; r++)
    UNROLL for (int p = 0; p < PARTS; p++) sum[r][p] = (lanes_t){0};
#pragma GCC unroll 1
  for (long j = 0; j < terms; j++) {
    lanes_t part[PARTS];
    UNROLL for (int p = 0; p < PARTS; p++) part[p] = *(const lanes_t *)(q + j * N + p * LANES);
    UNROLL for (int r = 0; r < rows; r++)
      UNROLL for (int p = 0; p < PARTS; p++) sum[r][p] += f[r * f_row + j] * part[p];
  }
  UNROLL for (int r = 0; r < rows; r++)
    UNROLL for (int p = 0; p < PARTS; p++)
      *(lanes_t *)(y + r * y_row + p * LANES) = (start ? start[r] : 0.0) + half * sum[r][p];
}

/* y[r] = start[r] + half sum_j f[r][j] q[j], q[terms][N]; the number of rows is known to the
   compiler, which keeps the sums in registers. start may be NULL. */
INLINE void combine(const double *q, long terms, int rows, const double *f, long f_row,
                    const double *start, double half, double *y, long y_row) {
  const int whole = rows / GROUP * GROUP;
#pragma GCC unroll 1
  for (int r = 0; r < whole; r += GROUP)
    combine_group(q, terms, GROUP, f + r * f_row, f_row, start ? start + r : 0, half, y + r * y_row, y_row);
  if (whole < rows)
    combine_group(q, terms, rows - whole, f + whole * f_row, f_row, start ? start + whole : 0, half,
                  y + whole * y_row, y_row);
}

#define ROWS_AT_ONCE 12

/* y[r][i] = sum_k c[r][k] T_k(xi[i]) for i < n and up to LANES - 1 more, `terms` > 1 terms of each of
   ROWS_AT_ONCE rows at most, whose number is known to the compiler. */
INLINE void chebyshev(const double *c, long c_row, int rows, long terms, const double *xi, long n,
                      double *const *y) {
  for (long i = 0; i < n; i += LANES) {
    const lanes_t x = *(const lanes_t *)(xi + i), twice = x + x;
    lanes_t before = (lanes_t){0} + 1.0, now = x, sum[ROWS_AT_ONCE];
    UNROLL for (int r = 0; r < rows; r++) sum[r] = c[r * c_row] + c[r * c_row + 1] * now;
#pragma GCC unroll 1
    for (long k = 2; k < terms; k++) {
      const lanes_t next = twice * now - before;
      before = now, now = next;
      UNROLL for (int r = 0; r < rows; r++) sum[r] += c[r * c_row + k] * now;
    }
    UNROLL for (int r = 0; r < rows; r++) *(lanes_t *)(y[r] + i) = sum[r];
  }
}

INLINE void series_group(const double *c, int rows, const double *xi, long n, double *y, long y_row) {
  double *row[ROWS_AT_ONCE];
  UNROLL for (int r = 0; r < rows; r++) row[r] = y + r * y_row;
  chebyshev(c, N + 1, rows, N + 1, xi, n, row);
}

/* All terms of a panel's series, any number of rows side by side */
INLINE void series(const double *c, int rows, const double *xi, long n, double *y, long y_row) {
  const int whole = rows / ROWS_AT_ONCE * ROWS_AT_ONCE;
#pragma GCC unroll 1
  for (int r = 0; r < whole; r += ROWS_AT_ONCE)
    series_group(c + r * (N + 1), ROWS_AT_ONCE, xi, n, y + r * y_row, y_row);
  if (whole < rows) series_group(c + whole * (N + 1), rows - whole, xi, n, y + whole * y_row, y_row);
}

#endif
