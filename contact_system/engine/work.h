/* The data of a plan, and the working memory of one call.

   The horizon of a contact is cut more and more finely. A leg has one sigma; a drive also one form
   of the gain; a segment also the same disturbances. A track is a body's motion on one or more
   segments, and panels are the pieces of a track that is integrated. */

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
  double per_metre; /* 1/m: V moves the contact by |V|/per_metre at most. The greater of 1/length
                       and the least lam/sigma, which is the decay of V per metre */
  int64_t grows;    /* sigma grows, and the law cancels that: decay has the factor sigma(0)/sigma */
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
