/* On which branch of its chart a path is: coordinates continued along it.

   Coordinates of a point in space are principal values. Where a chart has periods the nearest turn
   continues them; where it covers its surface twice (triaxial ellipsoids) the cover changes where
   the path crosses the seam cos v = 0, and there alone: which neighbours do not tell beside
   umbilics. Places whose branch is known, anchors, lie so close that between two of them
   coordinates move by less than half a period. */
#include "component.h"

#define TURN 6.283185307179586

enum { U, V, DU, DV, THETA, COORDINATES };

/* one body of a contact on its way */
typedef struct {
  const memory_t *now;
  long i;
  int body;
} path_t;

/* u v u' v' theta in principal values at a local time; returns not 0 where there are none. */
static int place_on(const path_t *p, double tau, double *value);

static const winding_t *winding_of(const path_t *p) { return &places[p->i].kind->winding[p->body]; }

/* The value by whole periods nearest a reference */
static double wound(double value, double reference, double period) {
  const double far = reference - value;
  return fabs(far) <= 0.5 * period || period <= 0 ? value : value + period * rint(far / period);
}

/* Of a chart that covers its surface twice: whether cos v < 0, and whether sin u cos v < 0. They
   change where a path crosses cos v = 0 or sin u = 0, and nowhere else. */
static int second_cover(double v) { return (long long)floor(2.0 * v / TURN + 0.5) & 1; }
static int beyond(double u, double v) {
  return ((long long)floor(2.0 * u / TURN) + second_cover(v)) & 1;
}

/* y, whose sign says that; it is the same on both covers */
static double side_of(double u, double v) { return sin(u) * cos(v); }

/* Whether a point is on cos v = 0 or sin u = 0 but for rounding: signs tell nothing there. */
static int on_seam(double u, double v) {
  const double a = 2.0 * u / TURN, b = 2.0 * v / TURN - 0.5;
  return fabs(a - rint(a)) < 1e-12 || fabs(b - rint(b)) < 1e-12;
}

/* One point to (-u, pi - v), where the axes are turned by pi, or not, and whole turns nearest its
   reference u v theta */
static void wind_to(const winding_t *k, int turned, const double *ref, double *out) {
  const double half = turned ? 0.5 * TURN : 0.0, sign = turned ? -1.0 : 1.0;
  out[U] = wound(sign * out[U], ref[0], k->period_u);
  out[V] = wound(half + sign * out[V], ref[1], k->period_v);
  out[DU] *= sign, out[DV] *= sign;
  out[THETA] = wound(out[THETA] + half, ref[2], TURN);
}

/* One point in principal coordinates to its reference's branch: known where sin u cos v has the
   same sign, else taken as the nearest */
static void wind(const winding_t *k, const double *ref, double *out) {
  const double u = out[U], v = out[V];
  int turned = k->double_cover && second_cover(ref[1]);
  if (k->double_cover &&
      (beyond(u, 0.0) != beyond(ref[0], ref[1]) || on_seam(u, v) || on_seam(ref[0], ref[1]))) {
    const double du = wound(u, ref[0], k->period_u) - ref[0];
    const double dv = wound(v, ref[1], k->period_v) - ref[1];
    const double du2 = wound(-u, ref[0], k->period_u) - ref[0];
    const double dv2 = wound(0.5 * TURN - v, ref[1], k->period_v) - ref[1];
    turned = du2 * du2 + dv2 * dv2 < du * du + dv * dv;
  }
  wind_to(k, turned, ref, out);
}

/* Whether a path crosses cos v = 0, not sin u = 0, between two times where sin u cos v = y has
   different signs, negative is the first: told where it crosses, by regula falsi (Illinois), so
   that it is right beside umbilics. */
static int over_seam(const path_t *p, double x, double y, int negative, double x2, double y2) {
  double value[COORDINATES], last = 0.0, s = 0.0, c = 1.0;
  y = negative ? -fabs(y) : fabs(y), y2 = negative ? fabs(y2) : -fabs(y2);
  for (int i = 0; i < 100; i++) {
    double at = x + (x2 - x) * (y / (y - y2));
    if (!(at > x && at < x2)) at = 0.5 * (x + x2);
    /* to rounding: a path may run along a seam and cross it elsewhere */
    if (i && !(at > x && at < x2)) break;
    if (place_on(p, at, value)) return 0;
    s = sin(value[U]), c = cos(value[V]);
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

/* Whether a path leaves its side of y = sin u cos v = 0 and comes back between two times, told with
   y at one time when it is beyond: by parabolas towards the least |y|. */
static int comes_back(const path_t *p, int negative, double x, double y, double x2, double y2,
                      double *there, double *found) {
  const double sign = negative ? -1.0 : 1.0;
  double a = x, c = x2, b = 0.5 * (a + c), at = b, value[COORDINATES];
  double ya = sign * y, yc = sign * y2, yb = HUGE_VAL;
  if (fmin(ya, yc) > 0.25) return 0; /* too far for less than half a radian */
  for (int i = 0; i < 30; i++) {
    if (!(at > a && at < c) || place_on(p, at, value)) return 0;
    *there = at, *found = side_of(value[U], value[V]);
    const double now = sign * *found;
    if (now < 0.0) return 1;
    if (i == 0)
      yb = now;
    else if (at < b && now < yb)
      c = b, yc = yb, b = at, yb = now;
    else if (at < b)
      a = at, ya = now;
    else if (now < yb)
      a = b, ya = yb, b = at, yb = now;
    else
      c = at, yc = now;
    const double s1 = (yb - ya) / (b - a), s2 = (yc - yb) / (c - b), bend = (s2 - s1) / (c - a);
    at = 0.5 * (a + b) - 0.5 * s1 / bend;
    const double lowest = ya + (at - a) * (s1 + bend * (at - b));
    if (!(bend > 0.0) || lowest > 0.1 * fmax(ya, yc)) return 0;
  }
  return 0;
}

/* One point of a path at x2, in principal coordinates, to the branch that it is on coming from ref
   at x, where it is on the side of y */
static void wind_along(const path_t *p, double x, double y, const double *ref, double x2,
                       double *out) {
  const winding_t *k = winding_of(p);
  const int side = beyond(ref[0], ref[1]);
  const double y2 = side_of(out[U], out[V]);
  double there, found;
  if (!k->double_cover || on_seam(ref[0], ref[1]) || on_seam(out[U], out[V])) {
    wind(k, ref, out);
    return;
  }
  int turned = second_cover(ref[1]);
  if (beyond(out[U], 0.0) != side)
    turned ^= over_seam(p, x, y, side, x2, y2);
  else if (comes_back(p, side, x, y, x2, y2, &there, &found)) {
    turned ^= over_seam(p, x, y, side, there, found);
    turned ^= over_seam(p, there, found, !side, x2, y2);
  }
  wind_to(k, turned, ref, out);
}

/* One point of a path at x, in principal coordinates, to its branch, from the anchors around it.

   Where both are on one branch and one side of y = 0, points there too are on it; where they are on
   two sides, by the one on the same side; where one side has two branches, by following the path
   from the first, at x1; and by the nearer where signs tell nothing. Beside a pole v and theta
   swing by half a turn: a point is on the branch of the anchor that is nearer in theta. */
static void wind_between(const path_t *p, const double before[3], const double after[3], double x1,
                         int later, double x, double *out) {
  const winding_t *k = winding_of(p);
  if (!k->double_cover && fabs(after[2] - before[2]) > 0.25 * TURN) {
    const double theta = out[THETA], a = before[2], b = after[2];
    later = fabs(wound(theta, b, TURN) - b) < fabs(wound(theta, a, TURN) - a);
  }
  const double *ref = later ? after : before, u = out[U], v = out[V];
  if (k->double_cover && !on_seam(before[0], before[1]) && !on_seam(after[0], after[1])) {
    const int side = beyond(before[0], before[1]), cover = second_cover(before[1]);
    const int sides = side != beyond(after[0], after[1]), differs = beyond(u, 0.0) != side;
    if (!differs && !sides && cover == second_cover(after[1])) {
      wind_to(k, cover, ref, out);
      return;
    }
    if (!on_seam(u, v)) {
      if (!sides) {
        wind_along(p, x1, side_of(before[0], before[1]), before, x, out);
        return;
      }
      ref = differs ? after : before;
    }
  }
  wind(k, ref, out);
}
