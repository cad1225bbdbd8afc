/* Elementary functions on lanes: without branches, so that compilers vectorise them, and the same
   to the last bit on every machine. After Cephes (Moshier, netlib.org/cephes), within 2 ulp. */
#include <math.h>
#include <string.h>

/* Importers compile the sources of an FMU without OpenMP, and some of them with -pedantic. Pointers
   to arrays gain `const`, as C23 allows. */
#pragma GCC diagnostic ignored "-Wunknown-pragmas"
#pragma GCC diagnostic ignored "-Wpedantic"
#define SIMD _Pragma("omp simd")
#define EACH_LANE(i) SIMD for (int i = 0; i < L; i++)
#define PI 3.14159265358979323846
#define TURN 6.28318530717958647693

/* Polynomials, highest power first; a loop over an array is a quarter slower by gcc -O1. */
static inline double horner_3(double z, double a, double b, double c) {
  return (a * z + b) * z + c;
}
static inline double horner_4(double z, double a, double b, double c, double d) {
  return horner_3(z, a * z + b, c, d);
}
static inline double horner_5(double z, double a, double b, double c, double d, double e) {
  return horner_4(z, a * z + b, c, d, e);
}
static inline double horner_6(double z, double a, double b, double c, double d, double e,
                              double f) {
  return horner_5(z, a * z + b, c, d, e, f);
}

static inline double clip(double x, double low, double high) {
  const double above = x < low ? low : x;
  return above > high ? high : above;
}

/* adding and subtracting it rounds to a whole number */
static const double ROUNDER = 6755399441055744.0;
/* beyond this the reduction of an angle in three parts loses digits, and libm is asked */
static const double LARGE_ANGLE = 1e5;

static inline double v_atan2(double y, double x) {
  const double ax = fabs(x), ay = fabs(y);
  const double big = ax > ay ? ax : ay, small = ax > ay ? ay : ax;
  const int far = small > 0.66 * big;
  const double base = far ? 0.25 * PI : 0.0, more = far ? 3.061616997868383e-17 : 0.0;
  const double scale = big > 0 ? big : 1.0;
  const double t = (far ? small - big : small) / (far ? small + big : scale), z = t * t;
  const double p =
      horner_5(z, -8.750608600031904122785e-1, -1.615753718733365076637e1,
               -7.500855792314704667340e1, -1.228866684490136173410e2, -6.485021904942025371773e1);
  const double q =
      horner_6(z, 1.0, 2.485846490142306297962e1, 1.650270098316988542046e2,
               4.328810604912902668951e2, 4.853903996359136964868e2, 1.945506571482613964425e2);
  double r = t * (z * p / q) + more + t + base;
  r = ay > ax ? 0.5 * PI - r + 6.123233995736766e-17 : r;
  r = x < 0 || (x == 0 && copysign(1.0, x) < 0) ? PI - r + 1.2246467991473532e-16 : r;
  return copysign(r, y) + 0.0 * (x + y); /* NaN where an argument is */
}

/* |x| below LARGE_ANGLE */
static inline void v_sincos(double x, double *s, double *c) {
  const double k = (x * 0.63661977236758134308 + ROUNDER) - ROUNDER;
  const double y = ((x - k * 1.57079632673412561417) - k * 6.07710050630396597660e-11) -
                   k * 2.02226624879595063154e-21;
  const double z = y * y;
  const double odd =
      horner_6(z, 1.58962301576546568060e-10, -2.50507477628578072866e-8, 2.75573136213857245213e-6,
               -1.98412698295895385996e-4, 8.33333333332211858878e-3, -1.66666666666666307295e-1);
  const double even = horner_6(z, -1.13585365213876817300e-11, 2.08757008419747316778e-9,
                               -2.75573141792967388112e-7, 2.48015872888517045348e-5,
                               -1.38888888888730564116e-3, 4.16666666666665929218e-2);
  const double sine = y + y * z * odd, cosine = 1.0 - 0.5 * z + z * z * even;
  /* k modulo 4 */
  const double quarter = k - 4.0 * (((0.25 * k - 0.375) + ROUNDER) - ROUNDER);
  const int swap = quarter == 1.0 || quarter == 3.0;
  const double a = swap ? cosine : sine, b = swap ? sine : cosine;
  *s = quarter >= 2.0 ? -a : a;
  *c = quarter == 1.0 || quarter == 2.0 ? -b : b;
}

static inline double v_exp(double x) {
  const double inside = clip(x, -700.0, 709.0), shifted = inside * 1.4426950408889634074 + ROUNDER;
  const double k = shifted - ROUNDER;
  const double y = (inside - k * 6.93145751953125e-1) - k * 1.42860682030941723212e-6, z = y * y;
  const double p = y * horner_3(z, 1.26177193074810590878e-4, 3.02994407707441961300e-2,
                                9.99999999999999999910e-1);
  const double q = horner_4(z, 3.00198505138664455042e-6, 2.52448340349684104192e-3,
                            2.27265548208155028766e-1, 2.0);
  union {
    double d;
    uint64_t i;
  } power = {.d = shifted};
  power.i = (power.i + 1023) << 52;
  const double r = (1.0 + 2.0 * p / (q - p)) * power.d;
  return (x < -700.0 ? 0.0 : x > 709.0 ? HUGE_VAL : r) + 0.0 * x;
}

/* Sines and cosines of n numbers, by libm where one of them is large */
static inline void sincos_of(const double *a, double *restrict s, double *restrict c, const int n) {
  double large = 0.0;
  SIMD for (int i = 0; i < n; i++) large += !(fabs(a[i]) < LARGE_ANGLE);
  if (large != 0.0)
    for (int i = 0; i < n; i++) s[i] = sin(a[i]), c[i] = cos(a[i]);
  else
    SIMD for (int i = 0; i < n; i++) v_sincos(a[i], &s[i], &c[i]);
}
