/* Gauss collocation in panels, the compiled twin of panels.integrate (same steps, same tests).

   X' = f(X, sigma(tau), decay(tau)) on tau in [0, length] for nb bodies in lockstep; the last
   n_stiff states V obey V' = f_V - lam(tau) V, whose linear part is solved implicitly.
   The includer defines RHS (a kernel loop, see Kernel.loop), NX, NC, N (nodes) and RESTORES, the restore_t by
   which the end of a panel is put back on its surfaces, {0} last; NESTED if the last so many states are the
   rates of as many before them and nothing else depends on them; ONE_PANEL if it calls panel itself; DRIVES 3
   if RHS takes local time after sigma and decay.

   Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, II.7: collocation at Gauss
   points conserves quadratic invariants, here F(x), |p|, |q|, p.q of every quadric. */

#ifndef DRIVES
#define DRIVES 2
#endif
#ifndef NESTED
#define NESTED 0
#endif
#define CONVERGED 1e-2 /* of the tolerance */

/* A panel shortened: ln(decay) may fall by so much, also if it goes on as at the start, so that the first node
   still sees a layer there. A gain that grows later is seen by the other nodes. */
static double longest(const drive_t *d, const method_t *m, double tau, double h, double steepest) {
  if (m->slip <= 0) return h;
  const double first = gain_at(d, tau), lost = horner(d->exponent, d->n_exponent, tau);
  for (int k = 0; k < 60; k++) {
    const double lam = fmax(first, (horner(d->exponent, d->n_exponent, tau + h) - lost) / h);
    if (lam * h <= steepest || lost > 40.0) break;
    h = fmax(0.5 * h, 0.99 * steepest / lam);
  }
  return h;
}

/* inverse of I + h/2 Q diag(lam), transposed: by Gauss and Jordan in place, with row pivots. Single numbers
   are stored long before their row is loaded again: a load across a fresh store would wait for it. */
static int implicit(const method_t *m, const double *lam, double half, double *inv) {
  double(*a)[N] = (double(*)[N])inv;
  int pivot[N];
  for (int i = 0; i < N; i++)
    for (int j = 0; j < N; j++) a[i][j] = half * lam[i] * m->integral[i * N + j] + (i == j);
#pragma GCC unroll 1
  for (int k = 0; k < N; k++) {
    int p = k;
    for (int i = k + 1; i < N; i++)
      if (fabs(a[i][k]) > fabs(a[p][k])) p = i;
    if (a[p][k] == 0.0) return 1;
    pivot[k] = p;
    for (int j = 0; j < N && p != k; j++) {
      const double t = a[k][j];
      a[k][j] = a[p][j], a[p][j] = t;
    }
    const double scale = 1.0 / a[k][k];
    lanes_t row[PARTS];
    UNROLL for (int q = 0; q < PARTS; q++) {
      row[q] = scale * *(lanes_t *)(a[k] + q * LANES);
      *(lanes_t *)(a[k] + q * LANES) = row[q];
    }
#pragma GCC unroll 1
    for (int i = 0; i < N; i++) {
      if (i == k) continue;
      const double t = a[i][k];
      UNROLL for (int q = 0; q < PARTS; q++) *(lanes_t *)(a[i] + q * LANES) -= t * row[q];
      a[i][k] = -t * scale;
    }
    a[k][k] = scale;
  }
  for (int k = N - 1; k >= 0; k--)
    for (int i = 0; i < N && pivot[k] != k; i++) {
      const double t = a[i][k];
      a[i][k] = a[i][pivot[k]], a[i][pivot[k]] = t;
    }
  return 0;
}

static double dot(const double *a, const double *b) {
  double sum = 0.0;
#pragma omp simd reduction(+ : sum)
  for (int i = 0; i < N; i++) sum += a[i] * b[i];
  return sum;
}

/* The terms of a known series at the nodes of a panel `ratio` times as long, from its end (1) or start (-1):
   basis[N + 1][N] */
static void continuation(const method_t *m, double ratio, double from, double *basis) {
  double twice[N];
  for (int i = 0; i < N; i++) {
    basis[i] = 1.0, basis[N + i] = from + ratio * (1.0 + m->node[i]);
    twice[i] = 2.0 * basis[N + i];
  }
  for (int k = N; k < N * N; k += N)
#pragma omp simd
    for (int i = 0; i < N; i++) basis[k + N + i] = twice[i] * basis[k + i] - basis[k - N + i];
}

/* One sweep: f at the nodes, then x = start + h/2 Q f (V: the implicit form). Returns the change. */
static double sweep(const method_t *m, const double *start, const double *c, const double *scale,
                    double half, const double *lam, const double *inv, double x[NX + DRIVES][N],
                    double f[NX][N]) {
#if DRIVES > 2
  static const long rows_in[] = {IN_ROWS, (NX + 2) * N}, rows_out[] = {OUT_ROWS};
#else
  static const long rows_in[] = {IN_ROWS}, rows_out[] = {OUT_ROWS};
#endif
  double y[NX][N], g[N], worst[N] = {0}, change = 0.0, none = 0.0;
  RHS(1, N, &x[0][0], rows_in, 0, c, &f[0][0], rows_out, 0);
  combine(m->integral, N, NX - 2 * NESTED, f[0], N, start, half, y[0], N);
  if (NESTED) {
    const long at = NX - 2 * NESTED;
    combine(m->twice, N, NESTED, f[at + NESTED], N, start + at, half * half, y[at], N);
    for (long s = at; s < at + NESTED; s++) {
      const double rate = half * start[s + NESTED];
#pragma omp simd
      for (int i = 0; i < N; i++) y[s][i] += rate * (1.0 + m->node[i]);
    }
  }
  for (long s = NX - m->n_stiff; s < NX; s++) {
    combine(inv, N, 1, y[s], N, NULL, 1.0, g, N);
#pragma omp simd
    for (int i = 0; i < N; i++) y[s][i] = g[i], f[s][i] -= lam[i] * g[i];
  }
  for (long s = 0; s < NX - NESTED; s++) {
#pragma omp simd
    for (int i = 0; i < N; i++) {
      double d = fabs(y[s][i] - x[s][i]) * scale[s];
      worst[i] = d > worst[i] ? d : worst[i];
      x[s][i] = y[s][i];
    }
    none += 0.0 * y[s][0]; /* a maximum drops a NaN, but one at a node is at all of them after a sweep */
  }
#pragma omp simd reduction(max : change)
  for (int i = 0; i < N; i++) change = worst[i] > change ? worst[i] : change;
  return none == 0.0 ? change : HUGE_VAL;
}

/* Whether the panel is so much too long that its tail tells before the sweeps have converged. */
static int hopeless(const method_t *m, double half, const double *scale, double f[NX][N]) {
  for (long r = NX - 2 * NESTED < NX - NESTED ? NX - NESTED : 0; r < NX; r++)
    if (TAIL * fabs(half * dot(m->series + N * N, f[r])) * scale[r] > 100.0 * m->tolerance) return 1;
  return 0;
}

/* What is put back of a state: n numbers from `row`, by a kernel with n_constants numbers from `constant` */
typedef struct {
  void (*kernel)(long, long, const double *, const long *, long, const double *, double *, const long *, long);
  long n, row, constant, n_constants;
} restore_t;

/* Put states [nb][NX] back on their surfaces; of bodies on the same ones side by side. Returns the greatest
   change. */
static double restore(long nb, double *state, const double *constants, const double *scale) {
  static const restore_t parts[] = {RESTORES};
  double from[NX * LANES], to[NX * LANES], moved = 0.0;
  long rows[NX];
  for (const restore_t *p = parts; p->kernel; p++)
    for (long b = 0, m; b < nb; b += m) {
      const double *c = constants + b * NC + p->constant, *size = scale + b * NX + p->row;
      double *own = state + b * NX + p->row;
      for (m = 1; m < LANES && b + m < nb; m++)
        if (memcmp(c, c + m * NC, p->n_constants * sizeof *c)) break;
      const long lanes = m > 1 ? LANES : 1; /* the last body fills those that are left */
      for (long r = 0; r < p->n; r++) {
        rows[r] = r * lanes;
        for (long i = 0; i < lanes; i++) from[r * lanes + i] = own[(i < m ? i : m - 1) * NX + r];
      }
      p->kernel(1, lanes, from, rows, 0, c, to, rows, 0);
      for (long r = 0; r < p->n; r++)
        for (long i = 0; i < m; i++) {
          const double off = fabs(to[r * lanes + i] - own[i * NX + r]) * size[i * NX + r];
          moved = off > moved ? off : moved;
          own[i * NX + r] = to[r * lanes + i];
        }
    }
  return moved;
}

/* One panel from s->tau: state[nb][NX] to panel_state[nb][NX], both known on the surfaces, and its
   series out[body][NX][N+1]. Returns 1; 0: refused, s->h is what to try next; -2: no solution.
   work: (2 NX + DRIVES) * N doubles. */
static int panel(long nb, const double *state, const double *constants, const double *scale,
                 const drive_t *drive, const method_t *m, step_t *s, double *out, double *work,
                 double *panel_state) {
  const double tau = s->tau;
  double h = s->h, lam[N], inv[N * N], basis[(N + 1) * N];
  h = longest(drive, m, tau, h < m->length - tau ? h : m->length - tau, STEEPEST);
  double after = tau + h;
  if (after >= m->length * (1 - 1e-14)) after = m->length;
  double half = 0.5 * (after - tau), t[N], sig[N], dec[N] = {0};
  for (int i = 0; i < N; i++) {
    t[i] = tau + half * (1.0 + m->node[i]);
    sig[i] = horner(drive->sigma, drive->n_sigma, t[i]);
    if (m->n_stiff) lam[i] = gain_at(drive, t[i]);
  }
  if (m->slip > 0) decays(drive, t, sig, N, dec);
  if (m->n_stiff && implicit(m, lam, half, inv)) return -2;
  /* Picard sweeps start from the last panel's series where that reaches (28 % fewer of them), or
     from that of the longer panel that was refused */
  int known = s->before && after - tau <= (s->begins ? 1.0 : 2.0) * s->length;
  if (known) continuation(m, (after - tau) / s->length, s->begins ? -1.0 : 1.0, basis);
  double error = 0.0;
  for (long b = 0; b < nb; b++) {
    double(*x)[N] = (double(*)[N])(work);
    double(*f)[N] = (double(*)[N])(work + (NX + DRIVES) * N);
    const double *start = state + b * NX, *c = constants + b * NC, *sc = scale + b * NX;
    if (known)
      combine(basis, N + 1, NX, s->before + b * NX * (N + 1), N + 1, NULL, 1.0, x[0], N);
    else
      for (long r = 0; r < NX; r++) {
        const int goes = r >= NX - 2 * NESTED && r < NX - NESTED;
        const double rate = goes ? half * start[r + NESTED] : 0.0;
        for (int i = 0; i < N; i++) x[r][i] = start[r] + rate * (1.0 + m->node[i]);
      }
    memcpy(x[NX], sig, sizeof sig);
    memcpy(x[NX + 1], dec, sizeof dec);
    if (DRIVES > 2) memcpy(x[NX + DRIVES - 1], t, sizeof t);
    double last = HUGE_VAL, change = HUGE_VAL, converged = CONVERGED;
    /* rates do not show in a nested change: they change by more, as the panel is shorter than what moves; where
       it is much shorter, as on blades, axes were off by two tolerances without the square */
    for (long r = NX - NESTED; r < NX; r++) {
      const double part = half * sc[r - NESTED] / sc[r];
      converged = fmin(converged, CONVERGED * part * fmin(1.0, 4.0 * part));
    }
    int k = 0;
    for (; k < SWEEPS; k++) {
      change = sweep(m, start, c, sc, half, lam, inv, x, f);
      /* sweeps converge ever faster: the next changes less than this one by what this did. A first
         one tells nothing of that where it is large, as a continued series was far off, and of what
         is stiff, as all that was wrong is gone at one stroke. */
      const int tells = k > 1 || (last < 0.01 && !m->n_stiff);
      double next = tells && change < 0.3 * last ? change * (change / last) : change;
      if (next <= m->tolerance * converged || change <= 4e-16) break;
      if (k > 6 && change <= 1e-13 && change > 0.25 * last) break;
      if (!(change < 1e10) || (k > 3 && change > 4.0 * last)) { k = SWEEPS; break; }
      if (k == 3 && hopeless(m, half, sc, f)) break;
      last = change;
    }
    if (k >= SWEEPS) {
      if (s->begins) s->before = NULL;
      s->h = 0.35 * (after - tau);
      return 0;
    }
    if (NESTED) {
      const long at = NX - NESTED;
      combine(m->integral, N, NESTED, f[at], N, start + at, half, x[at], N);
      memcpy(f[at - NESTED], x[at], NESTED * sizeof f[0]);
    }
    combine(m->series, N, NX, f[0], N, NULL, half, out + b * NX * (N + 1), N + 1);
    for (long r = 0; r < NX; r++) {
      double *o = out + (b * NX + r) * (N + 1), top;
      top = dot(m->series + N * N, f[r]);
      o[N] = half * top, o[0] += start[r];
      double tail = fabs(o[N]), last_but_one = 0.1 * fabs(o[N - 1]);
      tail = TAIL * (tail > last_but_one ? tail : last_but_one) * sc[r];
      error = tail > error ? tail : error;
      panel_state[b * NX + r] = r >= NX - m->n_stiff ? dot(m->end + N, x[r])
                                                     : start[r] + half * dot(m->end, f[r]);
    }
  }
  /* what must be put back tells of the panel's error too */
  const double moved = restore(nb, panel_state, constants, scale);
  if (moved > 1e-13 && 0.1 * moved > error) error = 0.1 * moved;
  if (!(error <= m->tolerance)) {
    double shrink = 0.9 * pow(m->tolerance / error, 1.0 / N);
    s->h = (after - tau) * (shrink > 0.35 ? (shrink < 0.8 ? shrink : 0.8) : 0.35);
    s->length = after - tau, s->before = out, s->begins = 1;
    return 0;
  }
  double grow = fmin(2.0, 0.9 * pow(m->tolerance / (error > 1e-30 ? error : 1e-30), 1.0 / N));
#ifdef REACH
  double far = 1e-30; /* sizes that the panel spans */
  for (long r = 0; r < nb * NX; r++) {
    const double way = fabs(panel_state[r] - state[r]) * scale[r];
    far = way > far ? way : far;
  }
  grow = fmin(grow, REACH / far);
#endif
  s->h = shared((after - tau) * grow, m->length - after);
  s->length = after - tau, s->before = out, s->tau = after, s->begins = 0;
  return 1;
}

#ifndef ONE_PANEL
/* Returns the number of panels, or -1 (no room: call again with more), -2 (no convergence), -3 (more
   panels than MOST_PANELS would be needed).
   edges[max_panels + 1], coefficients[panel][body][NX][N+1], state[nb][NX] in and out,
   work: (2 NX + 2) * N doubles, panel_state: nb * NX doubles. */
long panels(long nb, double *state, const double *constants, const double *scale,
            const drive_t *drive, method_t *m, double *edges, double *coefficients,
            double *work, double *panel_state) {
  const double wide = pow(m->tolerance / 1e-13, 1.0 / N), first = m->first * wide;
  step_t s = {.h = longest(drive, m, 0.0, fmin(first, m->length), fmin(STEEPEST, FALL * wide))};
  long count = 0, tries = 0;
  double mark = 0.0;
  edges[0] = 0.0;
  while (s.tau < m->length) {
    m->reached = s.tau;
    if (count == m->max_panels) return -1;
    /* a layer at the start may be as thin as it likes */
    if (++tries > 40 * (count + 25) || !(s.h > 1e-15 * s.tau + 1e-30 * m->length)) return -2;
    if (count && count % MANY == 0 && s.tau > mark) {
      if (MANY * (m->length - s.tau) > MOST_PANELS * (s.tau - mark)) return -3;
      mark = s.tau;
    }
    double *out = coefficients + count * nb * NX * (N + 1);
    int made = panel(nb, state, constants, scale, drive, m, &s, out, work, panel_state);
    if (made < 0) return -2;
    if (!made) continue;
    memcpy(state, panel_state, (size_t)(nb * NX) * sizeof(double));
    edges[++count] = s.tau;
    if (m->slip > 0 && m->finish > 0 && s.tau < m->length) {
      double speed = horner(drive->sigma, drive->n_sigma, s.tau), left;
      decays(drive, &s.tau, &speed, 1, &left);
      if (m->slip * left <= m->finish) {
        m->released = s.tau;
        if (m->stops) break;
        m->slip = 0.0; /* from here on decay is not evaluated, nor resolved */
        s.h = first;
      }
    }
  }
  return count;
}
#endif
