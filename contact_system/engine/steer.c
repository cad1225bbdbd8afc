/* Paths of legs that end at a goal, by the Gauss-Newton method (theory section 11). Each lane is a
   trial.

   All vectors are given in the frame of the path: p the direction of travel, q = n x p. On both
   bodies p is the same direction in space, and q and n are opposite ones. Jacobi fields say how the
   frame at the end moves with each unknown: directions and lengths of the legs. */

enum { MOST_LEGS = 4, UNKNOWNS = 2 * MOST_LEGS };
/* steps of the method; steps after which a path that hardly improves is given up; paths that
   arrive, after which the search ends */
enum { MOST_TRIES = 40, PATIENCE = 6, ENOUGH = 2 };

/* derivatives by each unknown */
typedef double by_unknown_t[UNKNOWNS][L];

/* the path on one body */
typedef struct {
  const steered_t *body;
  lines_t lines;
  unit_t shape;
  double at[SHOWN][L];              /* x p q, and J J' M M' of the last part */
  by_unknown_t ahead, aside, turns; /* how the frame moves along p and q, and turns */
} rolled_t;

typedef struct { /* normal equations: |off|^2, slopes^T off, slopes^T slopes */
  double size[L], gradient[UNKNOWNS][L], square[UNKNOWNS][UNKNOWNS][L];
} equations_t;

typedef struct {
  const steer_t *aim;
  int legs, unknowns;
  rolled_t rolled[2];
  double tried[UNKNOWNS][L];
  int active[L];
  equations_t now, best;
} search_t;

static void add_row(equations_t *e, int n, double (*slope)[L], const double *off) {
  for (int i = 0; i < n; i++) {
    EACH_LANE(l) e->gradient[i][l] += slope[i][l] * off[l];
    for (int j = 0; j <= i; j++)
      EACH_LANE(l) e->square[i][j][l] += slope[i][l] * slope[j][l];
  }
}

/* ---- a path ---- */

static void turn_rows(double (*x)[L], double (*y)[L], int n, const double *c, const double *s) {
  for (int i = 0; i < n; i++)
    EACH_LANE(l) {
      const double ahead = c[l] * x[i][l] + s[l] * y[i][l];
      y[i][l] = c[l] * y[i][l] - s[l] * x[i][l], x[i][l] = ahead;
    }
}

/* Turns the path's direction, and with it the frame. */
static void turn_path(rolled_t *r, int n, const double *turn) {
  double s[L], c[L];
  sincos_of(turn, s, c, L);
  turn_rows(r->at + 3, r->at + 6, 3, c, s);
  turn_rows(r->ahead, r->aside, n, c, s);
  if (r->lines.in_space)
    memcpy(r->lines.y + 3, r->at + 3, 3 * sizeof *r->at);
  else
    for (int l = 0; l < L; l++) r->lines.y[2][l] += turn[l];
}

/* Moves the frame along p, by a part of a leg. */
static void advance(rolled_t *r, const double *length) {
  const steered_t *body = r->body;
  if (body->geodesic) {
    lines_t *g = &r->lines;
    memcpy(g->length, length, sizeof g->length);
    for (int f = 0; f < FIELDS; f++) fill_lanes(g->y[g->state + f], f == 1 || f == 2);
    follow(g, 0, 0, L, NULL);
    memcpy(r->at, g->shown, sizeof r->at);
    return;
  }
  const double root = fabs(body->normal_curvature), k = root * root; /* k: Gaussian curvature */
  double half[L], s[L], c[L];
  EACH_LANE(l) half[l] = 0.5 * root * length[l];
  sincos_of(half, s, c, L);
  double (*f)[L] = r->at + 9;
  EACH_LANE(l) {
    const double rise = k > 0 ? s[l] / root : 0.5 * length[l], drop = 2.0 * rise * rise;
    const double j = k > 0 ? 2.0 * rise * c[l] : length[l];
    for (int i = 0; i < 3; i++) {
      const double x = r->at[i][l], p = r->at[3 + i][l];
      r->at[i][l] = x + j * p - k * drop * x;
      r->at[3 + i][l] = p - k * (drop * p + j * x);
    }
    f[0][l] = j, f[1][l] = f[2][l] = 1.0 - k * drop, f[3][l] = -k * j;
  }
}

/* Jacobi fields carry the frame's earlier moves along a part of a leg. */
static void carry(rolled_t *r, int n) {
  double (*f)[L] = r->at + 9;
  for (int i = 0; i < n; i++)
    EACH_LANE(l) {
      const double aside = r->aside[i][l], turn = r->turns[i][l];
      r->aside[i][l] = f[2][l] * aside + f[0][l] * turn;
      r->turns[i][l] = f[3][l] * aside + f[1][l] * turn;
    }
}

static void stay_within(const rolled_t *r, equations_t *e, int n) {
  const double *centre = r->body->within, radius = r->body->within[3];
  double off[L], ahead[L], aside[L];
  by_unknown_t slope;
  EACH_LANE(l) {
    double away = 0.0, along = 0.0, across = 0.0;
    for (int i = 0; i < 3; i++) {
      const double d = r->at[i][l] - centre[i];
      away += d * d, along += d * r->at[3 + i][l], across += d * r->at[6 + i][l];
    }
    away = sqrt(away);
    const double part = away > radius ? 1.0 / (away * radius) : 0.0;
    off[l] = away > radius ? away / radius - 1.0 : 0.0;
    ahead[l] = part * along, aside[l] = part * across, e->size[l] += off[l] * off[l];
  }
  for (int i = 0; i < n; i++)
    EACH_LANE(l) slope[i][l] = ahead[l] * r->ahead[i][l] + aside[l] * r->aside[i][l];
  add_row(e, n, slope, off);
}

static void start_path(rolled_t *r) {
  lines_t *g = &r->lines;
  for (int i = 0; i < 9; i++) fill_lanes(r->at[i], r->body->start[i]);
  memset(g->lost, 0, sizeof g->lost);
  memset(r->ahead, 0, sizeof r->ahead), memset(r->aside, 0, sizeof r->aside);
  memset(r->turns, 0, sizeof r->turns);
  if (g->in_space)
    memcpy(g->y, r->at, 6 * sizeof *r->at);
  else
    for (int i = 0; i < 3; i++) fill_lanes(g->y[i], r->body->place[i]);
}

static void roll(search_t *w, int side) {
  const steer_t *aim = w->aim;
  rolled_t *r = w->rolled + side;
  const double sign = side ? -1.0 : 1.0, part = aim->w_length / (double)aim->parts;
  const int n = w->legs, all = w->unknowns;
  double turn[L], length[L];
  start_path(r);
  for (int k = 0; k < n; k++) {
    for (int l = 0; l < L; l++) {
      const double first = sign * aim->w_angle - (double)side * aim->psi;
      turn[l] = k ? sign * (w->tried[k][l] - w->tried[k - 1][l]) : first + sign * w->tried[0][l];
      length[l] = w->active[l] ? part * w->tried[n + k][l] : 0.0;
    }
    turn_path(r, all, turn);
    fill_lanes(r->turns[k], sign);
    for (int64_t p = 0; p < aim->parts; p++) {
      advance(r, length), carry(r, all);
      for (int l = 0; l < L; l++) r->ahead[n + k][l] += part * aim->unit;
      if (r->body->within[3] > 0) stay_within(r, &w->now, all);
    }
    if (k + 1 < n) /* the next corner turns back, as the next leg keeps its direction */
      for (int l = 0; l < L; l++) r->turns[k][l] -= sign;
  }
}

/* ---- how far it ends from the goal ---- */

static void arrive_at_place(search_t *w, int side) {
  const rolled_t *r = w->rolled + side;
  const steered_t *body = r->body;
  const double unit = 1.0 / w->aim->size;
  by_unknown_t slope;
  double off[3][L];
  EACH_LANE(l) {
    double d[3], n2 = 0.0, y[2] = {0.0, 0.0};
    for (int i = 0; i < 3; i++) {
      d[i] = unit * (r->at[i][l] - body->goal[i]), n2 += d[i] * d[i];
      y[0] += d[i] * r->at[3 + i][l], y[1] += d[i] * r->at[6 + i][l];
    }
    off[0][l] = y[0], off[1][l] = y[1], w->now.size[l] += n2;
  }
  for (int row = 0; row < 2; row++) {
    const double (*moves)[L] = row ? r->aside : r->ahead;
    for (int i = 0; i < w->unknowns; i++)
      EACH_LANE(l) slope[i][l] = unit * moves[i][l];
    add_row(&w->now, w->unknowns, slope, off[row]);
  }
}

/* How the normal tilts along p and q with each unknown */
static void tilt(rolled_t *r, int n, double (*ahead)[L], double (*aside)[L]) {
  double flat[3][L];
  double (*form)[L] = flat;
  if (r->body->geodesic) {
    memcpy(r->shape.r, r->lines.y, (size_t)r->lines.state * sizeof *r->lines.y);
    form = run(&r->shape);
  } else
    for (int i = 0; i < 3; i++) fill_lanes(flat[i], i == 1 ? 0.0 : r->body->normal_curvature);
  for (int i = 0; i < n; i++)
    EACH_LANE(l) {
      ahead[i][l] = form[0][l] * r->ahead[i][l] + form[1][l] * r->aside[i][l];
      aside[i][l] = form[1][l] * r->ahead[i][l] + form[2][l] * r->aside[i][l];
    }
}

/* The rows of F = [p q n] */
static void frame_of(const rolled_t *r, double (*f)[3][L]) {
  copy_rows(f[0], r->at + 3, 3), copy_rows(f[1], r->at + 6, 3);
  for (int i = 0; i < 3; i++) {
    const double *p1 = f[0][(i + 1) % 3], *p2 = f[0][(i + 2) % 3];
    const double *q1 = f[1][(i + 1) % 3], *q2 = f[1][(i + 2) % 3];
    EACH_LANE(l) f[2][i][l] = p1[l] * q2[l] - p2[l] * q1[l];
  }
}

/* a . turn b */
static void turned_product(double (*a)[L], const double *turn, double (*b)[L], double *out) {
  fill_lanes(out, 0.0);
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++)
      EACH_LANE(l) out[l] += a[i][l] * turn[3 * i + j] * b[j][l];
}

/* Errors of the pose at the end, in rotation and origin, in the frames F there: the
   finger's rotation is F_2 diag(1, -1, -1) F_1^T. from: the finger's point from its origin. */
static void pose_off(search_t *w, double unit, double (*off)[L], double (*from)[L]) {
  static const double same[3] = {1.0, -1.0, -1.0};
  const steer_t *aim = w->aim;
  double f[2][3][3][L], c[3][3][L], size[L];
  for (int s = 0; s < 2; s++) frame_of(w->rolled + s, f[s]);
  fill_lanes(size, 0.0);
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++) {
      const double goal = i == j ? same[i] : 0.0;
      turned_product(f[1][i], aim->rotation, f[0][j], c[i][j]);
      EACH_LANE(l) c[i][j][l] = goal - c[i][j][l], size[l] += c[i][j][l] * c[i][j][l];
    }
  EACH_LANE(l) {
    off[0][l] = c[0][1][l] + c[1][0][l];
    off[1][l] = -c[0][2][l] - c[2][0][l];
    off[2][l] = c[2][1][l] - c[1][2][l];
  }
  for (int i = 0; i < 3; i++) {
    double x[L] = {0}, y[L] = {0};
    for (int j = 0; j < 3; j++)
      EACH_LANE(l) {
        x[l] += f[0][i][j][l] * w->rolled[0].at[j][l];
        y[l] += f[1][i][j][l] * (w->rolled[1].at[j][l] - aim->origin[j]);
      }
    EACH_LANE(l) {
      from[i][l] = unit * x[l], off[3 + i][l] = unit * (y[l] - same[i] * x[l]);
      size[l] += off[3 + i][l] * off[3 + i][l];
    }
  }
  EACH_LANE(l) w->now.size[l] += size[l];
}

/* Rows for the rotation of the finger and, of a pose, for its origin. */
static void arrive_in_pose(search_t *w) {
  const rolled_t *finger = w->rolled, *object = w->rolled + 1;
  const int n = w->unknowns, is_pose = w->aim->is_pose != 0;
  const double unit = is_pose ? 1.0 / w->aim->size : 0.0;
  equations_t *e = &w->now;
  by_unknown_t ahead[2], aside[2];
  double off[6][L], from[3][L];
  for (int s = 0; s < 2; s++) tilt(w->rolled + s, n, ahead[s], aside[s]);
  pose_off(w, unit, off, from);
  by_unknown_t spin[3]; /* how the finger turns about the frame's axes with each unknown */
  for (int i = 0; i < n; i++)
    EACH_LANE(l) {
      spin[0][i][l] = finger->turns[i][l] + object->turns[i][l];
      spin[1][i][l] = ahead[0][i][l] + ahead[1][i][l];
      spin[2][i][l] = aside[1][i][l] - aside[0][i][l];
    }
  const double none[L] = {0};
  /* A turn about an axis changes two of the nine entries, by as much: two equations with the same
     slopes. `off` is the sum of their errors, so the second one has none. */
  for (int row = 0; row < 3; row++)
    add_row(e, n, spin[row], off[row]), add_row(e, n, spin[row], none);
  if (!is_pose) return;
  by_unknown_t moves[3];
  for (int i = 0; i < n; i++)
    EACH_LANE(l) {
      const double mu = spin[0][i][l], e0 = spin[1][i][l], e1 = spin[2][i][l];
      const double x = from[0][l], y = from[1][l], z = from[2][l];
      moves[0][i][l] = unit * (object->ahead[i][l] - finger->ahead[i][l]) - (mu * y - e0 * z);
      moves[1][i][l] = unit * (object->aside[i][l] + finger->aside[i][l]) - (mu * x - e1 * z);
      moves[2][i][l] = e0 * x - e1 * y;
    }
  for (int row = 0; row < 3; row++) add_row(e, n, moves[row], off[3 + row]);
}

static void keep_short(search_t *w) {
  const double longest = w->aim->longest, slope = w->aim->unit / longest;
  for (int i = w->legs; i < w->unknowns && longest > 0; i++)
    for (int l = 0; l < L; l++) {
      const double s = w->tried[i][l], over = fabs(s) / longest - 1.0;
      if (over <= 0) continue;
      w->now.size[l] += over * over, w->now.square[i][i][l] += slope * slope;
      w->now.gradient[i][l] += copysign(slope, s) * over;
    }
}

static void try_paths(search_t *w) {
  memset(&w->now, 0, sizeof w->now);
  for (int side = 0; side < 2; side++) roll(w, side);
  for (int side = 0; side < 2; side++)
    if (w->aim->body[side].wanted) arrive_at_place(w, side);
  if (w->aim->has_rotation) arrive_in_pose(w);
  keep_short(w);
  for (int l = 0; l < L; l++)
    if (w->rolled[0].lines.lost[l] || w->rolled[1].lines.lost[l]) w->now.size[l] = HUGE_VAL;
}

/* ---- the Gauss-Newton method, with Levenberg's damping ---- */

/* Of a last step: enough that unknowns on which no equation depends stay as they are */
static const double NO_DAMPING = 1e-12;

/* The step of a lane, x = (square + damping)^-1 gradient, by Cholesky's method */
static void solve(const equations_t *e, int n, int l, double damping, double *x) {
  double a[UNKNOWNS][UNKNOWNS];
  for (int i = 0; i < n; i++) {
    x[i] = e->gradient[i][l];
    for (int j = 0; j <= i; j++) {
      double sum = e->square[i][j][l] + (i == j ? damping : 0.0);
      for (int k = 0; k < j; k++) sum -= a[i][k] * a[j][k];
      a[i][j] = i == j ? sqrt(sum > damping ? sum : damping) : sum / a[j][j];
    }
    for (int k = 0; k < i; k++) x[i] -= a[i][k] * x[k];
    x[i] /= a[i][i];
  }
  for (int i = n - 1; i >= 0; i--) {
    for (int k = i + 1; k < n; k++) x[i] -= a[k][i] * x[k];
    x[i] /= a[i][i];
  }
}

static void copy_lane(equations_t *to, const equations_t *from, int n, int l) {
  to->size[l] = from->size[l];
  for (int i = 0; i < n; i++) {
    to->gradient[i][l] = from->gradient[i][l];
    for (int j = 0; j <= i; j++) to->square[i][j][l] = from->square[i][j][l];
  }
}

static void search(search_t *w, int64_t count, double (*z)[L]) {
  const steer_t *aim = w->aim;
  const int n = w->unknowns;
  double damping[L], mark[L];
  int64_t going = count, arrived = 0;
  for (int l = 0; l < L; l++) {
    w->active[l] = l < count, w->best.size[l] = mark[l] = HUGE_VAL, damping[l] = 1e-2;
    for (int i = 0; i < n; i++) w->tried[i][l] = z[i][l < count ? l : 0];
  }
  for (int64_t step = 0; step < MOST_TRIES && going > 0 && arrived < ENOUGH; step++) {
    try_paths(w);
    for (int l = 0; l < count; l++) {
      if (!w->active[l]) continue;
      const double before = w->best.size[l];
      if (w->now.size[l] < before) {
        copy_lane(&w->best, &w->now, n, l);
        damping[l] = fmax(0.3 * damping[l], 1e-11);
        for (int i = 0; i < n; i++) z[i][l] = w->tried[i][l];
      } else
        damping[l] *= 10.0;
      const double off = w->best.size[l];
      const int met = off < aim->reached * aim->reached;
      int stop = met || off == HUGE_VAL;
      if (step % PATIENCE == PATIENCE - 1) { /* hardly better than PATIENCE steps ago */
        stop |= off > 0.25 * mark[l] * mark[l];
        mark[l] = sqrt(off);
      }
      arrived += met, w->active[l] = !stop, going -= stop;
      if (stop && !met) continue;
      double x[UNKNOWNS], most = 1.0;
      solve(&w->best, n, l, met ? NO_DAMPING : damping[l], x);
      for (int i = 0; i < n; i++) most = fmax(most, fabs(x[i]));
      for (int i = 0; i < n; i++) {
        w->tried[i][l] = z[i][l] - (i < w->legs ? 1.0 : aim->unit) * x[i] / most;
        if (met && most <= 1.0) z[i][l] = w->tried[i][l];
      }
    }
  }
}

/* Improves directions and lengths z[2 n][L] of `count` trials until some meet the goal; these take
   a last step, unless it is a long one. Before that step, off[L] is how far from the goal paths
   end, and squares[2 n][2 n][L] are slopes^T slopes of the equations. */
static int steer(steer_t *aim, int64_t legs, int64_t count, double (*z)[L], double *off,
                 double *squares) {
  const int n = 2 * (int)legs;
  search_t *w = calloc(1, sizeof *w);
  if (!w) return NO_MEMORY;
  w->aim = aim, w->legs = (int)legs, w->unknowns = n;
  int ready = 1;
  for (int side = 0; side < 2; side++) {
    rolled_t *r = w->rolled + side;
    const geodesic_t *geodesic = aim->body[side].geodesic;
    r->body = aim->body + side, r->lines.tolerance = aim->tolerance;
    if (!geodesic) continue;
    const surface_t *s = geodesic->surface;
    const table_t *shape = s->tables[moves_in_space(s)][M_SHAPE];
    ready = ready && load_lines(&r->lines, geodesic) && load(&r->shape, shape, geodesic->numbers);
  }
  if (ready) search(w, count, z);
  for (int l = 0; l < count; l++) off[l] = sqrt(w->best.size[l]);
  for (int i = 0; i < n; i++)
    for (int j = 0; j <= i; j++) {
      copy_lanes(squares + (i * n + j) * L, w->best.square[i][j]);
      copy_lanes(squares + (j * n + i) * L, w->best.square[i][j]);
    }
  for (int side = 0; side < 2; side++) {
    aim->steps += w->rolled[side].lines.tries;
    drop_lines(&w->rolled[side].lines), free(w->rolled[side].shape.r);
  }
  free(w);
  return ready ? NO_FAILURE : NO_MEMORY;
}
