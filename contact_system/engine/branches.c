/* On which branch of its chart a path is: coordinates continued along it.

   Coordinates of a point in space are principal values. Where a chart has periods the nearest turn
   continues them. A chart of a triaxial ellipsoid covers it twice: (u, v) and (-u, pi - v) are one
   point. y = sin u cos v is equal on both covers, so that a point in space determines it. A path
   changes its cover where it crosses the seam cos v = 0. There y changes its sign, but also where
   sin u = 0, which is no seam; beside umbilics, where both are 0, only the crossing itself shows
   which it was. Anchors are places whose branch is known; they lie so close that between two of
   them coordinates move by less than half a period. */

enum { U, V, DU, DV, THETA, N_COORDINATES };
enum { PANEL_ANCHORS = 4, CIRCLE_ANCHORS = 15 }; /* per panel; per revolution, L with its end */

/* u v u' v' theta in principal values at places x of a path, in the variable of its panels or the
   phase of its circle; rates are 0 */
static lanes_t principal(work_t *w, const track_t *k, const double *x) {
  unit_t *u = table_of(w, k->body, IN_SPACE, M_COORDINATES);
  if (k->kind == CIRCLE)
    circle_at(k, x, 6, u->r);
  else
    panels_at(&k->panels, 0, 6, x, u->r);
  fill_lanes(u->r[6], 0.0), fill_lanes(u->r[7], 0.0);
  return run(u);
}

/* Takes one lane of them; returns nonzero if they are not finite, at a pole or an umbilic. */
static int take_lane(const double (*z)[L], int i, double *value) {
  int none = 0;
  for (int r = 0; r < N_COORDINATES; r++) value[r] = z[r][i], none |= !isfinite(value[r]);
  return none;
}

/* Principal values at one place of a path; returns nonzero if they are not finite */
static int principal_at(work_t *w, const track_t *k, double x, double *value) {
  double at[L];
  fill_lanes(at, x);
  return take_lane(principal(w, k, at), 0, value);
}

/* The value, shifted by whole periods to be nearest a reference */
static inline double wound(double value, double reference, double period) {
  const double far = reference - value;
  return fabs(far) <= 0.5 * period || period <= 0 ? value : value + period * rint(far / period);
}

/* In a chart that covers its surface twice: whether cos v < 0, and whether sin u cos v < 0. They
   change where a path crosses cos v = 0 or sin u = 0, and nowhere else. */
static inline int is_odd(double whole) { return fabs(whole) < 1e15 && (int64_t)whole & 1; }
static inline int second_cover(double v) { return is_odd(floor(2.0 * v / TURN + 0.5)); }
static inline int beyond(double u, double v) {
  return is_odd(floor(2.0 * u / TURN)) ^ second_cover(v);
}

/* A place on a path, and y = sin u cos v there, whose sign is that of `beyond`; y is the same on
   both covers */
typedef struct {
  double x, y;
} mark_t;

static inline double side_of(double u, double v) { return sin(u) * cos(v); }

/* Whether a point is on cos v = 0 or sin u = 0 to within rounding: y has no reliable sign there. */
static inline int on_seam(double u, double v) {
  const double a = 2.0 * u / TURN, b = 2.0 * v / TURN - 0.5;
  return fabs(a - rint(a)) < 1e-12 || fabs(b - rint(b)) < 1e-12;
}

/* Shifts u v u' v' theta by whole turns to be nearest a reference u v theta. turned: the point
   moves to the other cover first, to (-u, pi - v), where the chart's axes are turned by pi. */
static inline void wind_to(const surface_t *s, int turned, const double *ref, double *z) {
  const double half = turned ? 0.5 * TURN : 0.0, sign = turned ? -1.0 : 1.0;
  z[U] = wound(sign * z[U], ref[0], s->period_u);
  z[V] = wound(half + sign * z[V], ref[1], s->period_v);
  z[DU] *= sign, z[DV] *= sign;
  z[THETA] = wound(z[THETA] + half, ref[2], TURN);
}

/* Moves a point in principal coordinates to the branch nearer to the reference, which is the one
   where sin u cos v has the reference's sign. */
static void wind(const surface_t *s, const double *ref, double *z) {
  const double u = z[U], v = z[V];
  const double du = wound(u, ref[0], s->period_u) - ref[0];
  const double dv = wound(v, ref[1], s->period_v) - ref[1];
  const double du2 = wound(-u, ref[0], s->period_u) - ref[0];
  const double dv2 = wound(0.5 * TURN - v, ref[1], s->period_v) - ref[1];
  wind_to(s, s->double_cover && du2 * du2 + dv2 * dv2 < du * du + dv * dv, ref, z);
}

/* Whether a path crosses cos v = 0, not sin u = 0, between two marks on different sides; negative:
   whether y < 0 at the first. Only the place of the crossing, found by regula falsi (Illinois),
   tells the two apart beside umbilics. */
static int over_seam(work_t *w, const track_t *k, mark_t a, mark_t b, int negative) {
  double value[N_COORDINATES], last = 0.0, s = 0.0, c = 1.0;
  a.y = negative ? -fabs(a.y) : fabs(a.y), b.y = negative ? fabs(b.y) : -fabs(b.y);
  for (int i = 0; i < 100; i++) {
    double at = a.x + (b.x - a.x) * (a.y / (a.y - b.y));
    if (!(at > a.x && at < b.x)) at = 0.5 * (a.x + b.x);
    /* to rounding: a path may run along a seam and cross it elsewhere */
    if (i && !(at > a.x && at < b.x)) break;
    if (principal_at(w, k, at, value)) return 0;
    s = sin(value[U]), c = cos(value[V]);
    const mark_t found = {at, s * c};
    if (fmin(fabs(s), c) <= 1e-15 * fmax(fabs(s), c)) break;
    if ((found.y < 0.0) == negative) {
      if (last == a.y) b.y *= 0.5;
      a = found;
    } else {
      if (last == b.y) a.y *= 0.5;
      b = found;
    }
    last = found.y;
  }
  return c < fabs(s);
}

/* Whether a path leaves its side of y = 0 and comes back between two marks; there: a place on the
   other side, which is sought where parabolas through three places have their least |y|. */
static int comes_back(work_t *w, const track_t *k, mark_t a, mark_t c, int negative,
                      mark_t *there) {
  const double sign = negative ? -1.0 : 1.0;
  double at = 0.5 * (a.x + c.x), value[N_COORDINATES];
  mark_t b = {at, HUGE_VAL}; /* the least of three */
  a.y *= sign, c.y *= sign;
  if (fmin(a.y, c.y) > 0.25) return 0; /* too far for less than half a radian */
  for (int i = 0; i < 30; i++) {
    if (!(at > a.x && at < c.x) || principal_at(w, k, at, value)) return 0;
    *there = (mark_t){at, side_of(value[U], value[V])};
    const mark_t now = {at, sign * there->y};
    if (now.y < 0.0) return 1;
    if (i == 0) {
      b = now;
    } else if (now.y < b.y) {
      if (at < b.x)
        c = b;
      else
        a = b;
      b = now;
    } else if (at < b.x) {
      a = now;
    } else {
      c = now;
    }
    const double s1 = (b.y - a.y) / (b.x - a.x), s2 = (c.y - b.y) / (c.x - b.x);
    const double curvature = (s2 - s1) / (c.x - a.x);
    at = 0.5 * (a.x + b.x) - 0.5 * s1 / curvature;
    const double lowest = a.y + (at - a.x) * (s1 + curvature * (at - b.x));
    if (!(curvature > 0.0) || lowest > 0.1 * fmax(a.y, c.y)) return 0;
  }
  return 0;
}

/* As `wind`, for the point at x2 on a path that is at ref at x, in a chart that covers its surface
   once. Beside a pole theta and an azimuth change by up to half a turn, and only points in between
   show in which direction: the path is halved until theta changes by less than a quarter turn. */
static void wind_swing(work_t *w, const track_t *k, double x, const double *ref, double x2,
                       double *z) {
  double half[N_COORDINATES];
  const double middle = 0.5 * (x + x2);
  const int swings = fabs(wound(z[THETA], ref[2], TURN) - ref[2]) > 0.25 * TURN;
  if (!swings || !(middle > x && middle < x2) || principal_at(w, k, middle, half)) {
    wind(k->body->surface, ref, z);
    return;
  }
  wind_swing(w, k, x, ref, middle, half);
  wind_swing(w, k, middle, (double[3]){half[U], half[V], half[THETA]}, x2, z);
}

/* Moves the point of a path at `to`, in principal coordinates, to its branch; at `from` the path is
   at ref. bends: whether the path may cross y = 0 and come back in between */
static void wind_along(work_t *w, const track_t *k, mark_t from, const double *ref, mark_t to,
                       int bends, double *z) {
  const surface_t *s = k->body->surface;
  if (!s->double_cover) {
    wind_swing(w, k, from.x, ref, to.x, z);
    return;
  }
  if (on_seam(ref[0], ref[1]) || on_seam(z[U], z[V])) {
    wind(s, ref, z);
    return;
  }
  const int side = beyond(ref[0], ref[1]);
  int turned = second_cover(ref[1]);
  mark_t there;
  if (beyond(z[U], 0.0) != side) {
    turned ^= over_seam(w, k, from, to, side);
  } else if (bends && comes_back(w, k, from, to, side, &there)) {
    turned ^= over_seam(w, k, from, there, side);
    turned ^= over_seam(w, k, there, to, !side);
  }
  wind_to(s, turned, ref, z);
}

/* ---- anchors ---- */

/* Whether |y| falls towards the interval before mark i from both sides */
static int bends_before(const mark_t *m, int64_t n, int64_t i) {
  const int falls = i < 2 || fabs(m[i - 2].y) >= fabs(m[i - 1].y);
  return falls && (i + 1 == n || fabs(m[i + 1].y) >= fabs(m[i].y));
}

/* Principal coordinates at the anchors' places; at a pole, those of the anchor before */
static void raw_anchors(work_t *w, const track_t *k, int64_t n, const double *at,
                        const double *begin, double (*raw)[N_COORDINATES]) {
  for (int64_t from = 0; from < n; from += L) {
    double x[L];
    gather(x, at + from, n - from < L ? (int)(n - from) : L);
    lanes_t z = principal(w, k, x);
    for (int64_t i = from; i < n && i < from + L; i++) {
      if (!take_lane(z, (int)(i - from), raw[i])) continue;
      const double first[N_COORDINATES] = {begin[0], begin[1], 0.0, 0.0, begin[2]};
      memcpy(raw[i], i ? raw[i - 1] : first, sizeof *raw);
    }
  }
}

/* Places of a track's anchors; returns how many */
static int64_t anchor_places(work_t *w, const track_t *k, const double **out) {
  const int64_t parts = k->kind == CIRCLE ? CIRCLE_ANCHORS : PANEL_ANCHORS * k->panels.n;
  double *at = keep(w, parts + 1, sizeof *at);
  for (int64_t i = 0; i < parts; i++) {
    if (k->kind == CIRCLE) {
      at[i] = TURN * (double)i / CIRCLE_ANCHORS;
    } else {
      const double *edge = k->panels.edges + i / PANEL_ANCHORS;
      at[i] = edge[0] + (double)(i % PANEL_ANCHORS) / PANEL_ANCHORS * (edge[1] - edge[0]);
    }
  }
  at[parts] = k->kind == CIRCLE ? TURN : k->panels.edges[k->panels.n];
  *out = at;
  return parts + 1;
}

/* Finds the anchors of a track that begins at u v theta. */
static void anchor_track(work_t *w, track_t *k, const double *begin) {
  const surface_t *s = k->body->surface;
  const double *at;
  const int64_t n = anchor_places(w, k, &at);
  double (*to)[3] = keep(w, n, sizeof *to);
  double (*raw)[N_COORDINATES] = (void *)room_for(w, &w->raw, (size_t)n * (N_COORDINATES + 2));
  mark_t *marks = (mark_t *)(raw + n);
  raw_anchors(w, k, n, at, begin, raw);
  const int twice = s->double_cover;
  for (int64_t i = 0; i < n; i++)
    marks[i] = (mark_t){at[i], twice ? side_of(raw[i][U], raw[i][V]) : 0.0};
  for (int64_t i = 0; i < n; i++) {
    double *z = raw[i];
    if (i)
      wind_along(w, k, marks[i - 1], to[i - 1], marks[i], twice && bends_before(marks, n, i), z);
    else
      wind(s, begin, z);
    to[i][0] = z[U], to[i][1] = z[V], to[i][2] = z[THETA];
  }
  if (k->kind == CIRCLE) /* a revolution later everything is as before but for whole turns */
    for (int j = 0; j < 3; j++) k->turn[j] = TURN * rint((to[n - 1][j] - to[0][j]) / TURN);
  k->anchor_at = at, k->anchors = (const double (*)[3])to, k->n_anchors = n;
}

/* ---- points between two anchors ----
   Where both anchors are on one branch and one side of y = 0, points on that side are on that
   branch. Where the anchors are on two sides, a point goes with the anchor on its own side. For
   points on the other side than both, or between two branches, the path is followed from an anchor.
   An anchor on the seam has no side: then a point goes with the nearer one. */
typedef struct {
  double before[3], after[3];
  double low, high;
  int sides_known, side, cover; /* side and cover of the first anchor */
  int sides_differ, covers_differ;
} between_t;

/* The anchors around a place, `turns` revolutions later */
static between_t between(const track_t *k, double x, double turns, int64_t *hint) {
  const int64_t i = *hint = interval(k->anchor_at, k->n_anchors - 1, x, *hint);
  between_t gap = {.low = k->anchor_at[i], .high = k->anchor_at[i + 1]};
  for (int j = 0; j < 3; j++) {
    gap.before[j] = k->anchors[i][j] + turns * k->turn[j];
    gap.after[j] = k->anchors[i + 1][j] + turns * k->turn[j];
  }
  const double *a = gap.before, *b = gap.after;
  gap.sides_known = !on_seam(a[0], a[1]) && !on_seam(b[0], b[1]);
  if (!gap.sides_known) return gap;
  gap.side = beyond(a[0], a[1]), gap.sides_differ = gap.side != beyond(b[0], b[1]);
  gap.cover = second_cover(a[1]), gap.covers_differ = gap.cover != second_cover(b[1]);
  return gap;
}

/* Moves a point of a path at x, in principal coordinates, to its branch. */
static void wind_between(work_t *w, const track_t *k, const between_t *gap, double x, double *z) {
  const surface_t *s = k->body->surface;
  const double *ref = gap->high - x < x - gap->low ? gap->after : gap->before;
  const double u = z[U], v = z[V];
  if (gap->sides_known) {
    const int differs = beyond(u, 0.0) != gap->side;
    if (!differs && !gap->sides_differ && !gap->covers_differ) {
      wind_to(s, gap->cover, ref, z);
      return;
    }
    if (!on_seam(u, v)) {
      if (!gap->sides_differ) {
        const mark_t from = {gap->low, side_of(gap->before[0], gap->before[1])};
        wind_along(w, k, from, gap->before, (mark_t){x, side_of(u, v)}, 1, z);
        return;
      }
      ref = differs ? gap->after : gap->before;
    }
  }
  wind(s, ref, z);
}

/* Shifts points of a path by whole turns to the nearer anchor, in a chart that covers its surface
   once; beside a pole, where v and theta swing by half a turn, to the one nearer in theta. */
static void wind_once(const track_t *k, const double *x, const double *turns, lanes_t z, int n) {
  const surface_t *s = k->body->surface;
  int64_t at = 0;
  for (int i = 0; i < n; i++) {
    at = interval(k->anchor_at, k->n_anchors - 1, x[i], at);
    const double *edge = k->anchor_at + at, *a = k->anchors[at], *b = k->anchors[at + 1];
    const double more = turns[i] * k->turn[2], theta = z[THETA][i];
    int later = edge[1] - x[i] < x[i] - edge[0];
    if (fabs(b[2] - a[2]) > 0.25 * TURN)
      later = fabs(wound(theta, b[2] + more, TURN) - (b[2] + more)) <
              fabs(wound(theta, a[2] + more, TURN) - (a[2] + more));
    const double *ref = later ? b : a;
    z[U][i] = wound(z[U][i], ref[0] + turns[i] * k->turn[0], s->period_u);
    z[V][i] = wound(z[V][i], ref[1] + turns[i] * k->turn[1], s->period_v);
    z[THETA][i] = wound(theta, ref[2] + more, TURN);
  }
}

/* Moves points of a path at places x, in principal coordinates, to their branches. */
static void wind_all(work_t *w, const track_t *k, const double *x, const double *turns, lanes_t z,
                     int n) {
  int64_t hint = 0;
  between_t gap = {.low = HUGE_VAL, .high = -HUGE_VAL};
  const surface_t *s = k->body->surface;
  if (!s->double_cover) {
    wind_once(k, x, turns, z, n);
    return;
  }
  for (int i = 0; i < n; i++) {
    if (i == 0 || !(x[i] >= gap.low && x[i] < gap.high) || turns[i] != turns[i - 1])
      gap = between(k, x[i], turns[i], &hint);
    double place[N_COORDINATES];
    for (int r = 0; r < N_COORDINATES; r++) place[r] = z[r][i];
    wind_between(w, k, &gap, x[i], place);
    for (int r = 0; r < N_COORDINATES; r++) z[r][i] = place[r];
  }
}
