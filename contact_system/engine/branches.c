/* On which branch of its chart a path is: coordinates continued along it.

   Coordinates of a point in space are principal values. Where a chart has periods the nearest turn
   continues them, but beside a pole theta and an azimuth change by up to half a turn, and only
   points in between show in which direction.

   A chart of a triaxial ellipsoid covers it twice: (u, v) and (-u, pi - v) are one point. On the
   other cover both sin u and cos v have the opposite sign. So their product y is known for a point
   in space, and where a path keeps the sign of y, each factor keeps its own and tells the cover.
   Where y changes its sign, one of the factors does. Close to this place the other one is much
   greater, and tells the cover; beside umbilics, where both are 0, that is very close.

   Anchors are places whose branch is known. Between two of them theta changes by less than a
   quarter turn and y keeps its sign: a point between them is on the branch of the nearer one. */

enum { U, V, DU, DV, THETA, N_COORDINATES };
/* at first: per panel; per revolution, as many as one call of `add_anchors` can add */
enum { PANEL_ANCHORS = 4, CIRCLE_ANCHORS = L - 1 };

/* Nearer to a pole or an umbilic than this part of the body's size, rounding leaves the frame
   without a direction. */
static const double LOST = 1e-12;

/* u v u' v' theta in principal values, from states x p of a body and the components of x' along p
   and q; v and theta are NaN where the frame is lost */
static lanes_t principal(work_t *w, const body_t *b, const double (*state)[L],
                         const double (*velocity)[L]) {
  unit_t *u = table_of(w, b, IN_SPACE, M_COORDINATES);
  copy_rows(u->r, state, 6), copy_rows(u->r + 6, velocity, 2);
  lanes_t z = run(u);
  const double lost = LOST * LOST * b->size * b->size;
  EACH_LANE(i) {
    const double rate = z[DU][i] * z[DU][i] + z[DV][i] * z[DV][i];
    const double speed = velocity[0][i] * velocity[0][i] + velocity[1][i] * velocity[1][i];
    const double none = lost * rate > speed ? NAN : 0.0;
    z[V][i] += none, z[THETA][i] += none;
  }
  return z;
}

/* The same at places x of a path, in the variable of its panels or the phase of its circle, as if
   its speed were 1 */
static lanes_t principal_on(work_t *w, const track_t *k, const double *x) {
  double state[6][L], velocity[2][L];
  for (int j = 0; j < 2; j++) fill_lanes(velocity[j], sqrt(0.5));
  if (k->kind == CIRCLE)
    circle_at(k, x, 6, state);
  else
    panels_at(&k->panels, 0, 6, x, state);
  return principal(w, k->body, state, velocity);
}

/* Copies lane i of them; returns nonzero if it is not finite, as at a pole or an umbilic. */
static int take_lane(const double (*z)[L], int i, double *value) {
  int none = 0;
  for (int r = 0; r < N_COORDINATES; r++) value[r] = z[r][i], none |= !isfinite(value[r]);
  return none;
}

/* The value, shifted by whole periods to be nearest a reference */
static inline double wound(double value, double reference, double period) {
  const double far = reference - value;
  return fabs(far) <= 0.5 * period || period <= 0 ? value : value + period * rint(far / period);
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

/* Moves a point in principal coordinates to the branch on which u v are nearer to a reference. */
static void wind(const surface_t *s, const double *ref, double *z) {
  const double u = z[U], v = z[V];
  const double du = wound(u, ref[0], s->period_u) - ref[0];
  const double dv = wound(v, ref[1], s->period_v) - ref[1];
  const double du2 = wound(-u, ref[0], s->period_u) - ref[0];
  const double dv2 = wound(0.5 * TURN - v, ref[1], s->period_v) - ref[1];
  wind_to(s, s->double_cover && du2 * du2 + dv2 * dv2 < du * du + dv * dv, ref, z);
}

/* sin u and cos v of L points; both 1 in a chart that covers its surface once */
static void find_factors(const surface_t *s, const double (*z)[L], double (*f)[L]) {
  double unused[L];
  if (s->double_cover)
    sincos_of(z[U], f[0], unused, L), sincos_of(z[V], unused, f[1], L);
  else
    fill_lanes(f[0], 1.0), fill_lanes(f[1], 1.0);
}

/* Moves a point in principal coordinates, with these factors, to the branch of an anchor beside it.
   Returns -1 if that is on the other cover, where the factors have the opposite sign; else 1. */
static inline double wind_beside(const surface_t *s, const anchor_t *a, double sin_u, double cos_v,
                                 double *z) {
  const int turned = sin_u * a->sin_u + cos_v * a->cos_v < 0.0;
  wind_to(s, turned, a->place, z);
  return turned ? -1.0 : 1.0;
}

/* ---- anchors ---- */

/* y, or 0 where rounding hides its sign */
static inline double product(double sin_u, double cos_v) {
  return fmin(fabs(sin_u), fabs(cos_v)) < 1e-12 ? 0.0 : sin_u * cos_v;
}

/* Whether y may change its sign, once or twice, between the middle two of four places. At an end of
   a path two of the places are equal.

   It may do so twice if |y| falls before these two and rises after them. If it went on at these
   rates, it would come to 0 in some part of the step from each end. The sum of both parts is 1/3 at
   most for a parabola that touches 0, with equal steps; 0.5 leaves a margin. */
static int may_cross(const double *x, const double *y) {
  const double sign = y[1] + y[2] < 0.0 ? -1.0 : 1.0, step = sign * (x[2] - x[1]);
  const double fall = x[1] > x[0] ? step * (y[0] - y[1]) / (x[1] - x[0]) : HUGE_VAL;
  const double rise = x[3] > x[2] ? step * (y[3] - y[2]) / (x[3] - x[2]) : HUGE_VAL;
  if (y[1] * y[2] < 0.0) return 1;
  return fall > 0.0 && rise > 0.0 && sign * (y[1] / fall + y[2] / rise) < 0.5;
}

/* Whether a path turns back beside a pole in the step to a place with coordinates z: its first and
   its last chord are opposite. Then theta may have changed by nearly a whole turn around the pole.
   Chords are as short as rounding allows: a path that starts almost at rest turns back at once, and
   with chords of 1e-2 of a step, 0.5 % of paths that start within 1e-4 rad of a pole and turn back
   there lost a turn. The rates in z are those at a speed of 1; they are below 3/size farther than a
   quarter of the size from a sphere's pole, and a step is too short to lead around it from there.
 */
static int turns_back(const track_t *k, double from, double to, const double *z) {
  const double size = k->body->size, part = 1e-5 * (to - from), far = 3.0 / size;
  double x[L], at[3][L], along = 0.0;
  if (k->kind == CIRCLE || k->by_length || z[DU] * z[DU] + z[DV] * z[DV] < far * far) return 0;
  gather(x, (double[4]){from, from + part, to - part, to}, 4);
  panels_at(&k->panels, 0, 3, x, at);
  for (int r = 0; r < 3; r++) along += (at[r][1] - at[r][0]) * (at[r][3] - at[r][2]);
  return along < -1e-30 * size * size;
}

/* Adds anchors at places x of a path, except at the last place, which only shows how y goes on.
   Where the branch is not clear, the step is divided into L - 1 parts, and these again, down to
   rounding. Parts are shortest in the middle or, where y changes its sign, where the secant is 0.
   An anchor at a pole repeats the one before. */
static void add_anchors(work_t *w, const track_t *k, const double *x, int64_t *n) {
  double z[N_COORDINATES][L], f[2][L], y[L], own[N_COORDINATES], parts[L];
  copy_rows(z, principal_on(w, k, x), N_COORDINATES);
  find_factors(k->body->surface, z, f);
  for (int i = 0; i < L; i++) y[i] = product(f[0][i], f[1][i]);
  for (int i = 0; i + 1 < L; i++) {
    double *at = room_for(w, &w->edges, (size_t)*n + 1) + *n;
    anchor_t *a = (anchor_t *)room_for(w, &w->series, ((size_t)*n + 1) * ANCHOR_SIZE) + *n;
    const int before = *n > 1 ? -2 : -1;
    const double last = at[-1], step = x[i] - last, y0 = a[-1].y;
    if (!(step > 0.0)) continue;
    *at = x[i], *a = a[-1];
    if (!take_lane(z, i, own)) {
      const double sign = wind_beside(k->body->surface, a - 1, f[0][i], f[1][i], own);
      const double places[4] = {at[before], last, x[i], x[i + 1]};
      const int crosses = may_cross(places, (double[4]){a[before].y, y0, y[i], y[i + 1]});
      const int swings = fabs(own[THETA] - a[-1].place[2]) > 0.25 * TURN;
      const int unclear = crosses || swings || turns_back(k, last, x[i], own);
      if (unclear && last + step / (L - 1) > last) {
        const double middle = last + step * (y0 * y[i] < 0.0 ? y0 / (y0 - y[i]) : 0.5);
        for (int j = 0; j < L; j++) {
          const double t = 2.0 * (j + 1) / (L - 1) - 1.0;
          parts[j] = middle + (t < 0.0 ? middle - last : x[i] - middle) * t * t * t;
        }
        parts[L - 2] = x[i];
        add_anchors(w, k, parts, n);
        continue;
      }
      *a = (anchor_t){{own[U], own[V], own[THETA]}, sign * f[0][i], sign * f[1][i], y[i]};
    }
    ++*n;
  }
}

/* Where the anchors of a track are at first, counted from 1; it begins at 0. */
static double base_place(const track_t *k, int64_t place) {
  if (k->kind == CIRCLE) return TURN * (double)place / (double)CIRCLE_ANCHORS;
  const int64_t panel = (place - 1) / PANEL_ANCHORS;
  const double *edge = k->panels.edges + panel;
  const double part = (double)(place - PANEL_ANCHORS * panel) / (double)PANEL_ANCHORS;
  return edge[0] + part * (edge[1] - edge[0]);
}

/* Finds the anchors of a track that begins at u v theta. */
static void anchor_track(work_t *w, track_t *k, const double *begin) {
  const int64_t last = k->kind == CIRCLE ? CIRCLE_ANCHORS : PANEL_ANCHORS * k->panels.n;
  int64_t n = 1;
  double x[L], z[2][L], f[2][L];
  for (int j = 0; j < 2; j++) fill_lanes(z[j], begin[j]);
  find_factors(k->body->surface, z, f);
  room_for(w, &w->edges, (size_t)last)[0] = 0.0;
  *(anchor_t *)room_for(w, &w->series, (size_t)last * ANCHOR_SIZE) =
      (anchor_t){{begin[0], begin[1], begin[2]}, f[0][0], f[1][0], product(f[0][0], f[1][0])};
  for (int64_t from = 1; from <= last; from += L - 1) {
    for (int i = 0; i < L; i++) x[i] = base_place(k, from + i < last ? from + i : last);
    add_anchors(w, k, x, &n);
  }
  double *at = keep(w, n, sizeof *at);
  anchor_t *anchors = keep(w, n, sizeof *anchors);
  k->anchor_at = memcpy(at, w->edges.data, (size_t)n * sizeof *at);
  k->anchors = memcpy(anchors, w->series.data, (size_t)n * sizeof *anchors);
  k->n_anchors = n;
  for (int j = 0; j < 3 && k->kind == CIRCLE; j++) /* what whole turns a revolution adds */
    k->turn[j] = TURN * rint((anchors[n - 1].place[j] - anchors[0].place[j]) / TURN);
}

/* Moves points of a path at places x, in principal coordinates, to their branches. */
static void wind_all(const track_t *k, const double *x, const double *turns, lanes_t z, int n) {
  const surface_t *s = k->body->surface;
  int64_t at = 0;
  double f[2][L], own[N_COORDINATES];
  find_factors(s, z, f);
  for (int i = 0; i < n; i++) {
    at = interval(k->anchor_at, k->n_anchors, x[i], at);
    const double *place = k->anchor_at + at;
    const int nearer = at + 1 < k->n_anchors && place[1] - x[i] < x[i] - place[0];
    anchor_t a = k->anchors[at + nearer];
    for (int j = 0; j < 3; j++) a.place[j] += turns[i] * k->turn[j];
    take_lane(z, i, own);
    wind_beside(s, &a, f[0][i], f[1][i], own);
    for (int r = 0; r < N_COORDINATES; r++) z[r][i] = own[r];
  }
}
