/* Numbers of doubled precision, after Dekker, for results that are rounded only once. */

typedef struct {
  double high, low;
} twofold_t;

static inline twofold_t twofold(double a) { return (twofold_t){a, 0.0}; }
static inline twofold_t two_sum(double a, double b) {
  const double s = a + b, z = s - a;
  return (twofold_t){s, (a - (s - z)) + (b - z)};
}
static inline twofold_t two_product(double a, double b) {
  const double p = a * b;
  return (twofold_t){p, fma(a, b, -p)};
}
static inline twofold_t times(twofold_t a, twofold_t b) {
  const twofold_t p = two_product(a.high, b.high);
  return two_sum(p.high, p.low + (a.high * b.low + a.low * b.high));
}
static inline twofold_t plus(twofold_t a, twofold_t b) {
  const twofold_t s = two_sum(a.high, b.high);
  return two_sum(s.high, s.low + (a.low + b.low));
}
static inline twofold_t over(twofold_t a, twofold_t b) {
  const double q = a.high / b.high;
  const twofold_t p = two_product(q, b.high);
  return two_sum(q, ((a.high - p.high) - p.low + a.low - q * b.low) / b.high);
}

/* sqrt(x^2 + y^2), which is not 0 */
static inline twofold_t twofold_norm(double x, double y) {
  const twofold_t square = plus(two_product(x, x), two_product(y, y));
  const double root = sqrt(square.high);
  const twofold_t known = two_product(root, root);
  const twofold_t rest = plus(square, (twofold_t){-known.high, -known.low});
  return two_sum(root, rest.high / (2.0 * root));
}

/* An angle in (-pi, pi], and the whole turns that were taken off */
static inline double without_turns(twofold_t angle, double *turns) {
  static const twofold_t turn = {6.283185307179586, 2.4492935982947064e-16};
  *turns = rint(angle.high / turn.high);
  const twofold_t rest = plus(angle, times(twofold(-*turns), turn));
  return rest.high + rest.low;
}
