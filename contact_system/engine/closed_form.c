/* Curves that need no integration: great circles, and lines on developable surfaces.

   Rounding of a phase grows with the phase. Beyond FAR_PHASE radians it is computed in doubled
   precision, after Dekker: 256 rad leave an error of 256 * 1.1e-16 * 2 = 6e-14 of the radius. */

static const double FAR_PHASE = 256.0;

static twofold_t twofold_length(const drive_t *d, double tau) {
  twofold_t s = twofold(0.0);
  for (int64_t k = d->n_sigma - 1; k >= 0; k--)
    s = times(plus(s, over(twofold(d->sigma[k]), twofold((double)k + 1.0))), twofold(tau));
  return s;
}

/* ---- great circles ---- */

/* The circle through x with frame p, q, along w */
static void lay_circle(work_t *w, const double *state, track_t *k) {
  const body_t *b = k->body;
  double q[3];
  run_body(w, b, IN_SPACE, A_SECOND, state, q);
  const double length = hypot(k->w[0], k->w[1]);
  /* a contact point at rest has no direction; p will do */
  k->direction[0] = length > 0 ? k->w[0] / length : 1.0,
  k->direction[1] = length > 0 ? k->w[1] / length : 0.0;
  for (int j = 0; j < 3; j++) {
    const double p = state[3 + j];
    k->at[j] = state[j];
    k->along[j] = k->direction[0] * p + k->direction[1] * q[j];
    k->across[j] = k->direction[0] * q[j] - k->direction[1] * p;
  }
  k->kind = CIRCLE, k->rate = length / b->size;
  k->long_path = k->rate * length_at(k->drive, k->stop - k->drive->start) > FAR_PHASE;
}

/* (x, p) at phases, or x alone */
static void circle_at(const track_t *k, const double *phase, int rows, lanes_t state) {
  const double radius = k->body->size;
  double s[L], c[L];
  sincos_of(phase, s, c, L);
  for (int j = 0; j < 3; j++) {
    const double x = k->at[j], e = radius * k->along[j], back = k->at[j] / radius;
    const double a0 = k->direction[0], off = k->direction[1] * k->across[j];
    EACH_LANE(i) state[j][i] = x * c[i] + e * s[i];
    if (rows == 3) continue;
    EACH_LANE(i) state[3 + j][i] = a0 * (k->along[j] * c[i] - back * s[i]) - off;
  }
}

/* Phases in [0, 2 pi) at local times, and how many revolutions came before */
static void phases(const track_t *k, const double *tau, double *phase, double *turns) {
  double length[L];
  horners(k->drive->length, k->drive->n_sigma + 1, tau, length);
  for (int i = 0; i < L; i++) {
    double angle = k->rate * length[i], before = 0.0;
    if (k->long_path) {
      const twofold_t rate = over(twofold_norm(k->w[0], k->w[1]), twofold(k->body->size));
      angle = without_turns(times(rate, twofold_length(k->drive, tau[i])), &before);
    }
    const double more = floor(angle / TURN);
    phase[i] = angle - more * TURN, turns[i] = before + more;
  }
}

/* ---- lines on developable surfaces ---- */

/* Chart components of y, a vector in the parallel frame */
static void chart_slope(work_t *w, const body_t *b, const double *state, const double *y,
                        double *slope) {
  double lame[3], turned[2];
  run_body(w, b, IN_CHART, C_LAME, state, lame);
  run_one(w, contact_tables + T_TURNED, NULL, (double[3]){state[2], y[0], y[1]}, turned);
  for (int a = 0; a < 2; a++) slope[a] = turned[a] / lame[a];
}

static void lay_line(work_t *w, const double *state, track_t *k) {
  memcpy(k->begin, state, sizeof k->begin);
  chart_slope(w, k->body, state, k->w, k->slope);
  k->kind = LINE;
  const double length = length_at(k->drive, k->stop - k->drive->start);
  for (int a = 0; a < 2; a++)
    k->long_path |= fabs(k->slope[a] * length) + fabs(state[a]) > FAR_PHASE * k->body->size;
}

/* u, v, theta at local times; with `reduced`, whole turns are taken off long paths. */
static void line_at(const track_t *k, const double *tau, int reduced, lanes_t state) {
  const surface_t *s = k->body->surface;
  double length[L], g[1][L];
  horners(k->drive->length, k->drive->n_sigma + 1, tau, length);
  memset(g, 0, sizeof g);
  if (k->panels.n) panels_at(&k->panels, 0, 1, tau, g);
  for (int a = 0; a < 2; a++) {
    EACH_LANE(i) state[a][i] = k->begin[a] + k->slope[a] * length[i];
    for (int i = 0; i < L && reduced && k->long_path; i++) {
      twofold_t at = times(twofold(k->slope[a]), twofold_length(k->drive, tau[i]));
      double turns;
      at = plus(at, twofold(k->begin[a]));
      const int closes = (a ? s->period_v : s->period_u) > 0;
      state[a][i] = closes ? without_turns(at, &turns) : at.high + at.low;
    }
    EACH_LANE(i) state[a][i] += k->offset[a] * tau[i] - k->aside[a] * g[0][i];
  }
  fill_lanes(state[2], k->begin[2]);
}
