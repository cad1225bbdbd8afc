/* Geodesics with the Jacobi fields along them, a lane each.

   The explicit method of order 8 of Dormand and Prince, with its estimate of errors (Hairer,
   Norsett, Wanner, Solving Ordinary Differential Equations I, II.5). Each lane has steps of its
   own: on thin bodies they are short only near the rim, which lanes pass at different lengths. */

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
  double tau[L], step[L]; /* the part of the length that is done, and that of the next step */
  int brief[L];           /* steps below BRIEF without a longer one */
  int64_t tries;          /* steps of all lanes at once, so far */
  double y[MOST_ROWS][L], next[MOST_ROWS][L], k[STAGES][MOST_ROWS][L], unit[MOST_ROWS][L];
  double before[SHOWN][L], shown[SHOWN][L];
} lines_t;

static void rates_of(lines_t *g, lanes_t y, lanes_t out) {
  copy_rows(g->rates.r, y, g->rows);
  lanes_t found = run(&g->rates);
  for (int r = 0; r < g->rows; r++)
    EACH_LANE(i) out[r][i] = g->length[i] * found[r][i];
}

/* y + step sum of a_j k_j, or without y; TOGETHER rows at once, as processors add several numbers
   in the time that one takes */
enum { TOGETHER = 2 };
static void combine_stages(const lines_t *g, const double *a, int n, int added, lanes_t out) {
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
        const wide_t h = *(const wide_t *)(g->step + p * WIDE);
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
static void try_step(lines_t *g, double *error) {
  double fifth[MOST_ROWS][L], third[MOST_ROWS][L], a[L] = {0}, b[L] = {0};
  for (int s = 1; s < STAGES; s++) {
    combine_stages(g, dop853_stage[s], s, 1, g->next);
    rates_of(g, g->next, g->k[s]);
  }
  combine_stages(g, dop853_result, STAGES, 1, g->next);
  combine_stages(g, dop853_error_5, STAGES, 0, fifth);
  combine_stages(g, dop853_error_3, STAGES, 0, third);
  for (int r = 0; r < g->rows; r++)
    EACH_LANE(i) {
      const double per = 1.0 / (g->unit[r][i] * g->tolerance), x = fifth[r][i] * per,
                   z = third[r][i] * per;
      a[i] += x * x, b[i] += z * z;
    }
  for (int i = 0; i < L; i++)
    error[i] = a[i] == 0.0 ? 0.0 : a[i] / sqrt((a[i] + 0.01 * b[i]) * g->rows);
}

/* The factor from a step with an error, in tolerances, to the next */
static double change_of_step(double error) {
  return isfinite(error) ? 0.9 / sqrt(sqrt(sqrt(fmax(error, 1e-30)))) : 0.0;
}

/* x p q J J' M M' of g->y */
static void show(lines_t *g) {
  const int known = g->in_space ? 6 : 0;
  copy_rows(g->shown, g->y, known);
  copy_rows(g->frame.r, g->y, g->state);
  copy_rows(g->shown + known, run(&g->frame), 9 - known);
  copy_rows(g->shown + 9, g->y + g->state, FIELDS);
}

/* x and J of a lane at the parts of its length within the step just taken, by Hermite's cubics */
static void sample(const lines_t *g, int i, int64_t m, int64_t n, double *path) {
  const double h = g->step[i];
  for (int64_t k = (int64_t)floor(g->tau[i] * (double)m) + 1; k <= m; k++) {
    const double x = ((double)k / (double)m - g->tau[i]) / h;
    if (x > 1.0 + 1e-9) return;
    const double up = x * x * (3.0 - 2.0 * x), left = x * (1.0 - x) * (1.0 - x),
                 right = x * x * (x - 1.0);
    for (int r = 0; r < SAMPLED; r++) {
      const int at = r < 3 ? r : 9, slope = r < 3 ? 3 + r : 10;
      path[((k - 1) * SAMPLED + r) * n + i] =
          (1.0 - up) * g->before[at][i] + up * g->shown[at][i] +
          h * g->length[i] * (left * g->before[slope][i] + right * g->shown[slope][i]);
    }
  }
}

/* Gives up a lane that cannot be followed: it stands still from here on. */
static void give_up(lines_t *g, int i) {
  g->length[i] = 0.0, g->lost[i] = 1, g->step[i] = 1.0 - g->tau[i];
  for (int r = 0; r < g->rows; r++) g->next[r][i] = isfinite(g->y[r][i]) ? g->y[r][i] : 0.0;
}

/* Whether a lane goes on from a step; if not, its next one is shorter. */
static int settle(lines_t *g, int i, double error, int64_t tries) {
  /* After 64 brief steps the shortest is twice as long, and so on: it may be too short to change
     the last digit of x. */
  const int brief = g->brief[i];
  const int shortest = brief > MOST_BRIEF || g->step[i] <= LEAST_STEP * (1 << brief / 64);
  const double allowed = brief > MOST_BRIEF ? EASY
                         : shortest         ? fmax(JUMP / g->tolerance, 1.0)
                                            : 1.0;
  if (error <= allowed && tries < MOST_STEPS) return 1;
  if (shortest || tries == MOST_STEPS) return give_up(g, i), 1;
  g->step[i] *= fmax(change_of_step(error), 0.2);
  return 0;
}

/* Goes on along the lanes that have settled. */
static void go_on(lines_t *g, const int *settled) {
  for (int r = 0; r < g->rows; r++)
    EACH_LANE(i) g->y[r][i] = settled[i] ? g->next[r][i] : g->y[r][i];
  if (g->in_space) {
    copy_rows(g->restore.r, g->y, 6);
    lanes_t restored = run(&g->restore);
    for (int r = 0; r < 6; r++)
      EACH_LANE(i) g->y[r][i] = settled[i] ? restored[r][i] : g->y[r][i];
  }
  copy_rows(g->before, g->shown, SHOWN);
  show(g);
}

static void follow(lines_t *g, int64_t m, int64_t n, int count, double *path) {
  double error[L];
  int settled[L], going = 1, fresh = 1;
  for (int i = 0; i < L; i++) {
    g->tau[i] = g->lost[i] ? 1.0 : 0.0, g->brief[i] = 0;
    g->step[i] = fmin(g->geodesic->first / fabs(g->length[i]), 1.0);
  }
  show(g);
  for (int64_t tries = 0; going; tries++) {
    for (int i = 0; i < L; i++) {
      g->step[i] = fmin(g->step[i], g->geodesic->longest / fabs(g->length[i]));
      if (g->tau[i] + 1.001 * g->step[i] >= 1.0) g->step[i] = 1.0 - g->tau[i];
    }
    if (fresh) rates_of(g, g->y, g->k[0]), find_units(g);
    try_step(g, error), g->tries++;
    fresh = going = 0;
    for (int i = 0; i < L; i++) {
      settled[i] = g->tau[i] < 1.0 && settle(g, i, error[i], tries);
      fresh |= settled[i];
    }
    if (fresh) go_on(g, settled);
    for (int i = 0; i < L; i++) {
      if (settled[i]) {
        if (path && i < count) sample(g, i, m, n, path);
        g->brief[i] = g->step[i] < BRIEF ? g->brief[i] + 1 : 0;
        const int last = g->step[i] == 1.0 - g->tau[i];
        g->tau[i] = last ? 1.0 : g->tau[i] + g->step[i];
        g->step[i] *= fmin(change_of_step(error[i]), 6.0);
      }
      going |= g->tau[i] < 1.0;
    }
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
