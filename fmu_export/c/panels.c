/* Gauss collocation in panels: X' = f(X, sigma, decay, tau) on local time, one panel at a time.

   The length of a panel follows the decay of the solution's Chebyshev series, which is also the
   dense output. Collocation at Gauss points conserves quadratic invariants: F(x), |p| of every
   quadric (Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, II.7). The last
   states V may carry the term -lam V, which is solved implicitly. */
#include "component.h"
#include "gauss.inc"

#define TAIL 3.6      /* times a series' last coefficient is taken for its error */
#define STEEPEST 20.0 /* fall of ln(decay) in a panel */
#define SWEEPS 40

/* A panel shortened: ln(decay) may fall by so much, also if it goes on as at the start, so that the
   first node still sees a layer there. A gain that grows later is seen by the other nodes. */
static double longest(const method_t *m, double tau, double h) {
  const drive_t *d = m->drive;
  if (m->slip <= 0) return h;
  const double first = gain_at(d, tau), lost = horner(d->exponent, d->n_exponent, tau);
  for (int k = 0; k < 60; k++) {
    const double fall = horner(d->exponent, d->n_exponent, tau + h) - lost;
    const double lam = fmax(first, fall / h);
    if (lam * h <= STEEPEST || lost > 40.0) break;
    h = fmax(0.5 * h, 0.99 * STEEPEST / lam);
  }
  return h;
}

/* A step's length, or half of what is left: a short last one costs as much as a long one. */
static double shared(double h, double left) {
  if (!(h < left && left < 2.0 * h)) return h;
  return left < 1.03 * h ? left : 0.5 * left; /* 1.03: the tail that is expected is in tolerance */
}

/* inverse of I + h/2 Q diag(lam), transposed, by Gauss and Jordan with row pivots */
static int implicit(const double *lam, double half, double inverse[L][L]) {
  double a[L][2 * L];
  for (int i = 0; i < L; i++)
    for (int j = 0; j < L; j++)
      a[i][j] = half * lam[i] * gauss_integral[i * L + j] + (i == j), a[i][L + j] = i == j;
  for (int k = 0; k < L; k++) {
    int p = k;
    for (int i = k + 1; i < L; i++)
      if (fabs(a[i][k]) > fabs(a[p][k])) p = i;
    if (!(a[p][k] != 0.0)) return 1;
    for (int j = 0; j < 2 * L && p != k; j++) {
      const double t = a[k][j];
      a[k][j] = a[p][j], a[p][j] = t;
    }
    const double scale = 1.0 / a[k][k];
    for (int j = 0; j < 2 * L; j++) a[k][j] *= scale;
    for (int i = 0; i < L; i++) {
      const double t = a[i][k];
      for (int j = 0; j < 2 * L && i != k && t != 0.0; j++) a[i][j] -= t * a[k][j];
    }
  }
  for (int i = 0; i < L; i++) memcpy(inverse[i], a[i] + L, sizeof *inverse);
  return 0;
}

/* y[r] = start[r] + half sum_j f[r][j] q[j], rows of f and y being so far apart; start may be NULL.
   Eight sums at a time stay in registers. */
static void combine(const double *q, int terms, long rows, const double *f, int f_row,
                    const double *start, double half, double *y, int y_row) {
  for (long r = 0; r < rows; r++, f += f_row, y += y_row)
    for (int h = 0; h < L; h += 8) {
      double s[8] = {0};
      for (int j = 0; j < terms; j++) {
        const double x = f[j], *p = q + j * L + h;
        s[0] += x * p[0], s[1] += x * p[1], s[2] += x * p[2], s[3] += x * p[3];
        s[4] += x * p[4], s[5] += x * p[5], s[6] += x * p[6], s[7] += x * p[7];
      }
      for (int i = 0; i < 8; i++) y[h + i] = (start ? start[r] : 0.0) + half * s[i];
    }
}

static double dot(const double *a, const double *b) {
  double sum = 0.0;
  for (int i = 0; i < L; i++) sum += a[i] * b[i];
  return sum;
}

/* The states at the nodes of a panel `ratio` times as long as a known series, from its end (1) or
   its start (-1) on */
static void continued(const double *series, long rows, double ratio, double from, double *x) {
  double basis[TERMS][L];
  for (int i = 0; i < L; i++) {
    const double xi = basis[1][i] = from + ratio * (1.0 + gauss_node[i]);
    basis[0][i] = 1.0;
    for (int k = 2; k < TERMS; k++) basis[k][i] = 2.0 * xi * basis[k - 1][i] - basis[k - 2][i];
  }
  combine(basis[0], TERMS, rows, series, TERMS, NULL, 1.0, x, L);
}

/* a panel on its way: what the rates take at nodes (states, sigma, decay, local time) and give */
typedef struct {
  double half, x[MAX_STATES + 3][L], f[MAX_STATES][L], lam[L], inverse[L][L];
} nodes_t;

/* One sweep: f at the nodes, x = start + h/2 Q f (V: the implicit form). Returns the change. */
static double sweep(const method_t *m, const double *start, nodes_t *p) {
  const long n = m->motion->n_states;
  double y[MAX_STATES][L], g[L], change = 0.0, none = 0.0;
  m->motion->rates(p->x, m->constants, p->f);
  combine(gauss_integral, L, n, p->f[0], L, start, p->half, y[0], L);
  for (long s = n - m->motion->n_stiff; s < n; s++) {
    combine(p->inverse[0], L, 1, y[s], L, NULL, 1.0, g, L);
    for (int i = 0; i < L; i++) y[s][i] = g[i], p->f[s][i] -= p->lam[i] * g[i];
  }
  for (long s = 0; s < n; s++) {
    double worst = 0.0;
    for (int i = 0; i < L; i++) {
      const double far = fabs(y[s][i] - p->x[s][i]);
      worst = far > worst ? far : worst;
    }
    change = fmax(change, worst * m->scale[s]);
    none += 0.0 * y[s][0]; /* a maximum drops a NaN, but one at a node is at all after a sweep */
    memcpy(p->x[s], y[s], sizeof y[s]);
  }
  return none == 0.0 ? change : HUGE_VAL;
}

/* Whether the panel is so much too long that its tail tells before the sweeps have converged. */
static int hopeless(const method_t *m, const nodes_t *p) {
  for (long r = 0; r < m->motion->n_states; r++)
    if (TAIL * fabs(p->half * dot(gauss_top, p->f[r])) * m->scale[r] > 100.0 * TOLERANCE) return 1;
  return 0;
}

/* Sweeps until x holds still. Returns 0 where they do not converge. */
static int converge(const method_t *m, const double *start, nodes_t *p) {
  double last = HUGE_VAL;
  for (int k = 0; k < SWEEPS; k++) {
    const double change = sweep(m, start, p);
    /* Sweeps converge ever faster: the next changes less than this one by what this did. A first
       one tells nothing of that where it is large, as a continued series was far off; nor of what
       is stiff, as all that was wrong is gone at one stroke. */
    const int tells = k > 1 || (last < 0.01 && !m->motion->n_stiff);
    const double next = tells && change < 0.3 * last ? change * (change / last) : change;
    if (next <= 1e-2 * TOLERANCE || change <= 4e-16) return 1;
    if (k > 6 && change <= 1e-13 && change > 0.25 * last) return 1;
    if (!(change < 1e10) || (k > 3 && change > 4.0 * last)) return 0;
    if (k == 3 && hopeless(m, p)) return 1;
    last = change;
  }
  return 0;
}

double restore(const motion_t *motion, const double *constants, const double *scale,
               double *state) {
  double back[MAX_STATES], most = 0.0, none = 0.0;
  if (!motion->restore) return 0.0;
  motion->restore((const double *const[]){state, constants}, back);
  for (long r = 0; r < motion->n_states; r++) {
    most = fmax(most, fabs(back[r] - state[r]) * scale[r]);
    none += 0.0 * back[r];
    state[r] = back[r];
  }
  return none == 0.0 ? most : HUGE_VAL;
}

/* The series of a converged panel and the state at its end; returns the error. */
static double close_panel(const method_t *m, const double *start, nodes_t *p, double *series,
                          double *end) {
  const motion_t *motion = m->motion;
  double error = 0.0;
  combine(gauss_series, L, motion->n_states, p->f[0], L, NULL, p->half, series, TERMS);
  for (long r = 0; r < motion->n_states; r++) {
    double *c = series + r * TERMS;
    c[L] = p->half * dot(gauss_top, p->f[r]), c[0] += start[r];
    error = fmax(error, TAIL * fmax(fabs(c[L]), 0.1 * fabs(c[L - 1])) * m->scale[r]);
    end[r] = r >= motion->n_states - motion->n_stiff
                 ? dot(gauss_last, p->x[r])
                 : start[r] + p->half * dot(gauss_weight, p->f[r]);
  }
  /* what must be put back tells of the panel's error too */
  const double back = restore(motion, m->constants, m->scale, end);
  return back > 1e-13 ? fmax(error, 0.1 * back) : error;
}

int panel(const method_t *m, step_t *s, const double *start, double *series, double *end) {
  const motion_t *motion = m->motion;
  const drive_t *d = m->drive;
  const long n = motion->n_states;
  const double left = m->length - s->tau;
  double after = s->tau + longest(m, s->tau, s->h < left ? s->h : left);
  if (after >= m->length * (1 - 1e-14)) after = m->length;
  const double span = after - s->tau;
  nodes_t p = {.half = 0.5 * span};
  double *sigma = p.x[n], *decay = p.x[n + 1], *t = p.x[n + 2];
  for (int i = 0; i < L; i++) {
    t[i] = s->tau + p.half * (1.0 + gauss_node[i]);
    sigma[i] = horner(d->sigma, d->n_sigma, t[i]);
    if (m->slip > 0) decay[i] = decay_at(d, t[i], sigma[i]);
    if (motion->n_stiff) p.lam[i] = gain_at(d, t[i]);
  }
  if (motion->n_stiff && implicit(p.lam, p.half, p.inverse)) return -1;
  /* sweeps start from the last panel's series (28 % fewer of them), or from that of the longer
     panel that was refused */
  if (s->before && span <= (s->begins ? 1.0 : 2.0) * s->span)
    continued(s->before, n, span / s->span, s->begins ? -1.0 : 1.0, p.x[0]);
  else
    for (long r = 0; r < n; r++)
      for (int i = 0; i < L; i++) p.x[r][i] = start[r];
  if (!converge(m, start, &p)) {
    if (s->begins) s->before = NULL;
    s->h = 0.35 * span;
    return 0;
  }
  const double error = close_panel(m, start, &p, series, end);
  /* an error below 1e-30 says no more than one of 1e-30 */
  const double ratio = 0.9 * pow(TOLERANCE / fmax(error, 1e-30), 1.0 / L);
  s->span = span, s->before = series;
  if (!(error <= TOLERANCE)) {
    s->h = span * fmin(fmax(ratio, 0.35), 0.8), s->begins = 1;
    return 0;
  }
  double far = 1e-30; /* sizes that the panel spans */
  for (long r = 0; r < n; r++) far = fmax(far, fabs(end[r] - start[r]) * m->scale[r]);
  s->h = shared(span * fmin(fmin(ratio, 2.0), motion->reach / far), m->length - after);
  s->tau = after, s->begins = 0;
  return 1;
}
