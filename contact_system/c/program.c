/* Whole plans in one call: integrate what has not been yet (panels.c), evaluate every track (tracks.c).
   Generic: kernels come as pointers to panels and evaluate. */
#include <stdint.h>
#include <stdlib.h>

typedef long (*evaluate_t)(const track_t *, long, const double *, double *, const long *, long);
typedef long (*panels_t)(long, double *, const double *, const double *, const drive_t *, method_t *,
                         double *, double *, double *, double *);

/* A track that is integrated when it is asked for (panels.Motion). */
typedef struct {
  track_t track; /* edges, coefficients are filled here */
  panels_t integrate;
  drive_t drive; /* in the panels' variable */
  method_t method;
  long nx, nc, room, done; /* states of a body; constants; panels; whether it is integrated */
  const long *known;   /* room that motions like this have needed */
  double tolerance, slip, share; /* see panels.Problem: share is `finish` */
  const double *start, *constants, *scale;
  double *block; /* room: state, spare, work, edges, coefficients */
} motion_t;

/* Numbers in a block with its room */
long room_of(const motion_t *m) {
  const long size = m->track.nb * m->nx;
  return 2 * size + (2 * m->nx + 2) * N + m->room * (size * (N + 1) + 1) + 1;
}

/* Returns 0, or the code of panels. */
long move(motion_t *m) {
  if (m->done) return 0;
  track_t *k = &m->track;
  const long size = k->nb * m->nx;
  double *spare = m->block + size, *work = spare + size, *edges = work + (2 * m->nx + 2) * N;
  double *series = edges + m->room + 1, finish = m->share * m->tolerance;
  method_t *method = &m->method;
  /* below 4e-16 a series' tail is rounding noise */
  method->tolerance = m->tolerance > 4e-15 ? 0.1 * fmin(m->tolerance, COARSE) : 4e-16;
  method->finish = finish, method->slip = m->slip > finish ? m->slip : 0.0;
  method->released = -1.0, method->max_panels = m->room, k->n_anchors = 0;
  memcpy(m->block, m->start, size * sizeof(double));
  long count = m->integrate(k->nb, m->block, m->constants, m->scale, &m->drive, &m->method, edges,
                            series, work, spare);
  if (count < 0) return count;
  k->n_panels = count, k->edges = edges, k->coefficients = series;
  k->panel_stride = size * (N + 1), k->body_stride = m->nx * (N + 1);
  m->done = 1;
  return 0;
}

typedef void (*kernel_t)(long, long, const double *, const long *, long, const double *, double *,
                         const long *, long);
typedef void (*anchor_t)(track_t *, const double *, double *, double *, double *);

/* A track of a plan and where its rows go. */
typedef struct {
  evaluate_t evaluate;
  track_t *track;
  long moves;          /* k > 0: it is the track of motion k - 1 */
  long offset, stride; /* of body 0, from body to body, in blocks of rows */
  long first, last;    /* the first, the last track of its side */
  /* for fill_begun: of the motion's states, its own first one; where coordinates are continued: u v theta where
     the side begins, and how, by the track's branch, from its path velocity W, or by anchors */
  long row;
  const double *begin, *path;
  kernel_t branch;
  anchor_t anchor;
} part_t;

static long earlier(const double *t, long nt, double edge) {
  long low = 0, high = nt;
  while (low < high) {
    long middle = (low + high) / 2;
    if (t[middle] < edge) low = middle + 1; else high = middle;
  }
  return low;
}

#define MOST_ROWS 9

static int in_order(const double *t, long nt) {
  long back = 0;
  for (long i = 0; i + 1 < nt; i++) back += !(t[i] <= t[i + 1]);
  return !back;
}

/* Write `count` rows of a track where its interval is; times are in order unless it is its side's only
   one. Returns the code of evaluate. */
static long fill_part(const part_t *part, const track_t *track, long count, long nt, const double *t,
                      double *out) {
  long rows[MOST_ROWS], from = 0, to = nt;
  for (long r = 0; r < count; r++) rows[r] = r * nt;
  if (!part->first) from = earlier(t, nt, track->start);
  if (!part->last) to = earlier(t, nt, track->stop);
  if (from >= to) return 0;
  const long code = part->evaluate(track, to - from, t + from, out + part->offset * count * nt + from, rows,
                                   part->stride * count * nt);
  return code > 0 ? code + from : code < 0 ? code - from : 0;
}

/* Write `count` rows of every track: out[block][count][nt]. Returns 0; 1 + the index of a time outside
   the plan; -1 - the index of a time with a result that is not finite. at[0]: the code of panels, if
   that is what failed, of motion at[1]; 1 if the times are not in order. From at[2] on: the motions, whose
   addresses are longer than a long on Windows. */
long fill(const part_t *parts, long n_parts, long count, long nt, const double *t, double *out,
          int64_t *at) {
  int ordered = 0;
  at[0] = 0;
  for (long p = 0; p < n_parts; p++) {
    const part_t *part = parts + p;
    const track_t *track = part->track;
    if (part->moves) {
      motion_t *motion = (motion_t *)(intptr_t)at[1 + part->moves];
      at[1] = part->moves - 1;
      if ((at[0] = move(motion))) return -1;
      track = &motion->track;
    }
    if (!ordered && !(part->first && part->last) && !(ordered = in_order(t, nt))) {
      at[0] = 1;
      return -1;
    }
    const long code = fill_part(part, track, count, nt, t, out);
    if (code) return code;
  }
  return 0;
}

/* Scenes of one kind (kinds.py): their plans differ in the numbers of one block, where their tracks point. */
typedef struct {
  long at, width, place; /* among the numbers of a contact; in the block, of contact 0 */
} field_t;

/* A motion and where its last state is wanted: [nb][nx] in the block */
typedef struct {
  const motion_t *motion;
  long end;
} move_t;

/* What is worked out where tracks begin: at the start, from where contacts start; later, from where their
   motions ended. */
typedef struct {
  kernel_t find;                     /* numbers of a contact -> facts and fields */
  const double *parameters, *limits; /* [nb][n_parameters]; [n_facts][2] */
  const field_t *given, *fields;
  const move_t *moves;               /* what is integrated from here on */
  long n_parameters, n_facts, facts, n_given, n_fields, n_moves; /* facts: their place in the block */
} stage_t;

typedef struct {
  const stage_t *stages;
  const long *rows;    /* 0, 1, 2, ...; from MOST_FOUND on 0, MOST, 2 MOST, ... */
  const double *block; /* where the tracks of the kind point */
  long nb, n_stages, n_moves, size;
} kind_t;

/* Fill what a stage says of contacts [first, first + n): the greatest of each fact (the first is slip), then
   the fields; of contacts on the same surfaces side by side. Returns 0, or 1 + the fact that is beyond what
   scenes of this kind can have. */
static long work_out(const kind_t *k, const stage_t *s, double *block, long first, long n) {
  double given[MOST_FOUND * MOST], found[MOST_FOUND * MOST], *facts = block + s->facts;
  const long most = n > 1 ? MOST : 1, np = s->n_parameters, *rows = k->rows + (n > 1 ? MOST_FOUND : 0);
  for (long b = first, m; b < first + n; b += m) {
    const double *parameters = s->parameters + b * np;
    for (m = 1; m < most && b + m < first + n; m++)
      if (memcmp(parameters, parameters + m * np, np * sizeof *parameters)) break;
    for (const field_t *f = s->given; f < s->given + s->n_given; f++)
      for (long i = 0; i < m; i++)
        for (long w = 0; w < f->width; w++)
          given[(f->at + w) * most + i] = block[f->place + (b + i) * f->width + w];
    s->find(1, m, given, rows, 0, parameters, found, rows, 0);
    for (long f = 0; f < s->n_facts; f++)
      for (long i = 0; i < m; i++) {
        const double fact = found[f * most + i];
        if (!(fact >= s->limits[2 * f] && fact <= s->limits[2 * f + 1])) return 1 + f;
        if (b + i == first || fact > facts[f]) facts[f] = fact;
      }
    for (const field_t *f = s->fields; f < s->fields + s->n_fields; f++)
      for (long i = 0; i < m; i++)
        for (long w = 0; w < f->width; w++)
          block[f->place + (b + i) * f->width + w] = found[(f->at + w) * most + i];
  }
  return 0;
}

/* Fill a scene's block with what its start says. Returns as work_out. */
long begin(const kind_t *k, const double *starts, double *block) {
  const field_t *start = k->stages->given;
  memcpy(block + start->place, starts, k->nb * start->width * sizeof(double));
  return work_out(k, k->stages, block, 0, k->nb);
}

/* From the block of the kind to that of a scene; kind NULL: nothing is carried. */
static const double *carried(const double *p, const kind_t *k, const double *block) {
  return k && p >= k->block && p < k->block + k->size ? block + (p - k->block) : p;
}

/* Bodies [first, first + n) of a track whose anchors are not asked for, with a scene's numbers */
static track_t own_track(const track_t *track, const kind_t *k, const double *block, long first, long n) {
  track_t own = *track;
  own.nb = n, own.n_anchors = 0;
  own.constants = carried(own.constants, k, block) + first * own.n_constants;
  own.w = carried(own.w, k, block) + first * own.n_drive;
  own.v = carried(own.v, k, block) + first * own.n_drive;
  if (own.turn) own.turn = carried(own.turn, k, block) + 4 * first;
  if (own.offset) own.offset += 2 * first;
  if (own.coefficients) own.coefficients += first * own.body_stride;
  return own;
}

/* Integrate a motion of the kind for contacts of a scene, into memory that is to be freed where 0 is returned.
   slip: of these contacts where the motion begins. Where the room known is too small, whoever keeps motions
   learns more. */
static long own_motion(motion_t *own, const motion_t *motion, const kind_t *k, const double *block,
                       double slip, double tolerance, long first, long n) {
  *own = *motion, own->track.coefficients = NULL;
  own->track = own_track(&own->track, k, block, first, n);
  own->start = carried(own->start, k, block) + first * own->nx;
  own->scale = carried(own->scale, k, block) + first * own->nx;
  own->constants = carried(own->constants, k, block) + first * own->nc;
  if (own->slip > 0.0 && own->method.n_stiff == 0) own->slip = slip;
  own->tolerance = tolerance, own->done = 0, own->room = *own->known;
  own->block = malloc(room_of(own) * sizeof(double));
  if (!own->block) return -1;
  const long code = move(own);
  if (code) free(own->block);
  return code;
}

static long chunk(long last, long first) { return last - first < MOST ? last - first : MOST; }

/* Integrate all motions of some contacts, stage by stage. Returns 0; counts those that were integrated. */
static long own_motions(motion_t *moved, const kind_t *k, double *block, double tolerance, long first, long n,
                        long *made) {
  for (const stage_t *s = k->stages; s < k->stages + k->n_stages; s++) {
    if (s > k->stages && work_out(k, s, block, first, n)) return -1;
    for (const move_t *m = s->moves; m < s->moves + s->n_moves; m++) {
      motion_t *own = moved + *made;
      if (own_motion(own, m->motion, k, block, block[s->facts], tolerance, first, n)) return -1;
      memcpy(block + m->end + first * own->nx, own->block, n * own->nx * sizeof(double));
      ++*made;
    }
  }
  return 0;
}

/* Let coordinates of a track continue last [nb][3], with memory that is to be freed after use. Returns 0;
   1: none is left. */
static int continued(const part_t *part, track_t *track, const kind_t *k, const double *block, long first,
                     const double *last, double **memory) {
  const long nb = track->nb, m = 4 * track->n_panels + 1, nc = track->n_constants;
  *memory = NULL;
  if (part->branch) {
    const double *w = carried(part->path, k, block) + 2 * first;
    double *constants = (double *)track->constants; /* in a block of one's own */
    for (long b = 0; b < nb; b++, constants += nc) {
      double point[4 + NODE] = {last[3 * b + 1], last[3 * b + 2], w[2 * b], w[2 * b + 1]};
      memcpy(point + 4, constants + nc - BRANCH - NODE, NODE * sizeof(double));
      part->branch(1, 1, point, k->rows, 0, NULL, constants + nc - BRANCH, k->rows, 0);
    }
  } else if (part->anchor) {
    if (!(*memory = malloc((1 + 8 * nb) * m * sizeof(double)))) return 1;
    part->anchor(track, last, *memory, *memory + m, *memory + (1 + 3 * nb) * m);
  }
  return 0;
}

/* Where coordinates of a track are at its end: last [nb][3] */
static long end_of(const part_t *part, const track_t *track, double *last) {
  static const long row[] = {0, 1, 2, 3, 4};
  double values[MOST * 5];
  const long code = part->evaluate(track, 1, &track->stop, values, row, 5);
  for (long b = 0; b < track->nb; b++)
    last[3 * b] = values[5 * b], last[3 * b + 1] = values[5 * b + 1], last[3 * b + 2] = values[5 * b + 4];
  return code ? -1 : 0;
}

/* What fill_begun and states are asked, in one piece: ctypes takes 0.1 us over each argument. Arrays are told by
   where Python keeps their addresses. */
typedef struct {
  const kind_t *kind; /* of a scene of a kind; or NULL, with motions that were integrated */
  const double *block;
  double tolerance;
  const void *what;         /* part_t[n_parts], or states_t */
  long n_parts, count;      /* rows of each body */
  long first, last, nt;     /* contacts [first, last) at nt times */
  const double *const *t;
  double *const *out;
} asked_t;

/* `fill` for some contacts of a scene of a kind, a few at a time, with motions that are not kept. A negative
   code says only that `fill` is to be asked. */
long fill_begun(const asked_t *asked) {
  const kind_t *k = asked->kind;
  const part_t *parts = asked->what;
  const double *block = asked->block, *t = *asked->t, tolerance = asked->tolerance;
  const long n_parts = asked->n_parts, count = asked->count, last = asked->last, nt = asked->nt;
  motion_t *moved = NULL;
  double *own = NULL, *out = *asked->out;
  long code = 0, first = asked->first;
  if (k->n_stages > 1 && !in_order(t, nt)) return -1;
  if (k->n_moves || k->n_stages > 1) { /* the scene's block is shared by all who plan it */
    moved = malloc(k->n_moves * sizeof *moved + k->size * sizeof *own);
    if (!moved) return -1;
    block = own = memcpy(moved + k->n_moves, block, k->size * sizeof *own);
  }
  for (; first < last && !code; first += MOST) {
    const long n = chunk(last, first);
    double where[3 * MOST], *memory = NULL;
    long made = 0;
    if (moved) code = own_motions(moved, k, own, tolerance, first, n, &made);
    for (const part_t *part = parts; part < parts + n_parts && !code; part++) {
      track_t track = own_track(part->track, k, block, first, n);
      if (part->moves) {
        const track_t *whole = &moved[part->moves - 1].track;
        track.edges = whole->edges, track.n_panels = whole->n_panels;
        track.panel_stride = whole->panel_stride, track.body_stride = whole->body_stride;
        track.coefficients = whole->coefficients + part->row * (N + 1);
      }
      if (part->begin && part->first)
        memcpy(where, carried(part->begin, k, block) + 3 * first, 3 * n * sizeof(double));
      if (part->begin && continued(part, &track, k, block, first, where, &memory))
        code = -1;
      else
        code = fill_part(part, &track, count, nt, t, out + first * part->stride * count * nt);
      if (part->begin && !part->last && !code) code = end_of(part, &track, where);
      free(memory);
      memory = NULL;
    }
    while (made) free(moved[--made].block);
  }
  free(moved);
  return code;
}

/* Chart states of finger and object. Where a side is dear at each time (two or three arc tangents) and there
   are many times, it is turned into series of chart states, piece by piece, which cost 16 multiplications a
   number. Where decay falls too fast for a series, the object's rates are kept as two smooth parts,
   u' = a - decay b. */
#define OUT 9  /* u1 v1 u1' v1' u2 v2 u2' v2' psi */
#define SIDE 5 /* u v u' v' theta */
#define ROWS 7 /* u v a a theta b b */
#define SERIES_PAY 68 /* times a panel; a great circle counts as three */

typedef struct {
  evaluate_t evaluate, resolve; /* SIDE rows; `rows` rows of what series are made of, or NULL */
  anchor_t anchor;              /* where u, v, theta are to be continued from begin; or NULL */
  const void *track;            /* a track_t, or a motion_t where it moves */
  long moves, rows;
  const double *begin; /* [nb][3] */
} side_t;

typedef struct {
  side_t side[2];
  const double *angle, *node, *project; /* [nb]; [N]; [N][N], node values -> Chebyshev coefficients */
} states_t;

typedef struct {
  double start, stop; /* local times, or lengths */
  long terms, slips;  /* terms that count; whether b is kept apart */
} piece_t;

/* The series of a side: [count][nb][ROWS][N], at most `size` numbers a piece. Where nothing slips they are of the
   path's length, with rates by length: smoother than of time, whatever sigma does. fine: where lengths' rounding
   counts, whose terms may be 1e5 times as large as they are. */
typedef struct {
  const track_t *track;
  long along, fine, count, room, size;
  piece_t *pieces;
  double *series;
} series_t;

static int grow(series_t *s) {
  const long room = s->room ? 4 * s->room : 16;
  piece_t *pieces = realloc(s->pieces, room * sizeof *pieces);
  if (pieces) s->pieces = pieces;
  double *series = realloc(s->series, room * s->size * sizeof *series);
  if (series) s->series = series;
  if (pieces && series) s->room = room;
  return pieces && series;
}

/* Continue values [nb][rows][N] at the nodes of a piece from last [nb][3]. */
static void follow(const track_t *k, long rows, double *last, double *values) {
  static const long row[SIDE] = {0, N, 2 * N, 3 * N, 4 * N};
  for (long j = 0; j < k->nb; j++, values += rows * N, last += 3)
    for (int i = 0; i < N; i++) {
      if (wind(k, last, 1, values + i, row) && rows == ROWS)
        values[5 * N + i] = -values[5 * N + i], values[6 * N + i] = -values[6 * N + i];
      last[0] = values[i], last[1] = values[N + i], last[2] = values[4 * N + i];
    }
}

/* Values [nb][ROWS][N] as [nb][SIDE][N], with b in a where slips */
static void join(const track_t *k, int slips, const double *tau, const double *values, double *combined) {
  double sigma[N], decay[N] = {0};
  if (slips) {
    if (k->drive.power) horners(k->drive.sigma, k->drive.n_sigma, tau, N, sigma);
    decays(&k->drive, tau, sigma, N, decay);
  }
  for (long j = 0; j < k->nb; j++, values += ROWS * N, combined += SIDE * N) {
    memcpy(combined, values, SIDE * N * sizeof(double));
    for (int i = 0; i < 2 * N; i++) combined[2 * N + i] -= decay[i % N] * values[5 * N + i];
  }
}

/* Coefficients [nb][ROWS][N] from values [nb][rows][N] at the nodes of a piece. Returns the greatest
   tail, in units of each row's size, and counts the terms that make more than 0.3 of the tolerance.
   A tail is taken for twice the last coefficient. A rate that is small beside the others may be noise: along a
   meridian the other one is. */
INLINE double resolve(const double *project, long nb, int rows, double tolerance, const double *values,
                      piece_t *piece, double *series) {
  static const int angle[ROWS] = {1, 1, 0, 0, 1, 0, 0};
  double worst = 0.0, sizes[ROWS];
  piece->terms = 2;
  for (long j = 0; j < nb; j++, values += rows * N, series += ROWS * N) {
    combine(project, N, rows, values, N, NULL, 1.0, series, N);
    double rates = 0.0;
    for (long r = 0; r < rows; r++) {
      double size = 0.0;
#pragma omp simd reduction(max : size)
      for (int i = 0; i < N; i++) size = fabs(values[r * N + i]) > size ? fabs(values[r * N + i]) : size;
      sizes[r] = size;
      if (!angle[r] && size > rates) rates = size;
    }
    for (long r = 0; r < rows; r++) {
      const double *c = series + r * N, least = angle[r] ? 1.0 : 0.01 * rates;
      const double size = sizes[r] > least ? sizes[r] : least;
      const double tail = 2.0 * fmax(fabs(c[N - 1]), 0.1 * fabs(c[N - 2]));
      if (tail > worst * size) worst = tail / size; /* evaluate lets no NaN pass */
      long terms = N;
      for (double left = 0.3 * tolerance * size; terms > piece->terms; terms--)
        if ((left -= fabs(c[terms - 1])) < 0.0) break;
      piece->terms = terms;
    }
  }
  return worst;
}

/* The local time, `end` at most, before which a path that was at `at` grows by `length` */
static double until(const track_t *k, double at, double end, double length) {
  const double from = horner(k->length, k->drive.n_sigma + 1, at);
  for (int i = 0; i < 60; i++) {
    const double grown = horner(k->length, k->drive.n_sigma + 1, end) - from;
    if (!(grown > length)) break;
    end = at + 0.99 * length / grown * (end - at);
  }
  return end;
}

/* Where a piece from `at` must end: after so many panels. A longer one may look smooth at N nodes that miss whole
   turns. */
static double panels_bound(const track_t *k, double at, long panels, long *panel) {
  const double end = k->stop - k->start;
  const double x = k->by_length ? horner(k->length, k->drive.n_sigma + 1, at) : at;
  *panel = interval(k->edges, k->n_panels, x, *panel);
  if (*panel + panels >= k->n_panels) return end;
  return k->by_length ? until(k, at, end, k->edges[*panel + panels] - x) : k->edges[*panel + panels];
}

/* The same of great circles, whose series converge like rho^-n. Coordinates are singular `away` from the highest
   and lowest points, at imaginary phases, sinh(away) = cot(inclination). They must not lie within the piece's
   Bernstein ellipse of rho (Trefethen, Approximation Theory and Approximation Practice, theorem 8.2), so that one
   that is `ahead` lets it have 2 (a hypot(ahead, away) - ahead) / b^2 radians. There are 5 at most. */
static double circles_bound(const track_t *k, double at, double rho, const double *away) {
  const double pi = 0.5 * TURN, a = 0.5 * (rho + 1.0 / rho), b = 0.5 * (rho - 1.0 / rho);
  const double end = k->stop - k->start, length = horner(k->length, k->drive.n_sigma + 1, at);
  double most = HUGE_VAL;
  for (long j = 0; j < k->nb; j++) {
    const double past = k->constants[(j + 1) * k->n_constants - BRANCH - NODE + 2];
    /* fewest radians at x: the singular points on both sides of it count. 2.5 pi: phases may be negative */
    const double x = away[j] / b, one = x - fmod(past + k->v[j] * length + 2.5 * pi + x, pi), two = one + pi;
    const double far = away[j] * away[j];
    const double least = fmin(a * sqrt(one * one + far) - one, a * sqrt(two * two + far) - two);
    most = fmin(most, fmin(5.0, 2.0 * least / (b * b)) / k->v[j]);
  }
  const double stop = at + shared(until(k, at, end, most) - at, end - at);
  return stop < (1 - 1e-14) * end ? stop : end;
}

/* How far from their highest and lowest points great circles' coordinates are singular; far enough is 100. */
static void singular(const track_t *k, double *away) {
  for (long j = 0; j < k->nb; j++) {
    const double *node = k->constants + (j + 1) * k->n_constants - BRANCH - NODE;
    away[j] = node[1] > 0.0 ? fmin(asinh(node[0] / node[1]), 100.0) : 100.0;
  }
}

/* The pieces of one side; false if it takes more than `most` tries to resolve it: near a pole of the chart
   rounding may ask for pieces without end. last: [nb][3], where it begins. */
static int divide(const states_t *p, const side_t *side, const track_t *k, double tolerance, long most,
                  double *last, series_t *s) {
  static const long row[ROWS] = {0, N, 2 * N, 3 * N, 4 * N, 5 * N, 6 * N};
  const long nb = k->nb, size = nb * ROWS * N;
  const double end = k->stop - k->start;
  double values[ROWS * N * MOST], combined[SIDE * N * MOST], before[3 * MOST], away[MOST], tau[N], times[N];
  long tries = 0, panel = 0, refused = 0;
  /* with 6, of 100 pieces 1 to 13 are refused, and few are much shorter than they could be */
  const double rho = k->edges ? 0.0 : pow(6.0 / tolerance, 1.0 / (N - 1));
  double at = 0.0, h = k->edges ? panels_bound(k, 0.0, 1, &panel) : HUGE_VAL, tail;
  if (!k->edges) singular(k, away);
  for (s->count = 0; at < end; tries++) {
    if (tries == most) return 0;
    if (s->count == s->room && !grow(s)) return 0;
    piece_t *piece = s->pieces + s->count;
    double *series = s->series + s->count * size;
    double stop = k->edges ? panels_bound(k, at, 2, &panel) : circles_bound(k, at, rho, away);
    stop = at + h < (1 - 1e-14) * stop ? at + h : stop;
    for (int i = 0; i < N; i++) {
      tau[i] = at + 0.5 * (stop - at) * (1.0 + p->node[i]);
      times[i] = k->start + tau[i] < k->stop ? k->start + tau[i] : k->stop;
    }
    *piece = (piece_t){at, stop, N, 0};
    if (side->resolve(k, N, times, values, row, side->rows * N)) return 0;
    memcpy(before, last, 3 * nb * sizeof(double));
    if (side->anchor) follow(k, side->rows, last, values);
    if (side->rows == ROWS) {
      /* once exp(-40) of the slip is left, its part of the rates is below rounding */
      piece->slips = horner(k->drive.exponent, k->drive.n_exponent, at) < 40.0;
      join(k, piece->slips, tau, values, combined);
      tail = resolve(p->project, nb, SIDE, tolerance, combined, piece, series);
      /* a layer before the first node would look smooth: motions pass one that moves the contact too little */
      const int seen = gain_at(&k->drive, at) * (stop - at) <= STEEPEST;
      if (tail <= tolerance && seen)
        piece->slips = 0;
      else if (piece->slips)
        tail = resolve(p->project, nb, ROWS, tolerance, values, piece, series);
    } else
      tail = resolve(p->project, nb, SIDE, tolerance, values, piece, series);
    /* such a tail is rounding and says nothing of the length; by length paths change little on their way. powf
       takes half of pow's time */
    const double unknown = s->along ? 1.5 : HUGE_VAL;
    const double next = tail < 2e-15 ? unknown : 0.9 * powf(tolerance / tail, 1.0f / N);
    if (tail <= tolerance) {
      /* what grew harder goes on growing harder (16 % fewer samples) */
      const double most = refused ? 0.8 : 4.0;
      h = (stop - at) * (next < most ? next : most);
      at = stop, s->count++;
      if (k->edges && next >= most && !refused && at < end) /* after a layer, as the motion does */
        h = fmax(h, panels_bound(k, at, 1, &panel) - at);
      h = k->edges ? shared(h, end - at) : HUGE_VAL;
      refused = 0;
    } else {
      h = (stop - at) * (next > 0.2 ? next < 0.8 ? next : 0.8 : 0.2);
      refused = 1;
      memcpy(last, before, 3 * nb * sizeof(double));
    }
  }
  return 1;
}

/* The same track at local times that are lengths of its path, so that rates are by length */
static track_t track_along(const track_t *k) {
  static const double one[] = {1.0}, same[] = {0.0, 1.0};
  track_t along = *k;
  along.start = 0.0, along.stop = horner(k->length, k->drive.n_sigma + 1, k->stop - k->start);
  along.drive.sigma = one, along.drive.n_sigma = 1, along.length = same;
  return along;
}

/* Where n times are: local times, or lengths */
static void places(const series_t *s, const double *t, long n, double *tau, double *place) {
  const track_t *k = s->track;
  for (long i = 0; i < n; i++) tau[i] = t[i] - k->start;
  if (s->along && s->fine)
    lengths(k, tau, n, place);
  else if (s->along)
    horners(k->length, k->drive.n_sigma + 1, tau, n, place);
  else
    memcpy(place, tau, n * sizeof *place);
}

/* Write a side's rows u v u' v' of body b to out[b * OUT + r], and psi less theta; angle: psi without
   any, or NULL where the other side's is in place. */
static void fill_side(const series_t *s, const double *angle, int ordered, long nt, const double *t, double *out,
                      double *psi) {
  const track_t *k = s->track;
  double xi[WIDTH] = {0}, sums[ROWS][WIDTH], tau[BLOCK], place[BLOCK], sigma[BLOCK], decay[BLOCK];
  for (long from = 0, near = 0, n; from < nt; from += n) {
    const long most = nt - from < BLOCK ? nt - from : BLOCK;
    places(s, t + from, most, tau, place);
    while (near && place[0] < s->pieces[near].start) near--;
    while (near + 1 < s->count && place[0] >= s->pieces[near].stop) near++;
    const piece_t *piece = s->pieces + near;
    const double low = near ? piece->start : -HUGE_VAL, pace = 2.0 / (piece->stop - piece->start);
    const double high = near + 1 < s->count ? piece->stop : HUGE_VAL;
    n = ordered && place[most - 1] <= high ? most : 1;
    while (n < most && place[n] >= low && place[n] <= high) n++;
    for (long i = 0; i < n; i++) {
      const double x = (place[i] - piece->start) * pace - 1.0;
      xi[i] = x < 1.0 ? x : 1.0;
    }
    if (piece->slips) {
      if (k->drive.power) horners(k->drive.sigma, k->drive.n_sigma, tau, n, sigma);
      decays(&k->drive, tau, sigma, n, decay);
    }
    if (s->along) horners(k->drive.sigma, k->drive.n_sigma, tau, n, sigma);
    for (long b = 0; b < k->nb; b++) {
      const double *c = s->series + (near * k->nb + b) * ROWS * N;
      double *to = out + b * OUT * nt + from, *y[ROWS];
      /* what is written beyond n is written again, but for the last of a row */
      const int spare = from + n + LANES <= nt;
      for (long r = 0; r < ROWS; r++) y[r] = spare && r < 4 ? to + r * nt : sums[r];
      if (piece->slips) {
        chebyshev(c, N, ROWS, piece->terms, xi, n, y);
        for (long r = 2; r < 4; r++)
          for (long i = 0; i < n; i++) y[r][i] -= decay[i] * sums[r + 3][i];
      } else
        chebyshev(c, N, SIDE, piece->terms, xi, n, y);
      for (long r = 2; r < 4 && s->along; r++)
        for (long i = 0; i < n; i++) y[r][i] *= sigma[i];
      for (long r = 0; r < 4 && !spare; r++) memcpy(to + r * nt, sums[r], n * sizeof(double));
      double *own = psi + b * OUT * nt + from;
      if (angle)
        for (long i = 0; i < n; i++) own[i] = angle[b] - sums[4][i];
      else
        for (long i = 0; i < n; i++) own[i] -= sums[4][i];
    }
  }
}

/* Whether times follow each other, from where a track starts, so closely that one tells the next its branch */
static int closely(const track_t *k, long nt, const double *t) {
  double shortest = HUGE_VAL, last = 0.0;
  for (long p = 0; p < k->n_panels; p++) shortest = fmin(shortest, k->edges[p + 1] - k->edges[p]);
  for (long i = 0; i < nt; i++) {
    const double tau = t[i] - k->start, x = k->by_length ? horner(k->length, k->drive.n_sigma + 1, tau) : tau;
    if (!(x >= last && x - last <= 0.25 * shortest)) return 0;
    last = x;
  }
  return 1;
}

/* The same from the side itself, which begins at begin. Returns the code of evaluate. */
static long copy_side(const side_t *side, track_t *k, const double *begin, const double *angle, long nt,
                      const double *t, double *out, double *psi) {
  const long row[SIDE] = {0, nt, 2 * nt, 3 * nt, psi - out}, nb = k->nb; /* theta goes where psi is to be */
  const int follows = side->anchor && !k->double_cover && closely(k, nt, t);
  const long m = side->anchor && !follows ? 4 * k->n_panels + 1 : 0, before = angle ? 0 : nb * nt;
  double *memory = malloc((before + (1 + nb * (3 + SIDE)) * m + 1) * sizeof(double)), *at = memory + before;
  if (!memory) return -1;
  if (m) side->anchor(k, begin, at, at + m, at + (1 + 3 * nb) * m);
  for (long b = 0; b < nb && before; b++) memcpy(memory + b * nt, psi + b * OUT * nt, nt * sizeof(double));
  const long code = side->evaluate(k, nt, t, out, row, OUT * nt);
  for (long b = 0; b < nb && !code; b++, out += OUT * nt, psi += OUT * nt, begin += 3) {
    double last[3];
    if (follows) memcpy(last, begin, sizeof last);
    for (long i = 0; i < nt && follows; i++) {
      wind(k, last, 1, out + i, row);
      last[0] = out[i], last[1] = out[nt + i], last[2] = psi[i];
    }
    for (long i = 0; i < nt; i++) psi[i] = (angle ? angle[b] : memory[b * nt + i]) - psi[i];
  }
  free(memory);
  return code;
}

/* States of body b go to out[(b * OUT + r) * nt + i], a few contacts at a time: theirs stay in the cache.
   Returns 0; 1 + the index of the first time outside the tracks; < 0: ask the tracks. */
long states(const asked_t *asked) {
  const kind_t *kind = asked->kind;
  const states_t *p = asked->what;
  const double *block = asked->block, *t = *asked->t, tolerance = asked->tolerance;
  const long last = asked->last, nt = asked->nt;
  long first = asked->first;
  double *out = *asked->out;
  const int ordered = in_order(t, nt);
  /* 1e-14: less is rounding; 1e-3: more would hide that a path was followed to another branch */
  const double bar = fmin(tolerance > 1e-13 ? 0.1 * tolerance : 1e-14, 1e-3);
  const double *angle = carried(p->angle, kind, block);
  series_t s = {.size = chunk(last, first) * ROWS * N, .fine = bar < 1e-8};
  long code = 0;
  if (!nt) return 0;
  for (int object = 0; object < 2 && !kind; object++) { /* who keeps motions keeps anchors too */
    const motion_t *motion = p->side[object].track;
    if (p->side[object].anchor && nt <= 4 * motion->track.n_panels) return -4;
  }
  for (out += first * OUT * nt; first < last && !code; first += MOST, out += MOST * OUT * nt)
    for (int object = 0; object < 2 && !code; object++) {
      const side_t *side = p->side + object;
      const motion_t *motion = side->track;
      const long n = chunk(last, first);
      double *rows = out + 4 * object * nt, *psi = out + (OUT - 1) * nt, where[3 * MOST] = {0};
      const double *from = object ? NULL : angle + first;
      motion_t own;
      if (!side->moves || !kind)
        own.track = own_track(side->moves ? &motion->track : side->track, kind, block, first, n);
      else if ((code = own_motion(&own, motion, kind, block, block[kind->stages->facts], tolerance, first, n)))
        break;
      track_t *k = &own.track;
      if (!ordered || !(t[0] >= k->start && t[nt - 1] <= k->stop))
        for (long i = 0; i < nt && !code; i++)
          if (!(t[i] >= k->start && t[i] <= k->stop)) code = i + 1;
      if (side->anchor) memcpy(where, carried(side->begin, kind, block) + 3 * first, 3 * n * sizeof(double));
      if (!code && !(side->resolve && nt > SERIES_PAY * (k->edges ? k->n_panels : 3)))
        code = copy_side(side, k, where, from, nt, t, rows, psi);
      else if (!code) {
        /* by nt / 16 tries N nodes are as many samples as the times: series save nothing */
        const track_t along = track_along(k);
        s.track = k, s.along = !k->slips && (k->by_length || !k->edges) && along.stop > 0.0;
        double last[3 * MOST];
        memcpy(last, where, 3 * n * sizeof(double));
        if (divide(p, side, s.along ? &along : k, bar, 20 + nt / 16, last, &s))
          fill_side(&s, from, ordered, nt, t, rows, psi);
        else
          code = copy_side(side, k, where, from, nt, t, rows, psi);
      }
      if (side->moves && kind) free(own.block);
    }
  free(s.pieces);
  free(s.series);
  return code;
}
