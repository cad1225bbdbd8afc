/* Where rays from a centre leave a body: Newton's method along them, safeguarded by bisection, a
   lane each. */

static const double SETTLED = 9e-16; /* last step of the method, relative */
enum { DOUBLINGS = 40, MOST_TRIALS = 240 };

typedef struct {
  unit_t level;
  const double *centre;
  double ray[3][L], t[L], value[L], slope[L]; /* t: distances; the level function and its slope */
} rays_t;

static void evaluate_level(rays_t *r) {
  lanes_t in = r->level.r;
  for (int j = 0; j < 3; j++)
    EACH_LANE(i) in[j][i] = r->centre[j] + r->t[i] * r->ray[j][i];
  copy_rows(in + 3, r->ray, 3);
  lanes_t found = run(&r->level);
  copy_lanes(r->value, found[0]), copy_lanes(r->slope, found[1]);
}

/* r->t: where the rays leave; 0 where the centre is not inside, infinite where a ray stays inside,
   NaN where no point is found. */
static void trace(rays_t *r, double size) {
  const double farthest = ldexp(size, DOUBLINGS);
  double low[L] = {0}, high[L], step[L];
  int out[L], going = 1;
  fill_lanes(r->t, 0.0), evaluate_level(r);
  for (int i = 0; i < L; i++) out[i] = !(r->value[i] < 0.0);
  fill_lanes(r->t, size), fill_lanes(high, HUGE_VAL), fill_lanes(step, HUGE_VAL);
  for (int k = 0; k < MOST_TRIALS && going; k++) {
    evaluate_level(r), going = 0;
    for (int i = 0; i < L; i++) {
      const double t = r->t[i], value = r->value[i];
      /* a settled ray stays: its result must not depend on the other rays */
      if (out[i] || t == farthest || step[i] <= SETTLED * t) continue;
      if (high[i] == HUGE_VAL && !(value > 0.0)) { /* double the distance until it is outside */
        r->t[i] = 2.0 * t, going |= r->t[i] < farthest;
        continue;
      }
      if (value < 0.0) low[i] = t;
      if (value >= 0.0) high[i] = t;
      double trial = t - value / r->slope[i];
      const int inside = trial >= low[i] && trial <= high[i] && isfinite(r->slope[i]);
      /* Newton's method alone is slow on x^1000 */
      if (!(inside && fabs(trial - t) <= 0.5 * step[i])) trial = 0.5 * (low[i] + high[i]);
      step[i] = fabs(trial - t), r->t[i] = trial, going |= step[i] > SETTLED * trial;
    }
  }
  for (int i = 0; i < L; i++)
    if (out[i] || r->t[i] == farthest)
      r->t[i] = out[i] ? 0.0 : HUGE_VAL;
    else if (!(step[i] <= SETTLED * r->t[i]))
      r->t[i] = NAN;
}

static int rays(const table_t *level, const double *numbers, double size, int64_t n,
                const double *ray, double *t) {
  rays_t r = {.centre = numbers + 1};
  if (!load(&r.level, level, numbers)) return NO_MEMORY;
  for (int64_t i = 0; i < n; i += L) {
    const int count = (int)(n - i < L ? n - i : L);
    for (int j = 0; j < 3; j++) gather(r.ray[j], ray + j * n + i, count);
    trace(&r, size);
    memcpy(t + i, r.t, (size_t)count * sizeof *t);
  }
  free(r.level.r);
  return NO_FAILURE;
}
