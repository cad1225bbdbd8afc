/* Polynomials by their coefficients, lowest power first. */
#ifndef CONTACT_POLYNOMIAL
#define CONTACT_POLYNOMIAL
#include <float.h>
#include <math.h>
#include <stdint.h>

static inline double horner(const double *c, int64_t n, double x) {
  double y = c[n - 1];
  for (int64_t k = n - 2; k >= 0; k--) y = y * x + c[k];
  return y;
}

/* its derivative */
static inline double slope_of(const double *c, int64_t n, double x) {
  double y = 0.0;
  for (int64_t k = n - 1; k >= 1; k--) y = y * x + (double)k * c[k];
  return y;
}

/* the value at x, or 0 where rounding, also of the coefficients, may change its sign */
static inline double clear_value(const double *c, int64_t n, double x, double value) {
  double size = 0.0;
  for (int64_t k = n - 1; k >= 0; k--) size = size * fabs(x) + fabs(c[k]);
  /* far away both may be infinite, and the sign is right */
  return x == 0 || fabs(value) > 4e-16 * (double)n * fmin(size, DBL_MAX) ? value : 0.0;
}

/* the root of d between a and b, where it changes its sign; above: whether d > 0 at a */
static inline double root_between(const double *d, int64_t n, double a, double b, int above) {
  if (n == 2) return fmin(fmax(a, -d[0] / d[1]), b);
  for (int i = 0; i < 200; i++) { /* down to neighbouring floats, also for a root very close to 0 */
    const double middle = 0.5 * (a + b);
    if (!(a < middle && middle < b)) break;
    if ((horner(d, n, middle) > 0) == above)
      a = middle;
    else
      b = middle;
  }
  return b;
}

/* Where the derivative of this order changes its sign inside (a, b), ascending; returns how many.
   found has room for 2 n numbers, of which some are scratch.

   Between the sign changes of its own derivative a polynomial is monotone. Roots that only touch
   zero, rounded or not, are no sign changes. */
static inline int64_t sign_changes(const double *c, int64_t n, int64_t order, double a, double b,
                                   double *found) {
  double *const d = found + n; /* the derivative over its order's factorial */
  int64_t count = 0;
  int up = 0, down = 0;
  for (int64_t k = order; k < n; k++) up |= c[k] > 0, down |= c[k] < 0;
  if (a >= 0 && !(up && down)) return 0;
  for (int64_t m = n - 2; m >= order; m--) {
    const int64_t knots = count + 1, size = n - m;
    double binomial = 1.0, low = a, at_low = 0.0;
    for (int64_t k = 0; k < size; k++)
      d[k] = binomial * c[k + m], binomial = binomial * (double)(k + 1 + m) / (double)(k + 1);
    count = 0;
    for (int64_t k = -1; k < knots; k++) { /* results replace only knots that have been read */
      double knot = k < 0 ? a : b;
      if (k >= 0 && k < knots - 1) knot = found[k];
      const double at_knot = clear_value(d, size, knot, horner(d, size, knot));
      if (at_knot == 0) continue;
      if (at_low != 0 && (at_low > 0) != (at_knot > 0))
        found[count++] = root_between(d, size, low, knot, at_low > 0);
      low = knot, at_low = at_knot;
    }
  }
  return count;
}

#endif
