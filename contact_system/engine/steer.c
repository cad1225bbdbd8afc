/* Where paths of legs end on spheres and planes, and how ends move with legs: theory section 11. */

enum { MOST_LEGS = 8 };

/* Jacobi fields along legs of lengths s from the Gaussian curvature at their Gauss points, [n][L]:
   J J' M M' at these and at the end, [n][L + 1][4]. Volterra's equation, by iteration: its error
   falls like x^2k/(2k)!, x = sqrt K s. */
static void fields(int64_t n, const double *curvature, const double *s, double *out) {
  for (int64_t leg = 0; leg < n; leg++, curvature += L, out += 4 * (L + 1))
    for (int which = 0; which < 2; which++) { /* y = J/s, then M, of x from 0 to 1 */
      double y[L], rate[L], slope[L], rise[L], change = 1.0;
      for (int i = 0; i < L; i++) y[i] = which ? 1.0 : 0.5 * (1.0 + gauss_node[i]);
      for (int sweep = 0; sweep < 200 && change > 1e-15; sweep++) {
        change = 0.0;
        for (int i = 0; i < L; i++) rate[i] = -curvature[i] * s[leg] * s[leg] * y[i];
        combine(gauss_integral, L, 1, rate, L, NULL, 0.5, slope, L);
        combine(gauss_integral, L, 1, slope, L, NULL, 0.5, rise, L);
        for (int i = 0; i < L; i++) {
          const double now = rise[i] + (which ? 1.0 : 0.5 * (1.0 + gauss_node[i]));
          change = fmax(change, fabs(now - y[i])), y[i] = now;
        }
      }
      const double unit = which ? 1.0 : s[leg], each = s[leg] != 0 ? 1.0 / s[leg] : 0.0;
      for (int i = 0; i <= L; i++) {
        const double steep = i < L ? slope[i] : 0.5 * dot(gauss_weight, rate);
        const double value = i < L ? y[i] : 1.0 + 0.5 * dot(gauss_weight, slope);
        out[4 * i + 2 * which] = unit * value;
        out[4 * i + 2 * which + 1] = which ? steep * each : 1.0 + steep;
      }
    }
}

/* How the end of a path moves along p and q of its carried frame, and how that frame turns: for a
   turn of each leg, then for each metre of its length. along: J J' M M' of each leg. */
static void shift_end(int64_t n, const double *ways, const double *along, double *out) {
  for (int64_t k = 0; k < n; k++) {
    const double cosine = cos(ways[k]), sine = sin(ways[k]), *f = along + 4 * k;
    for (int64_t i = 0; i < 2 * n; i++) {
      if (i % n >= k) continue;
      double *m = out + 3 * i;
      const double ahead = cosine * m[0] + sine * m[1], aside = cosine * m[1] - sine * m[0];
      const double moved = f[2] * aside + f[0] * m[2];
      m[0] = cosine * ahead - sine * moved, m[1] = sine * ahead + cosine * moved;
      m[2] = f[1] * m[2] + f[3] * aside;
    }
    double *turned = out + 3 * k, *longer = out + 3 * (n + k);
    turned[0] = -sine * f[0], turned[1] = cosine * f[0], turned[2] = f[1] - 1.0;
    longer[0] = cosine, longer[1] = sine, longer[2] = 0.0;
  }
}

static void shifts(int64_t m, int64_t n, const double *ways, const double *along, double *out) {
  for (int64_t i = 0; i < m; i++) shift_end(n, ways + i * n, along + 4 * i * n, out + 6 * i * n);
}

typedef struct {
  double re, im;
} complex_t;

static complex_t product(complex_t x, complex_t y) {
  return (complex_t){x.re * y.re - x.im * y.im, x.re * y.im + x.im * y.re};
}

/* A motion of a surface of curvature K: |a|^2 + K |b|^2 = 1, half a quaternion each on a sphere; on
   the plane a turn by 2 arg a and a move by 2 a b */
typedef struct {
  complex_t a, b;
} motion2_t;

/* One body's path from the goal's frame on; its shifts to out[2 n][3], lengths along s */
static motion2_t rolled(const steer_t *aim, int side, int64_t n, const double *z, double *out) {
  const double k = aim->curvature[side], root = sqrt(k), sign = side ? -1.0 : 1.0;
  double ways[MOST_LEGS], along[4 * MOST_LEGS];
  const double *back = aim->back[side];
  motion2_t at = {{back[0], back[1]}, {back[2], back[3]}};
  for (int64_t i = 0; i < n; i++) {
    const double s = z[n + i] * aim->pace, way = sign * (z[i] + aim->lean) - side * aim->psi;
    const double rise = k > 0 ? sin(0.5 * root * s) / root : 0.5 * s;
    const double half = k > 0 ? cos(0.5 * root * s) : 1.0, slope = 1.0 - 2.0 * k * rise * rise;
    double *f = along + 4 * i;
    f[0] = 2.0 * rise * half, f[1] = f[2] = slope, f[3] = -k * f[0], ways[i] = way;
    const complex_t step = {rise * cos(way), rise * sin(way)}, against = {step.re, -step.im};
    const complex_t turned = product(at.b, against), moved = product(at.a, step);
    at = (motion2_t){{at.a.re * half - k * turned.re, at.a.im * half - k * turned.im},
                     {moved.re + at.b.re * half, moved.im + at.b.im * half}};
  }
  shift_end(n, ways, along, out);
  for (int64_t i = 0; i < 6 * n; i++) out[i] *= i < 3 * n ? sign : aim->pace;
  return at;
}

/* How far a path z, n directions and n lengths, ends from the goal: two rows for each body on which
   a place is wanted, in sizes, and two for psi; slopes[rows][2 n]. Returns how many rows. */
static int64_t steered(const steer_t *aim, int64_t n, const double *z, double *off,
                       double *slopes) {
  double moves[2][6 * MOST_LEGS];
  motion2_t end[2];
  int64_t rows = 0;
  for (int side = 0; side < 2; side++) {
    end[side] = rolled(aim, side, n, z, moves[side]);
    if (!aim->wanted[side]) continue;
    const double unit = 1.0 / aim->size[side];
    const complex_t a = end[side].a, b = end[side].b;
    off[rows] = 2.0 * unit * b.re, off[rows + 1] = 2.0 * unit * b.im;
    for (int64_t i = 0; i < 2 * n; i++) {
      const double *m = moves[side] + 3 * i;
      const complex_t moved = product(a, (complex_t){m[0], m[1]});
      slopes[rows * 2 * n + i] = unit * (moved.re + b.im * m[2]);
      slopes[(rows + 1) * 2 * n + i] = unit * (moved.im - b.re * m[2]);
    }
    rows += 2;
  }
  if (!aim->turns) return rows;
  /* (a_1 a_2)^2 has the phase by which both frames turn, and psi is what they turn less */
  const complex_t whole = product(end[0].a, end[1].a);
  const complex_t half = product(whole, (complex_t){cos(aim->turn), sin(aim->turn)});
  const complex_t off_turn = product(half, whole);
  off[rows] = off_turn.re - 1.0, off[rows + 1] = off_turn.im;
  double *first = slopes + rows * 2 * n, *second = first + 2 * n;
  for (int64_t i = 0; i < 2 * n; i++) first[i] = second[i] = 0.0;
  for (int side = 0; side < 2; side++) {
    const complex_t a = end[side].a, b = end[side].b, other = product(half, end[1 - side].a);
    const double k = aim->curvature[side];
    for (int64_t i = 0; i < 2 * n; i++) {
      const double *m = moves[side] + 3 * i;
      const complex_t moved = product(b, (complex_t){m[0], -m[1]});
      const complex_t grown = {-m[2] * a.im - k * moved.re, m[2] * a.re - k * moved.im};
      const complex_t slope = product(other, grown);
      first[i] += slope.re, second[i] += slope.im;
    }
  }
  return rows + 2;
}
