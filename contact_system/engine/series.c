/* Motions as Chebyshev series, and sums over lanes. */

INLINE void combine_some(const double *q, int64_t terms, int rows, const double *f,
                         const double *start, double half, double *y, int64_t y_row) {
  wide_t sum[2][PARTS];
  UNROLLED(r, rows)
    UNROLLED(p, PARTS) sum[r][p] = (wide_t){0};
  for (int64_t j = 0; j < terms; j++) {
    UNROLLED(p, PARTS) {
      const wide_t part = *(const wide_t *)(q + j * L + p * WIDE);
      UNROLLED(r, rows) sum[r][p] += f[r * terms + j] * part;
    }
  }
  UNROLLED(r, rows)
    UNROLLED(p, PARTS)
      *(wide_t *)(y + r * y_row + p * WIDE) = (start ? start[r] : 0.0) + half * sum[r][p];
}

/* y[r] = start[r] + half sum_j f[r][j] q[j], f[rows][terms], q[terms][L]; start may be NULL. By
   pairs of rows, for which sums and a row of q fit into 16 registers. */
static void combine(const double *q, int64_t terms, int64_t rows, const double *f,
                    const double *start, double half, double *y, int64_t y_row) {
  for (; rows >= 2; rows -= 2) {
    combine_some(q, terms, 2, f, start, half, y, y_row);
    f += 2 * terms, y += 2 * y_row, start = start ? start + 2 : start;
  }
  if (rows) combine_some(q, terms, 1, f, start, half, y, y_row);
}

/* Rows of a panel's series at places xi in [-1, 1] */
static void series_at(const double *c, int64_t rows, const double *xi, lanes_t y) {
  double t[TERMS][L]; /* Chebyshev polynomials */
  for (int i = 0; i < L; i++) t[0][i] = 1.0, t[1][i] = xi[i];
  for (int k = 2; k < TERMS; k++)
    EACH_LANE(i) t[k][i] = 2.0 * xi[i] * t[k - 1][i] - t[k - 2][i];
  combine(t[0], TERMS, rows, c, NULL, 1.0, y[0], L);
}

/* Of L numbers, in eight sums whatever the vectors' width: the same bits on all processors */
static inline double dot(const double *a, const double *b) {
  double s[8];
  SIMD for (int i = 0; i < 8; i++) s[i] = a[i] * b[i] + a[8 + i] * b[8 + i];
  return ((s[0] + s[4]) + (s[2] + s[6])) + ((s[1] + s[5]) + (s[3] + s[7]));
}

/* The k of edges[k] <= x < edges[k + 1], or the first or last k; guess: the one to try first */
static int64_t interval(const double *edges, int64_t n, double x, int64_t guess) {
  if (x >= edges[guess] && (guess + 1 == n || x < edges[guess + 1])) return guess;
  int64_t low = 0, high = n;
  while (high - low > 1) {
    const int64_t middle = (low + high) / 2;
    if (x >= edges[middle])
      low = middle;
    else
      high = middle;
  }
  return low;
}

/* Rows of a motion's panels at places x, which are clipped to the panels' range */
static void panels_at(const panels_t *p, int64_t row, int64_t rows, const double *x, lanes_t y) {
  const double end = p->edges[p->n];
  int64_t k = 0;
  for (int i = 0; i < L;) {
    k = interval(p->edges, p->n, clip(x[i], 0.0, end), k);
    const double low = p->edges[k], high = p->edges[k + 1];
    /* a panel may be so short that its inverse is infinite */
    const double scale = high - low > 1e-300 ? 2.0 / (high - low) : 0.0;
    const double from = k ? low : -HUGE_VAL, to = k + 1 < p->n ? high : HUGE_VAL;
    double xi[L], part[MAX_STATES][L];
    int stop = i + 1;
    while (stop < L && x[stop] >= from && x[stop] < to) stop++;
    for (int q = 0; q < L; q++) xi[q] = clip((x[q] - low) * scale - 1.0, -1.0, 1.0);
    const double *c = p->series + (k * p->rows + row) * TERMS;
    series_at(c, rows, xi, part);
    for (int64_t r = 0; r < rows; r++)
      memcpy(y[r] + i, part[r] + i, (size_t)(stop - i) * sizeof(double));
    i = stop;
  }
}
