/* Geodesics with the Jacobi fields along them, a lane each.

   The explicit method of order 8 of Dormand and Prince, with its estimate of errors (Hairer,
   Norsett, Wanner, Solving Ordinary Differential Equations I, II.5). Lengths run from 0 to 1, so
   that geodesics of any lengths share their steps. */

enum { FIELDS = 4, MOST_ROWS = 6 + FIELDS, SHOWN = 9 + FIELDS, SAMPLED = 4 };
enum { MOST_STEPS = 100000, MOST_BRIEF = 1000 };
/* Steps are LEAST_STEP of the length or longer. Steps so short pass a jump of the curvature, with
   an error of JUMP at most. A lane is given up if it needs a shorter step, as near a pole of a
   chart; or if after MOST_BRIEF steps below BRIEF, as near the edge of a chart, its error is not
   below EASY times the tolerance. */
static const double LEAST_STEP = 1e-15, JUMP = 1e-8, BRIEF = 1e-6, EASY = 1e-3;

typedef struct {
  const geodesic_t *geodesic;
  unit_t rates, restore, frame, lame;
  int in_space, state, rows; /* numbers of a state, without and with Jacobi fields */
  int lost[L];               /* lanes that cannot be followed */
  double length[L], tolerance;
  double y[MOST_ROWS][L], next[MOST_ROWS][L], k[STAGES][MOST_ROWS][L], unit[MOST_ROWS][L];
  double before[SHOWN][L], shown[SHOWN][L];
} lines_t;

static void rates_of(lines_t *g, lanes_t y, lanes_t out) {
  copy_rows(g->rates.r, y, g->rows);
  lanes_t found = run(&g->rates);
  for (int r = 0; r < g->rows; r++)
    EACH_LANE(i) out[r][i] = g->length[i] * found[r][i];
}

/* y + h sum of a_j k_j, or that sum alone; TOGETHER rows at once, as processors add several numbers
   in the time that one takes */
enum { TOGETHER = 2 };
static void combine_stages(const lines_t *g, const double *a, int n, double h, int added,
                           lanes_t out) {
  for (int r = 0; r < g->rows; r += TOGETHER) {
    wide_t sum[TOGETHER][PARTS];
    UNROLLED(q, TOGETHER)
      UNROLLED(p, PARTS) sum[q][p] = (wide_t){0};
    for (int j = 0; j < n; j++) {
      if (a[j] == 0.0) continue;
      UNROLLED(q, TOGETHER)
        UNROLLED(p, PARTS) sum[q][p] += a[j] * *(const wide_t *)(g->k[j][r + q] + p * WIDE);
    }
    UNROLLED(q, TOGETHER)
      UNROLLED(p, PARTS) {
        const wide_t y = *(const wide_t *)(g->y[r + q] + p * WIDE);
        *(wide_t *)(out[r + q] + p * WIDE) = added ? y + h * sum[q][p] : h * sum[q][p];
      }
  }
}

/* Units of the states' errors, of which the tolerance is a fraction */
static void find_units(lines_t *g) {
  const double size = g->geodesic->size;
  const double fields[FIELDS] = {size, 1.0, 1.0, 1.0 / size};
  if (g->in_space)
    for (int r = 0; r < 6; r++) fill_lanes(g->unit[r], r < 3 ? size : 1.0);
  else {
    copy_rows(g->lame.r, g->y, g->state);
    lanes_t found = run(&g->lame);
    for (int r = 0; r < 2; r++)
      for (int i = 0; i < L; i++) g->unit[r][i] = size / fmax(found[r][i], 1e-2 * size);
    fill_lanes(g->unit[2], 1.0);
  }
  for (int r = 0; r < FIELDS; r++)
    for (int i = 0; i < L; i++) g->unit[g->state + r][i] = fields[r] + fabs(g->y[g->state + r][i]);
}

/* A step from g->y, k[0] known, to g->next; the error of each lane in tolerances */
static void try_step(lines_t *g, double h, double *error) {
  double fifth[MOST_ROWS][L], third[MOST_ROWS][L], a[L] = {0}, b[L] = {0};
  for (int s = 1; s < STAGES; s++) {
    combine_stages(g, dop853_stage[s], s, h, 1, g->next);
    rates_of(g, g->next, g->k[s]);
  }
  combine_stages(g, dop853_result, STAGES, h, 1, g->next);
  combine_stages(g, dop853_error_5, STAGES, h, 0, fifth);
  combine_stages(g, dop853_error_3, STAGES, h, 0, third);
  for (int r = 0; r < g->rows; r++)
    EACH_LANE(i) {
      const double per = 1.0 / (g->unit[r][i] * g->tolerance), x = fifth[r][i] * per,
                   z = third[r][i] * per;
      a[i] += x * x, b[i] += z * z;
    }
  for (int i = 0; i < L; i++)
    error[i] = a[i] == 0.0 ? 0.0 : a[i] / sqrt((a[i] + 0.01 * b[i]) * g->rows);
}

/* x p q J J' M M' of g->y */
static void show(lines_t *g) {
  const int known = g->in_space ? 6 : 0;
  copy_rows(g->shown, g->y, known);
  copy_rows(g->frame.r, g->y, g->state);
  copy_rows(g->shown + known, run(&g->frame), 9 - known);
  copy_rows(g->shown + 9, g->y + g->state, FIELDS);
}

/* x and J at the parts of the length within a step, by Hermite's cubics */
static void sample(const lines_t *g, double tau, double h, int64_t m, int64_t n, int count,
                   double *path) {
  for (int64_t k = (int64_t)floor(tau * (double)m) + 1; k <= m; k++) {
    const double x = ((double)k / (double)m - tau) / h;
    if (x > 1.0 + 1e-9) return;
    const double up = x * x * (3.0 - 2.0 * x), left = x * (1.0 - x) * (1.0 - x),
                 right = x * x * (x - 1.0);
    for (int r = 0; r < SAMPLED; r++) {
      const int at = r < 3 ? r : 9, slope = r < 3 ? 3 + r : 10;
      for (int i = 0; i < count; i++)
        path[((k - 1) * SAMPLED + r) * n + i] =
            (1.0 - up) * g->before[at][i] + up * g->shown[at][i] +
            h * g->length[i] * (left * g->before[slope][i] + right * g->shown[slope][i]);
    }
  }
}

/* Gives up lanes that cannot be followed: they stand still from here on. */
static void give_up(lines_t *g, const double *error, double allowed) {
  for (int i = 0; i < L; i++) {
    if (error && error[i] <= allowed) continue;
    g->length[i] = 0.0, g->lost[i] = 1;
    for (int r = 0; r < g->rows; r++)
      if (!isfinite(g->y[r][i])) g->y[r][i] = 0.0;
  }
}

static void follow(lines_t *g, int64_t m, int64_t n, int count, double *path) {
  double longest = 0.0, error[L];
  for (int i = 0; i < L; i++) longest = fmax(longest, fabs(g->length[i]));
  const double first = fmin(g->geodesic->first / longest, 1.0);
  double most = g->geodesic->longest / longest, tau = 0.0, h = first;
  int fresh = 1, brief = 0;
  show(g);
  for (int64_t tries = 0; tau < 1.0; tries++) {
    if (tries == MOST_STEPS) give_up(g, NULL, 0.0), most = INFINITY, h = fresh = 1;
    h = fmin(h, most);
    const int last = tau + 1.001 * h >= 1.0;
    if (last) h = 1.0 - tau;
    if (fresh) rates_of(g, g->y, g->k[0]), find_units(g);
    try_step(g, h, error);
    double worst = 0.0;
    for (int i = 0; i < L; i++)
      if (!g->lost[i]) worst = fmax(worst, isnan(error[i]) ? HUGE_VAL : error[i]);
    /* After 64 brief steps the shortest is twice as long, and so on: it may be too short to change
       the last digit of x. */
    const int shortest = h <= ldexp(LEAST_STEP, brief / 64) || brief > MOST_BRIEF;
    const double allowed = brief > MOST_BRIEF ? EASY
                           : shortest         ? fmax(JUMP / g->tolerance, 1.0)
                                              : 1.0;
    fresh = worst <= allowed;
    const double ratio = 0.9 * pow(fmax(worst, 1e-30), -1.0 / 8);
    if (!fresh) {
      h *= fmax(ratio, 0.2);
      if (!shortest) continue;
      give_up(g, error, allowed);
      h = first, fresh = 1, brief = 0; /* the other lanes begin anew */
      continue;
    }
    copy_rows(g->y, g->next, g->rows);
    if (g->in_space) {
      copy_rows(g->restore.r, g->y, 6);
      copy_rows(g->y, run(&g->restore), 6);
    }
    copy_rows(g->before, g->shown, SHOWN);
    show(g);
    if (path) sample(g, tau, h, m, n, count, path);
    tau = last ? 1.0 : tau + h;
    brief = h < BRIEF ? brief + 1 : 0;
    h *= fmin(ratio, 6.0);
  }
}

/* Returns 0 if there is no memory. */
static int load_lines(lines_t *g, const geodesic_t *geodesic) {
  g->geodesic = geodesic, g->in_space = moves_in_space(geodesic->surface);
  g->state = state_size(g->in_space), g->rows = g->state + FIELDS;
  const table_t *const *tables = geodesic->surface->tables[g->in_space];
  const double *numbers = geodesic->numbers;
  return load(&g->frame, tables[g->in_space ? A_SECOND : C_FRAME], numbers) &&
         load(g->in_space ? &g->restore : &g->lame, tables[g->in_space ? A_RESTORE : C_LAME],
              numbers) &&
         load(&g->rates, geodesic->rates, numbers);
}

static void drop_lines(lines_t *g) {
  free(g->rates.r), free(g->frame.r), free(g->restore.r), free(g->lame.r);
}

static int geodesics(const geodesic_t *geodesic, int64_t n, const double *start,
                     const double *length, const double *tolerance, double *end, int64_t m,
                     double *path) {
  lines_t *g = calloc(1, sizeof *g);
  const int ready = g && load_lines(g, geodesic);
  for (int64_t i = 0; ready && i < n; i += L) {
    const int count = (int)(n - i < L ? n - i : L);
    memset(g->lost, 0, sizeof g->lost);
    for (int r = 0; r < g->state; r++) gather(g->y[r], start + r * n + i, count);
    gather(g->length, length + i, count);
    g->tolerance = tolerance[i];
    for (int q = 1; q < count; q++) g->tolerance = fmin(g->tolerance, tolerance[i + q]);
    for (int r = 0; r < FIELDS; r++) fill_lanes(g->y[g->state + r], r == 1 || r == 2);
    follow(g, m, n, count, path ? path + i : NULL);
    for (int r = 0; r < SHOWN; r++)
      for (int q = 0; q < count; q++) end[r * n + i + q] = g->lost[q] ? NAN : g->shown[r][q];
  }
  if (g) drop_lines(g), free(g);
  return ready ? NO_FAILURE : NO_MEMORY;
}
