/* Gauss collocation in panels: X' = f(X, sigma, decay) on local time, or arc length, [0, length].

   The length of a panel follows the decay of the solution's Chebyshev series, which is also the
   dense output. Collocation at Gauss points conserves quadratic invariants: F(x), |p| of every
   quadric (Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, II.7). The last
   two states may be V, whose stiff term -lam V is solved implicitly. */

static const double ROUNDING = 4e-16; /* of a state near 1, or of a series' tail */
static const double COARSE = 1e-6; /* coarser tolerances count as this: a tail says little there */
static const double TAIL = 3.6;    /* ratio of the error to a series' last coefficient */
static const double KINKED = 30.0; /* factor of the error at a kink; 27 where rates jump */
/* The most that ln(decay) falls in a first panel at a tolerance of 1e-12. A panel that begins with
   a boundary layer has to have a node inside of it: without this, errors reach 1e6 tolerances. Half
   of it takes 1 % more sweeps, twice as much makes slip less exact. */
static const double FALL = 4.5;
/* The least ratio of the next panel's length to that of one that was refused, and that ratio where
   sweeps do not converge: half of it makes no difference, 0.5 takes 0.3 % more sweeps. */
static const double SHRINK = 0.35;
/* An accelerated path almost rests below this part of the greatest coefficient of sigma. */
static const double ALMOST_RESTS = 1e-5;
enum { SWEEPS = 40 };           /* 20 to 100 make no difference */
enum { ESTIMATE_EVERY = 4096 }; /* panels between two estimates of how many more it will take */

/* The next panel begins at tau and has length h at most. Its first guess is the series of a known
   panel of length span: the last one, which ends at tau; or one that was refused, which begins at
   tau, and whose series is where the next one's will be. */
enum { NOTHING, LAST_PANEL, REFUSED_PANEL };
typedef struct {
  double tau, h, span;
  int known;
} step_t;

/* Length of a first panel: ln(decay) falls by FALL at most in it, and by no more at the rate of its
   start; `wide` times as much at a greater tolerance than 1e-12. */
static double first_step(const motion_t *m, double wide) {
  const drive_t *d = m->track->drive;
  const double fall = FALL * wide;
  double h = fmin(m->first * wide, m->length);
  if (m->slip <= 0) return h;
  h = fmin(h, fall / gain_at(d, 0.0));
  while (exponent_at(d, h) > fall) h *= 0.5;
  return h;
}

/* Inverse of I + h/2 Q diag(lam), transposed, by Gauss and Jordan in place. In the nodes' order no
   pivots are needed: solutions are right to 3e-14 for gains from 1e-3 to 1e14 per panel that vary
   by 10^24 in it, while exchanging rows left errors of 1e-5. */
static void invert_implicit(const double *lam, double half, double (*a)[L]) {
  for (int i = 0; i < L; i++)
    for (int j = 0; j < L; j++) a[i][j] = half * lam[i] * gauss_integral[i][j] + (i == j);
  for (int k = 0; k < L; k++) {
    const double scale = 1.0 / a[k][k];
    double row[L];
    EACH_LANE(j) row[j] = scale * a[k][j];
    for (int i = 0; i < L; i++) {
      const double t = a[i][k];
      EACH_LANE(j) a[i][j] -= t * row[j];
      a[i][k] = -t * scale;
    }
    memcpy(a[k], row, sizeof row);
    a[k][k] = scale;
  }
}

/* Values at the nodes of a panel to start sweeps from: by the last panel's series (28 % fewer
   sweeps), or by that of a longer panel, which was refused. out: where the panel's own series will
   stand */
static void first_guess(const motion_t *m, const step_t *s, double span, const double *out,
                        lanes_t x) {
  const int last = s->known == LAST_PANEL;
  if (s->known != NOTHING) {
    double xi[L];
    for (int i = 0; i < L; i++)
      xi[i] = (last ? 1.0 : -1.0) + span / s->span * (1.0 + gauss_node[i]);
    series_at(last ? out - m->n * TERMS : out, m->n, xi, x);
  } else {
    for (int64_t r = 0; r < m->n; r++) fill_lanes(x[r], m->state[r]);
  }
}

/* One sweep: f at the nodes, then x = start + h/2 Q f (V: the implicit form). Returns the greatest
   change of x, and in *at_f the rows of f, which may be a table's own. Inlined: 3 % more time. */
__attribute__((noinline)) static double sweep(work_t *w, const motion_t *m, double half,
                                              const nodes_t *at, lanes_t x, lanes_t *at_f) {
  double y[MAX_STATES][L], g[L], change = 0.0, none = 0.0;
  const lanes_t f = *at_f = rates(w, m, at, x, *at_f);
  combine(gauss_integral[0], L, m->n, f[0], m->state, half, y[0], L);
  for (int64_t s = m->n - 2; s < m->n && has_v(m); s++) {
    combine(at->inverse[0], L, 1, y[s], NULL, 1.0, g, L);
    EACH_LANE(i) y[s][i] = g[i], f[s][i] -= at->lam[i] * g[i];
  }
  double worst[L];
  fill_lanes(worst, 0.0);
  for (int64_t s = 0; s < m->n; s++) {
    const double scale = m->scale[s];
    EACH_LANE(i) {
      const double far = fabs(y[s][i] - x[s][i]) * scale;
      worst[i] = far > worst[i] ? far : worst[i];
      x[s][i] = y[s][i];
    }
    none += 0.0 * y[s][0]; /* a maximum ignores NaN; but after a sweep it is at all nodes */
  }
  for (int i = 0; i < L; i++) change = worst[i] > change ? worst[i] : change;
  return none == 0.0 ? change : HUGE_VAL;
}

/* Whether the panel is so much too long that its tail shows it before the sweeps converge. */
static int hopeless(const motion_t *m, double half, const nodes_t *at, lanes_t f) {
  for (int64_t r = 0; r < m->n; r++)
    if (TAIL * fabs(half * dot(gauss_top, f[r])) * m->scale[r] > 100.0 * at->allowed) return 1;
  return 0;
}

/* Sweeps until x changes no more. Returns 0 if they do not converge. */
static int converge(work_t *w, const motion_t *m, double half, const nodes_t *at, lanes_t x,
                    lanes_t *f) {
  double last = HUGE_VAL, before = 0.05; /* before: the ratio of changes one sweep earlier */
  for (int k = 0; k < SWEEPS; k++) {
    const double change = sweep(w, m, half, at, x, f), ratio = change / last;
    /* The next sweep's change is estimated by the slower of the last two ratios, as in equations
       of second order every other sweep changes little. There is no ratio before the second sweep,
       and with a stiff V that one is left out: the first sweep corrects nearly all of V, and later
       ones converge more slowly. */
    const double next = k > has_v(m) ? change * fmax(ratio, before) : change;
    if (next <= 3e-2 * m->tolerance || change <= ROUNDING) return 1;
    if (!(change < 1e10)) return 0; /* they diverge */
    if (k == 3 && hopeless(m, half, at, *f)) return 1;
    if (k) before = ratio;
    last = change;
  }
  return 0;
}

/* The series of a stiff V from its values. Integrating V' would lose digits, as its two terms, the
   acceleration and lam V, nearly cancel and are far larger than V over a panel's length. */
static void series_through(const double *start, lanes_t v, double *out) {
  double rise[2][L];
  for (int a = 0; a < 2; a++)
    EACH_LANE(i) rise[a][i] = v[a][i] - start[a];
  combine(gauss_through[0], L, 2, rise[0], NULL, 1.0, out, TERMS);
  for (int a = 0; a < 2; a++) {
    out[a * TERMS] += start[a];
    out[a * TERMS + L] = dot(gauss_through_top, rise[a]);
  }
}

/* The series of a converged panel and the state at its end; returns the error. */
static double close_panel(work_t *w, const motion_t *m, double half, lanes_t x, lanes_t f,
                          double *out, double *end) {
  const track_t *k = m->track;
  double error = 0.0;
  combine(gauss_series[0], L, m->n, f[0], NULL, half, out, TERMS);
  for (int64_t r = 0; r < m->n; r++) {
    double *o = out + r * TERMS;
    o[L] = half * dot(gauss_top, f[r]), o[0] += m->state[r];
    error = fmax(error, TAIL * fmax(fabs(o[L]), 0.1 * fabs(o[L - 1])) * m->scale[r]);
    end[r] = m->state[r] + half * dot(gauss_weight, f[r]);
  }
  if (has_v(m)) {
    const int64_t n = m->n - 2;
    series_through(m->state + n, x + n, out + n * TERMS);
    for (int a = 0; a < 2; a++) end[n + a] = dot(gauss_last, x[n + a]);
  }
  if (k->body && k->in_space) run_body(w, k->body, IN_SPACE, A_RESTORE, end, end);
  return error;
}

/* Whether rates may jump: at a pole, on which chart components of a disturbance, also of the
   finger's, have no limit; or at a kink of a user's surface, whose panels have a greatest length */
static int may_jump(const motion_t *m) {
  const track_t *k = m->track;
  if (!k->body) return 0;
  if (m->finger && m->finger->in_space) return 1;
  return k->body->panel_limit < HUGE_VAL || (k->in_space && (any(k->offset) || any(k->push)));
}

/* Whether a panel's series fall as slowly as 1/k^2 or 1/k^3, since rates or their slopes jump
   between nodes. Coefficients of 1e-15 may be rounding. */
static int has_kink(const motion_t *m, const double *series) {
  double middle = 0.0, last = 0.0;
  for (int64_t r = 0; r < m->n; r++) {
    const double *o = series + r * TERMS;
    middle += (fabs(o[L / 2]) + fabs(o[L / 2 - 1])) * m->scale[r];
    last += (fabs(o[L]) + fabs(o[L - 1])) * m->scale[r];
  }
  return last > fmax(0.005 * middle, 1e-15);
}

/* The error from a jump of the rates between an end of a panel and the node next to it: there the
   rates at the end differ from those extrapolated from f, the rates at the nodes. Panels that are
   refused for a jump shrink until the jump is in such a gap. */
static double error_at_ends(work_t *w, const motion_t *m, double tau, double half, lanes_t f,
                            const double *end) {
  double expected[2][MAX_STATES], t[L], x[MAX_STATES][L], rows_f[MAX_STATES][L], jump = 0.0;
  for (int64_t r = 0; r < m->n; r++) {
    double back[L];
    for (int i = 0; i < L; i++) back[i] = f[r][L - 1 - i];
    expected[0][r] = dot(gauss_last, back), expected[1][r] = dot(gauss_last, f[r]);
    fill_lanes(x[r], end[r]), x[r][0] = m->state[r];
  }
  fill_lanes(t, tau + 2.0 * half), t[0] = tau;
  nodes_t at;
  fill_nodes(w, m, t, &at);
  lanes_t in = x;
  if (!m->pushed) copy_rows(in = motion_table(w, m)->r, x, (int)m->n);
  const lanes_t found = rates(w, m, &at, in, rows_f);
  for (int64_t r = 0; r < m->n; r++)
    for (int i = 0; i < 2; i++) {
      const double damped = has_v(m) && r >= m->n - 2 ? at.lam[i] * x[r][i] : 0.0;
      jump = fmax(jump, fabs(found[r][i] - damped - expected[i][r]) * m->scale[r]);
    }
  return (1.0 + gauss_node[0]) * half * jump;
}

/* The error that no shorter panel avoids: rounding of L(tau), whose terms may cancel */
static double rounding(const motion_t *m, const nodes_t *at, double half, double after) {
  const drive_t *d = m->track->drive;
  const body_t *b = m->track->body;
  double terms = 0.0, most = 0.0;
  if (!(m->slip > 0) || m->pushed) return 0.0;
  for (int64_t k = d->n_exponent - 1; k >= 0; k--) terms = terms * after + fabs(d->exponent[k]);
  for (int i = 0; i < L; i++) most = fmax(most, at->sigma[i] * at->decay[i]);
  const double scale = b ? 1.0 / b->least_radius : m->scale[0];
  return 2e-16 * fmax(terms - exponent_at(d, after), 0.0) * m->slip * half * most * scale;
}

/* Under accelerations, errors of W_1 and V are measured in no less than the rounding of W_1, which
   is large where sigma is small, or of W_2 and V: no sweep and no shorter panel avoids it. */
static void allow_rounding(motion_t *m, const nodes_t *at) {
  double *scale = m->scale + m->n - 2, great = 0.0;
  if (!m->pushed) return;
  for (int a = 0; a < 2; a++) {
    great = fmax(great, fabs(m->state[m->n - 2 + a]));
    if (has_v(m)) great = fmax(great, fabs(at->w2[a][L - 1]));
  }
  for (int a = 0; a < 2; a++) scale[a] = fmin(scale[a], m->tolerance / (ROUNDING * great));
}

/* Whether a panel up to `after` is accepted, for its error; then m->state becomes its end. Sets the
   length of the next panel to try. */
static int judge_panel(motion_t *m, step_t *s, double after, double error, double allowed,
                       const double *end) {
  const double span = after - s->tau;
  /* An error below 1e-30 says no more than one of 1e-30. Where a panel is too long, errors fall
     faster with its length than at order L (with 1.0 instead of 1.5: 1 % more sweeps). A panel that
     is refused for little is shortened by a fifth: without it, points of K1 to K4 are half as
     exact. One that follows an accepted one has at most twice its length: with 4 times, 4 % fewer
     sweeps, small slip under a large gain is off by 1e-9 of it. */
  const int fits = error <= allowed;
  const double order = (fits ? 1.0 : 1.5) * (double)L;
  const double ratio = 0.9 * pow(allowed / fmax(error, 1e-30), 1.0 / order);
  s->span = span, s->known = fits ? LAST_PANEL : REFUSED_PANEL;
  if (!fits) {
    s->h = span * fmin(fmax(ratio, SHRINK), 0.8);
    return 0;
  }
  double far = 1e-30; /* sizes that the panel spans */
  for (int64_t r = 0; r < m->n; r++) far = fmax(far, fabs(end[r] - m->state[r]) * m->scale[r]);
  s->h = span * fmin(fmin(ratio, 2.0), m->panel_limit / far);
  s->tau = after;
  memcpy(m->state, end, (size_t)m->n * sizeof *end);
  return 1;
}

/* One panel from s->tau: its series to `out`, m->state to its end. Returns 0 where it is refused:
   s->h is what to try next. */
static int try_panel(work_t *w, motion_t *m, step_t *s, double *out) {
  const double tau = s->tau, after = s->h < m->length - tau ? tau + s->h : m->length;
  const double span = after - tau, half = 0.5 * span;
  double rows_f[MAX_STATES][L], rows_x[MAX_STATES][L], t[L], end[MAX_STATES];
  lanes_t f = rows_f, x = m->track->body && !m->pushed ? motion_table(w, m)->r : rows_x;
  nodes_t at;
  for (int i = 0; i < L; i++) t[i] = tau + half * (1.0 + gauss_node[i]);
  fill_nodes(w, m, t, &at);
  allow_rounding(m, &at);
  at.allowed = fmax(m->tolerance, rounding(m, &at, half, after));
  if (has_v(m)) invert_implicit(at.lam, half, at.inverse);
  first_guess(m, s, span, out, x);
  if (!converge(w, m, half, &at, x, &f)) {
    if (s->known == REFUSED_PANEL) s->known = NOTHING;
    s->h = SHRINK * span;
    return 0;
  }
  double error = close_panel(w, m, half, x, f, out, end);
  if (error <= at.allowed && may_jump(m)) {
    if (has_kink(m, out)) error *= KINKED;
    error = fmax(error, error_at_ends(w, m, tau, half, f, end));
  }
  return judge_panel(m, s, after, error, at.allowed, end);
}

static _Noreturn void fail_motion(work_t *w, const motion_t *m, const step_t *s, int code,
                                  int64_t count) {
  const track_t *k = m->track;
  failure_t *e = w->failure;
  const double start = k->by_length ? 0.0 : k->drive->start;
  e->t = start + s->tau, e->end = start + m->length, e->panels = count;
  e->by_length = k->by_length;
  e->value = k->by_length ? 1.0 : sigma_at(k->drive, s->tau);
  double greatest = 0.0;
  for (int64_t i = 0; i < k->drive->n_sigma; i++)
    greatest = fmax(greatest, fabs(k->drive->sigma[i]));
  e->at_rest = m->pushed && e->value <= ALMOST_RESTS * greatest;
  if (k->body) {
    double place[5] = {m->state[0], m->state[1]};
    if (k->in_space) run_body(w, k->body, IN_SPACE, M_COORDINATES, m->state, place);
    e->u = place[0], e->v = place[1];
  }
  fail(w, code);
}

/* Fails if a motion makes no progress, or will take more panels than are left. count: panels so
   far; mark: tau at the last estimate of how many more are needed */
static void require_progress(work_t *w, const motion_t *m, const step_t *s, int64_t count,
                             double *mark) {
  /* at tau = 0 any h is allowed: a boundary layer may be arbitrarily thin */
  if (!(s->h > 1e-15 * s->tau)) fail_motion(w, m, s, STUCK, count);
  const double left = w->plan->scene[S_PANELS] - (double)w->failure->tried;
  int endless = left < 0;
  if (count && count % ESTIMATE_EVERY == 0 && s->tau > *mark) {
    endless |= (double)ESTIMATE_EVERY * (m->length - s->tau) > left * (s->tau - *mark);
    *mark = s->tau;
  }
  if (endless) fail_motion(w, m, s, TOO_MANY_PANELS, count);
}

/* Counts a panel that is tried, and notes the contact that tries the most. */
static void count_panel(work_t *w) {
  failure_t *e = w->failure;
  const int64_t count = ++e->tried - w->begun;
  if (count > e->most) e->most = count, e->costliest = e->contact;
}

/* Integrates a motion from m->state over [0, m->length], or until it finishes; returns its panels,
   in the plan's memory. */
static panels_t integrate(work_t *w, motion_t *m, double tolerance) {
  m->tolerance = fmax(0.1 * fmin(tolerance, COARSE), ROUNDING);
  const double wide = pow(m->tolerance / 1e-13, 1.0 / (double)L); /* than at a tolerance of 1e-12 */
  step_t s = {.h = first_step(m, wide)};
  const size_t size = (size_t)m->n * TERMS; /* of a panel's series */
  size_t count = 0;
  double mark = 0.0;
  room_for(w, &w->edges, 8)[0] = 0.0;
  while (s.tau < m->length) {
    count_panel(w);
    require_progress(w, m, &s, (int64_t)count, &mark);
    double *series = room_for(w, &w->series, (count + 8) * size);
    double *edges = room_for(w, &w->edges, count + 2);
    if (!try_panel(w, m, &s, series + count * size)) continue;
    edges[++count] = s.tau;
    if (m->finish > 0 && s.tau < m->length &&
        m->slip * decay_at(m->track->drive, s.tau) <= m->finish)
      break;
  }
  panels_t p = {.n = (int64_t)count, .rows = m->n};
  double *edges = keep(w, p.n + 1, sizeof *edges), *series = keep(w, p.n, size * sizeof *series);
  p.edges = memcpy(edges, w->edges.data, (count + 1) * sizeof *edges);
  p.series = memcpy(series, w->series.data, count * size * sizeof *series);
  return p;
}
