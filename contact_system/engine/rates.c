/* What moves a body: its rates X' = f(X, sigma, decay), on local time or arc length. */

/* ---- tables of bodies and contacts ---- */

static unit_t *table_of(work_t *w, const body_t *b, int in_space, int table) {
  unit_t *u = &w->body[b->side][in_space][table];
  if (!load(u, b->surface->tables[in_space][table], b->numbers)) fail(w, NO_MEMORY);
  return u;
}

static unit_t *pair_table(work_t *w, int table, const double *constants) {
  unit_t *u = &w->pair[table];
  if (!load(u, contact_tables + table, constants)) fail(w, NO_MEMORY);
  return u;
}

/* A table at one point */
static void run_one(work_t *w, const table_t *t, const double *constants, const double *in,
                    double *out) {
  double *r = room_for(w, &w->one, (size_t)t->n_regs);
  memcpy(r, in, (size_t)t->n_in * sizeof *r);
  if (t->n_const) memcpy(r + t->n_in, constants, (size_t)t->n_const * sizeof *r);
  load_registers(t, r);
  step(&(program_t){t->body, r});
  memcpy(out, r + t->first_out, (size_t)t->n_out * sizeof *out);
}

/* A table of a body at one point */
static void run_body(work_t *w, const body_t *b, int in_space, int table, const double *in,
                     double *out) {
  run_one(w, b->surface->tables[in_space][table], b->numbers, in, out);
}

static int moves_in_space(const surface_t *s) { return s->tables[IN_SPACE][M_MOTION] != NULL; }
static int state_size(int in_space) { return in_space ? 6 : 3; }

/* A table of a track's body, with states in its registers */
static unit_t *table_at(work_t *w, const track_t *k, int table, const double (*state)[L]) {
  unit_t *u = table_of(w, k->body, k->in_space, table);
  copy_rows(u->r, state, state_size(k->in_space));
  return u;
}

/* Chart components d to the parallel frame, Rot(theta)^T M d */
static lanes_t to_parallel(work_t *w, const track_t *k, const double (*state)[L], const double *d) {
  unit_t *u = table_at(w, k, M_VECTOR, state);
  const int n = state_size(k->in_space);
  fill_lanes(u->r[n], d[0]), fill_lanes(u->r[n + 1], d[1]);
  return run(u);
}

/* ---- rates ---- */

/* What is integrated: the state of a track's body, then under accelerations W_1 (of the finger) or
   V (of the object); or int sigma decay, if the track has no body. */
typedef struct {
  track_t *track;
  int64_t n;
  double length, panel_limit;
  double first; /* length of a first panel at a tolerance of 1e-12; may be infinite */
  double tolerance, slip, finish; /* slip: |V| at the start; it ends where slip decay <= finish */
  double state[MAX_STATES], scale[MAX_STATES]; /* errors are measured in 1/scale */
  /* what `rates` reads */
  const double *r0;
  int pushed;
  const track_t *finger; /* of an object whose finger is accelerated; else NULL */
  double v[2];
} motion_t;

/* what does not depend on the state, at the nodes of a panel */
typedef struct {
  double sigma[L], decay[L], lam[L], inverse[L][L];
  double w2[2][L], pushed_1[2][L]; /* W_2; the finger's acceleration, in its parallel frame */
  double allowed;                  /* the greatest error at which the panel is accepted */
} nodes_t;

/* whether the last two states are V, with the stiff term -lam V */
static int has_v(const motion_t *m) { return m->pushed && m->track->body->side; }

static const double UNDISTURBED[2] = {0.0, 0.0};

static int any(const double *d) { return d[0] != 0.0 || d[1] != 0.0; }

/* W_2 = R_0 W_1 */
static void to_object(const double *r0, lanes_t w1, lanes_t w2) {
  for (int a = 0; a < 2; a++) {
    const double x = r0[2 * a], y = r0[2 * a + 1];
    EACH_LANE(i) w2[a][i] = x * w1[0][i] + y * w1[1][i];
  }
}

/* W_2 of an object under accelerations, and the finger's acceleration, at times t */
static void follow_finger(work_t *w, const motion_t *m, const double *t, nodes_t *at) {
  const track_t *k = m->finger;
  double x[MAX_STATES][L];
  for (int a = 0; a < 2; a++)
    fill_lanes(at->pushed_1[a], 0.0), fill_lanes(at->w2[a], m->track->w[a]);
  if (!k) return;
  panels_at(&k->panels, 0, k->panels.rows, t, x);
  to_object(m->r0, x + state_size(k->in_space), at->w2);
  copy_rows(at->pushed_1, to_parallel(w, k, x, k->push), 2);
}

/* What is known at times t: all but `inverse` and `allowed` */
static void fill_nodes(work_t *w, const motion_t *m, const double *t, nodes_t *at) {
  const track_t *k = m->track;
  if (k->by_length)
    fill_lanes(at->sigma, 1.0);
  else
    horners(k->drive->sigma, k->drive->n_sigma, t, at->sigma);
  if (m->slip > 0)
    decays(k->drive, t, at->sigma, at->decay);
  else
    fill_lanes(at->decay, 0.0);
  if (!has_v(m)) return;
  follow_finger(w, m, t, at);
  for (int i = 0; i < L; i++) at->lam[i] = gain_at(k->drive, t[i]);
}

static unit_t *motion_table(work_t *w, const motion_t *m) {
  return table_of(w, m->track->body, m->track->in_space, M_MOTION);
}

/* c = sigma (W - V), and what a rate offset adds, moves the body; accelerations change W_1 and V.
   V' lacks -lam V, see `sweep`. Returns the rows of the result, the table's own or f. Where no
   acceleration acts, x has to be the table's input registers. */
static lanes_t rates(work_t *w, const motion_t *m, const nodes_t *at, lanes_t x, lanes_t f) {
  const track_t *k = m->track;
  const double *sigma = at->sigma;
  if (!k->body) {
    EACH_LANE(i) f[0][i] = sigma[i] * at->decay[i];
    return f;
  }
  const int n = state_size(k->in_space);
  unit_t *u = motion_table(w, m);
  lanes_t path = x + n, c = u->r + n; /* W_1 of a finger or V of an object under accelerations */
  for (int a = 0; a < 2; a++) {
    if (!m->pushed)
      EACH_LANE(i) c[a][i] = sigma[i] * (k->w[a] - m->v[a] * at->decay[i]);
    else if (has_v(m))
      EACH_LANE(i) c[a][i] = sigma[i] * (at->w2[a][i] - path[a][i]);
    else
      EACH_LANE(i) c[a][i] = sigma[i] * path[a][i];
  }
  if (any(k->offset)) {
    lanes_t d = to_parallel(w, k, x, k->offset);
    for (int a = 0; a < 2; a++)
      EACH_LANE(i) c[a][i] += d[a][i];
  }
  if (!m->pushed) return run(u);
  copy_rows(u->r, x, n);
  copy_rows(f, run(u), n);
  u = pair_table(w, T_PUSHED, m->r0);
  lanes_t in = u->r + 1; /* accelerations of finger and object */
  copy_rows(u->r, &at->sigma, 1);
  for (int r = 0; r < 4; r++) fill_lanes(in[r], 0.0);
  if (k->body->side) copy_rows(in, at->pushed_1, 2);
  if (any(k->push)) copy_rows(in + 2 * k->body->side, to_parallel(w, k, x, k->push), 2);
  copy_rows(f + n, run(u) + 2 * k->body->side, 2);
  return f;
}

/* 1/(unit of each state): the body's size for positions, 1 for angles and directions, and for
   coordinates the size over their Lame coefficients. One that vanishes, at a pole, counts as a
   hundredth of the size or, on users' charts, whose units may be any, of the other coefficient. */
static void scales(work_t *w, int in_space, const body_t *b, const double *state, double *scale) {
  if (in_space) {
    for (int j = 0; j < 6; j++) scale[j] = j < 3 ? 1.0 / b->size : 1.0;
    return;
  }
  double lame[3];
  run_body(w, b, IN_CHART, C_LAME, state, lame);
  const double beside = b->surface->may_be_singular ? fmax(lame[0], lame[1]) : b->size;
  for (int j = 0; j < 2; j++) scale[j] = fmax(lame[j], 1e-2 * fmin(beside, b->size)) / b->size;
  scale[2] = 1.0;
}
