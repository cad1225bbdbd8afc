/* The data of a plan, and the working memory of one call. */

typedef struct work work_t;

/* memory that lives as long as a plan, allocated in few pieces */
typedef struct block {
  struct block *next;
  size_t used, size;
  double data[];
} block_t;

/* sigma and the gain on one interval; tau is local time */
typedef struct {
  const double *leg; /* in the scene's buffer */
  double start, stop;
  double least;     /* the least sigma */
  double per_metre; /* the least lam/sigma or, if greater, 1/length, 1/m: V moves the contact by at
                       most |V|/per_metre before it has decayed */
  int64_t grows;    /* sigma grows, which the law cancels: decay has the factor sigma(0)/sigma */
  int64_t n_sigma, n_exponent;
  /* polynomials: sigma; L without the term for growth; int sigma, which has n_sigma + 1 terms */
  const double *sigma, *exponent, *length;
} drive_t;

typedef struct {
  const surface_t *surface;
  const double *numbers;
  double size, least_radius, panel_limit; /* as B_SIZE, B_LEAST_RADIUS and B_PANEL_LIMIT say */
  int side;                               /* 0: the finger, 1: the object */
} body_t;

/* a motion as Chebyshev series: edges[n + 1], series[n][rows][L + 1] */
typedef struct {
  int64_t n, rows;
  const double *edges, *series;
} panels_t;

/* u v theta at a place whose branch of the chart is known, and there sin u, cos v and their product
   y: see branches.c */
typedef struct {
  double place[3], sin_u, cos_v, y;
} anchor_t;
enum { ANCHOR_SIZE = sizeof(anchor_t) / sizeof(double) };

/* The motion of one body on one interval */
typedef struct {
  const body_t *body;
  double stop; /* s; it starts where its drive does */
  int64_t kind, by_length, reason;
  int in_space; /* else in the chart */
  const drive_t *drive;
  double w[2];                 /* W_1 or W_2 */
  const double *push, *offset; /* in chart components */
  panels_t panels; /* of the state, then W_1 or V if accelerated; of a LINE, g = int sigma decay */
  /* great circles: x0, unit tangents along and across, cosine and sine of the angle from p to
     `along`, and rad per metre of int sigma */
  double at[3], along[3], across[3], direction[2], rate;
  /* lines in a developed chart: begin + slope s - aside g + offset tau, s = int sigma */
  double begin[3], slope[2], aside[2];
  int long_path; /* so long that whole turns have to be taken off in doubled precision */
  /* where the branch of the chart is known: places on the panels, or phases of one revolution */
  int64_t n_anchors;
  const double *anchor_at;
  const anchor_t *anchors;
  double turn[3]; /* what one revolution adds to them */
} track_t;

/* A piece of the horizon, what acts on it in chart components, and its path velocities: W_1 and V
   at its start, or under accelerations as the last rows of panels */
typedef struct {
  const drive_t *drive;
  double acting[6];   /* accelerations of finger and object, rate offset of the object */
  const double *turn; /* where a leg begins: cosine and sine of the angle by which the path turns */
  double w1[2], v[2];
  const panels_t *w1_panels, *v_panels; /* or NULL */
} segment_t;

typedef struct {
  const double *row; /* in the scene's buffer */
  body_t body[2];
  double r0[4]; /* R_0 */
  int64_t n_tracks[2], n_segments;
  track_t *tracks[2];
  segment_t *segments;
  double *track_edges[2], *segment_edges; /* times at which they begin, and infinity */
} contact_t;

struct plan {
  double *scene;
  const surface_t *const *surfaces;
  int64_t n_contacts;
  contact_t *contacts;
  block_t *memory;
  work_t *work; /* working memory that `evaluate_at` keeps, or NULL */
};

enum { MAX_STATES = 8, TERMS = L + 1 };

/* scratch memory, which grows */
typedef struct {
  double *data;
  size_t size;
} room_t;

struct work {
  jmp_buf jump;
  failure_t *failure;
  plan_t *plan;
  unit_t body[2][2][N_TABLES]; /* side, in the chart or in space, table */
  unit_t pair[N_CONTACT_TABLES];
  room_t one;           /* registers of tables that run at one point */
  room_t edges, series; /* of the motion that is being integrated, then of its anchors */
  int64_t begun;        /* panels tried before this contact; failure->tried counts them */
};

static _Noreturn void fail(work_t *w, int code) {
  w->failure->code = code;
  longjmp(w->jump, 1);
}

static void begin_work(work_t *w, plan_t *plan, failure_t *failure) {
  memset(w, 0, sizeof *w);
  memset(failure, 0, sizeof *failure);
  w->plan = plan, w->failure = failure;
}

static void end_work(work_t *w) {
  for (int s = 0; s < 2; s++)
    for (int a = 0; a < 2; a++)
      for (int t = 0; t < N_TABLES; t++) free(w->body[s][a][t].r);
  for (int t = 0; t < N_CONTACT_TABLES; t++) free(w->pair[t].r);
  free(w->one.data), free(w->edges.data), free(w->series.data);
}

/* Makes room for n doubles; what is in it stays. */
static double *room_for(work_t *w, room_t *room, size_t n) {
  if (n > room->size) {
    double *data = realloc(room->data, 2 * n * sizeof *data);
    if (!data) fail(w, NO_MEMORY);
    room->data = data, room->size = 2 * n;
  }
  return room->data;
}

/* `count` items of `size` bytes in the plan's memory, all zero */
static void *keep(work_t *w, int64_t count, size_t size) {
  const size_t n = ((size_t)count * size + sizeof(double) - 1) / sizeof(double);
  block_t *b = w->plan->memory;
  if (!b || b->used + n > b->size) {
    const size_t more = b ? 2 * b->size : 64, most = 1 << 16; /* twice as many each time */
    const size_t whole = more < most ? more : most, room = n > whole ? n : whole;
    b = calloc(1, sizeof *b + room * sizeof(double));
    if (!b) fail(w, NO_MEMORY);
    b->next = w->plan->memory, b->size = room;
    w->plan->memory = b;
  }
  void *found = b->data + b->used;
  b->used += n;
  return found;
}

/* ---- polynomials ---- */

/* dy/dx of `horner` */
static inline double slope_of(const double *c, int64_t n, double x) {
  double y = 0.0;
  for (int64_t k = n - 1; k >= 1; k--) y = y * x + (double)k * c[k];
  return y;
}

static inline void horners(const double *c, int64_t n, const double *x, double *restrict y) {
  for (int i = 0; i < L; i++) y[i] = c[n - 1];
  for (int64_t k = n - 2; k >= 0; k--)
    EACH_LANE(i) y[i] = y[i] * x[i] + c[k];
}

static inline double sigma_at(const drive_t *d, double tau) {
  return horner(d->sigma, d->n_sigma, tau);
}
static inline double length_at(const drive_t *d, double tau) {
  return horner(d->length, d->n_sigma + 1, tau);
}
static inline double exponent_at(const drive_t *d, double tau) {
  return horner(d->exponent, d->n_exponent, tau);
}

/* lam at a local time */
static inline double gain_at(const drive_t *d, double tau) {
  double lam = slope_of(d->exponent, d->n_exponent, tau);
  if (d->grows) lam += slope_of(d->sigma, d->n_sigma, tau) / sigma_at(d, tau);
  return lam;
}

/* The decay exp(-(L(tau) - L(0))); sigma: at the same times */
static void decays(const drive_t *d, const double *tau, const double *sigma, double *out) {
  double lost[L];
  horners(d->exponent, d->n_exponent, tau, lost);
  EACH_LANE(i) out[i] = v_exp(-lost[i]);
  if (d->grows)
    for (int i = 0; i < L; i++)
      if (tau[i] > 0) out[i] *= d->sigma[0] / sigma[i];
}

static double decay_at(const drive_t *d, double tau) {
  double t[L], sigma[L], out[L];
  fill_lanes(t, tau);
  horners(d->sigma, d->n_sigma, t, sigma);
  decays(d, t, sigma, out);
  return out[0];
}

/* ---- series ---- */

INLINE void combine_some(const double *q, int64_t terms, int rows, const double *f, int64_t f_row,
                         const double *start, double half, double *y, int64_t y_row) {
  wide_t sum[2][PARTS];
  UNROLLED(r, rows)
    UNROLLED(p, PARTS) sum[r][p] = (wide_t){0};
  for (int64_t j = 0; j < terms; j++) {
    UNROLLED(p, PARTS) {
      const wide_t part = *(const wide_t *)(q + j * L + p * WIDE);
      UNROLLED(r, rows) sum[r][p] += f[r * f_row + j] * part;
    }
  }
  UNROLLED(r, rows)
    UNROLLED(p, PARTS)
      *(wide_t *)(y + r * y_row + p * WIDE) = (start ? start[r] : 0.0) + half * sum[r][p];
}

/* y[r] = start[r] + half sum_j f[r][j] q[j], q[terms][L]; start may be NULL. By pairs of rows, for
   which sums and a row of q fit into 16 registers. */
static void combine(const double *q, int64_t terms, int64_t rows, const double *f, int64_t f_row,
                    const double *start, double half, double *y, int64_t y_row) {
  for (; rows >= 2; rows -= 2) {
    combine_some(q, terms, 2, f, f_row, start, half, y, y_row);
    f += 2 * f_row, y += 2 * y_row, start = start ? start + 2 : start;
  }
  if (rows) combine_some(q, terms, 1, f, f_row, start, half, y, y_row);
}

/* Rows of a panel's series at places xi in [-1, 1] */
static void series_at(const double *c, int64_t rows, const double *xi, lanes_t y) {
  double t[TERMS][L]; /* Chebyshev polynomials */
  for (int i = 0; i < L; i++) t[0][i] = 1.0, t[1][i] = xi[i];
  for (int k = 2; k < TERMS; k++)
    EACH_LANE(i) t[k][i] = 2.0 * xi[i] * t[k - 1][i] - t[k - 2][i];
  combine(t[0], TERMS, rows, c, TERMS, NULL, 1.0, y[0], L);
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
