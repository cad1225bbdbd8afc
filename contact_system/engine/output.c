/* Evaluates a contact: all results that are asked for, in one pass over the times. */

/* ---- one body at local times ---- */

/* The variable of a track's motion at local times: time, arc length, or phase and revolutions */
static void path_variable(const track_t *k, const double *tau, double *x, double *turns) {
  fill_lanes(turns, 0.0);
  if (k->kind == CIRCLE)
    phases(k, tau, x, turns);
  else if (k->by_length)
    horners(k->drive->length, k->drive->n_sigma + 1, tau, x);
  else
    copy_lanes(x, tau);
}

/* The moving frame, (x, p) or (u, v, theta); or its first rows, three at least */
static void state_at(const track_t *k, const double *tau, const double *x, int rows,
                     lanes_t state) {
  if (k->kind == CIRCLE)
    circle_at(k, x, rows, state);
  else if (k->kind == LINE)
    line_at(k, tau, 0, state);
  else
    panels_at(&k->panels, 0, rows, x, state);
}

/* W_1 or V: from panels, if accelerations change it, else constant */
static void path_velocity(const panels_t *panels, const double *constant, const double *tau,
                          lanes_t out) {
  if (panels)
    panels_at(panels, panels->rows - 2, 2, tau, out);
  else
    for (int a = 0; a < 2; a++) fill_lanes(out[a], constant[a]);
}

/* ---- a block of times of one contact ---- */

/* What is needed of a body; and of the contact: sigma, W_1, W_2 and V; the object's theta if there
   is slip, to turn it into the contact frame; the accelerations that act */
enum {
  NEED_POINT = 1,
  NEED_STATE = 2,
  NEED_COORDINATES = 4,
  NEED_FRAME = 8,
  NEED_SHAPE = 16,
  NEED_VELOCITY = 32,
  OF_BODY = 63,
  NEED_PATHS = 64,
  NEED_TURN = 128,
  NEED_PUSH = 256
};

typedef struct {
  const track_t *track;
  double state[6][L], velocity[2][L], offset[2][L];
  double coordinates[N_COORDINATES][L], frame[9][L], shape[3][L];
} side_t;

/* Up to L times on one segment and on one track of each body, and where their results go:
   out[output][row][n], `count` of them from `first` on */
typedef struct {
  work_t *w;
  const contact_t *contact;
  const segment_t *segment;
  double *const *out;
  int64_t n, first;
  int count;
  double t[L], sigma[L], path[2][2][L], v[2][L]; /* path: W_1 and W_2 */
  side_t side[2];
} sample_t;

/* sigma, W_1, W_2 and V */
static void sample_paths(sample_t *m) {
  const segment_t *s = m->segment;
  const drive_t *d = s->drive;
  double tau[L], decay[L];
  for (int i = 0; i < L; i++) tau[i] = m->t[i] - d->start;
  horners(d->sigma, d->n_sigma, tau, m->sigma);
  path_velocity(s->w1_panels, s->w1, tau, m->path[0]);
  to_object(m->contact->r0, m->path[0], m->path[1]);
  path_velocity(s->v_panels, s->v, tau, m->v);
  if (s->v_panels || !any(s->v)) return;
  decays(d, tau, m->sigma, decay);
  for (int a = 0; a < 2; a++)
    EACH_LANE(i) m->v[a][i] *= decay[i];
}

static void find_coordinates(const sample_t *m, side_t *a, const double *x, const double *turns) {
  const track_t *k = a->track;
  if (k->in_space) {
    copy_rows(a->coordinates, principal(m->w, k->body, a->state, a->velocity), N_COORDINATES);
    wind_all(k, x, turns, a->coordinates, m->count);
  } else {
    unit_t *u = table_at(m->w, k, M_COORDINATES, a->state);
    copy_rows(u->r + 3, a->velocity, 2);
    copy_rows(a->coordinates, run(u), N_COORDINATES);
  }
  for (int j = 0; j < 2 && any(k->offset); j++)
    for (int i = 0; i < L; i++) a->coordinates[DU + j][i] += k->offset[j];
}

/* Samples one body. */
static void sample_body(sample_t *m, int s, int needs) {
  work_t *w = m->w;
  side_t *a = m->side + s;
  const track_t *k = a->track;
  double tau[L], x[L], turns[L], far[6][L];
  if (!(needs || any(k->offset))) return;
  for (int i = 0; i < L; i++) tau[i] = m->t[i] - k->drive->start;
  path_variable(k, tau, x, turns);
  const int rows = needs == NEED_POINT && !any(k->offset) ? 3 : state_size(k->in_space);
  state_at(k, tau, x, rows, a->state);
  if (needs & (NEED_COORDINATES | NEED_VELOCITY))
    for (int j = 0; j < 2; j++)
      for (int i = 0; i < L; i++)
        a->velocity[j][i] = m->sigma[i] * (m->path[s][j][i] - (s ? m->v[j][i] : 0.0));
  if (needs & NEED_COORDINATES) find_coordinates(m, a, x, turns);
  lanes_t state = a->state;
  if (k->kind == LINE && k->long_path && needs & (NEED_POINT | NEED_FRAME)) {
    line_at(k, tau, 1, far);
    state = far;
  }
  if (k->in_space) copy_rows(a->frame, state, needs & NEED_FRAME ? 6 : 3);
  if (needs & NEED_FRAME && k->in_space)
    copy_rows(a->frame + 6, run(table_at(w, k, A_SECOND, state)), 3);
  else if (needs & NEED_FRAME)
    copy_rows(a->frame, run(table_at(w, k, C_FRAME, state)), 9);
  else if (needs & NEED_POINT && !k->in_space)
    copy_rows(a->frame, run(table_at(w, k, C_POINT, state)), 3);
  if (needs & NEED_SHAPE) copy_rows(a->shape, run(table_at(w, k, M_SHAPE, state)), 3);
  if (any(k->offset)) {
    copy_rows(a->offset, to_parallel(w, k, a->state, k->offset), 2);
    for (int j = 0; j < 2 && needs & NEED_VELOCITY; j++)
      for (int i = 0; i < L; i++) a->velocity[j][i] += a->offset[j][i];
  }
}

static int all_zero(const double (*y)[L]) {
  double sum = 0.0;
  for (int a = 0; a < 2; a++)
    for (int i = 0; i < L; i++) sum += y[a][i] != 0.0;
  return sum == 0.0;
}

/* ---- results ---- */

/* Writes some rows of an output. */
static void put(const sample_t *m, int output, int row, const double (*values)[L], int rows) {
  double *out = m->out[output] + row * m->n + m->first;
  for (int r = 0; r < rows; r++, out += m->n)
    if (m->count == L)
      copy_lanes(out, values[r]);
    else
      memcpy(out, values[r], (size_t)m->count * sizeof *out);
}

/* Writes a vector along the object's (p_2, q_2) in E2. */
static void put_turned(const sample_t *m, int output, lanes_t y) {
  if (!all_zero(y)) {
    unit_t *u = pair_table(m->w, T_TURNED, NULL);
    copy_rows(u->r, m->side[1].coordinates + THETA, 1);
    copy_rows(u->r + 1, y, 2);
    y = run(u);
  }
  put(m, output, 0, y, 2);
}

static void put_states(const sample_t *m) {
  double psi[1][L];
  for (int s = 0; s < 2; s++) put(m, STATES, 4 * s, m->side[s].coordinates, 4);
  for (int i = 0; i < L; i++)
    psi[0][i] = m->contact->row[K_ANGLE] -
                (m->side[0].coordinates[THETA][i] + m->side[1].coordinates[THETA][i]);
  put(m, STATES, 8, psi, 1);
}

static void put_points(const sample_t *m) {
  for (int s = 0; s < 2; s++) put(m, POINTS, 3 * s, m->side[s].frame, 3);
}

/* Slip along (p_2, q_2): sigma V less the rate offset */
static void slip_of(const sample_t *m, lanes_t slip) {
  const side_t *o = &m->side[1];
  for (int a = 0; a < 2; a++) {
    EACH_LANE(i) slip[a][i] = m->sigma[i] * m->v[a][i];
    if (any(o->track->offset))
      for (int i = 0; i < L; i++) slip[a][i] -= o->offset[a][i];
  }
}

static void put_slip(const sample_t *m) {
  double slip[2][L];
  slip_of(m, slip);
  put_turned(m, SLIP, slip);
}

static void put_slip_speed(const sample_t *m) {
  double slip[2][L], speed[1][L];
  slip_of(m, slip);
  for (int i = 0; i < L; i++) speed[0][i] = hypot(slip[0][i], slip[1][i]);
  put(m, SLIP_SPEED, 0, speed, 1);
}

static unit_t *pair_of(const sample_t *m, int table) {
  unit_t *u = pair_table(m->w, table, m->contact->r0);
  for (int s = 0; s < 2; s++) copy_rows(u->r + 9 * s, m->side[s].frame, 9);
  return u;
}

static void put_twist(const sample_t *m) {
  unit_t *u = pair_of(m, T_TWIST);
  for (int s = 0; s < 2; s++) {
    copy_rows(u->r + 18 + 3 * s, m->side[s].shape, 3);
    copy_rows(u->r + 24 + 2 * s, m->side[s].velocity, 2);
  }
  slip_of(m, u->r + 28);
  put(m, TWIST, 0, run(u), 6);
}

static void put_pose(const sample_t *m) {
  double last[4][L] = {{0}};
  fill_lanes(last[3], 1.0);
  lanes_t found = run(pair_of(m, T_POSE));
  for (int i = 0; i < 3; i++) {
    put(m, POSE, 4 * i, found + 3 * i, 3);
    put(m, POSE, 4 * i + 3, found + 9 + i, 1);
  }
  put(m, POSE, 12, last, 4);
}

/* (sigma'/sigma - lam) v_rel, and what the accelerations add */
static void put_acceleration(const sample_t *m) {
  const segment_t *s = m->segment;
  const drive_t *d = s->drive;
  const int slips = !all_zero(m->v);
  unit_t *u = pair_table(m->w, T_ACCELERATION, m->contact->r0);
  copy_lanes(u->r[0], m->sigma);
  for (int i = 0; i < L; i++) {
    const double tau = m->t[i] - d->start;
    u->r[1][i] = slips ? slope_of(d->sigma, d->n_sigma, tau) : 0.0;
    u->r[2][i] = slips ? gain_at(d, tau) : 0.0;
  }
  copy_rows(u->r + 3, m->v, 2);
  for (int r = 5; r < 9; r++) fill_lanes(u->r[r], 0.0);
  for (int k = 0; k < 2; k++) {
    const double *push = s->acting + 2 * k;
    const side_t *a = &m->side[k];
    if (any(push)) copy_rows(u->r + 5 + 2 * k, to_parallel(m->w, a->track, a->state, push), 2);
  }
  put_turned(m, ACCELERATION, run(u));
}

static void put_carried(const sample_t *m) {
  double path[2][L];
  for (int a = 0; a < 2; a++)
    for (int i = 0; i < L; i++) path[a][i] = m->path[1][a][i] - m->v[a][i];
  for (int s = 0; s < 2; s++) {
    put(m, CARRIED, 3 * s, m->side[s].coordinates + THETA, 1);
    put(m, CARRIED, 3 * s + 1, s ? path : m->path[0], 2);
  }
}

static void put_frames(const sample_t *m) {
  for (int s = 0; s < 2; s++) {
    put(m, FRAMES, 12 * s, m->side[s].frame, 9);
    put(m, FRAMES, 12 * s + 9, m->side[s].shape, 3);
  }
}

/* Results that need one of IN_FRAMES have components in contact frames; of their rows the first
   `of_finger` are those of the finger. */
enum { IN_FRAMES = NEED_COORDINATES | NEED_TURN };
static const struct {
  int rows, needs, of_finger;
  void (*put)(const sample_t *m);
} RESULTS[N_OUTPUTS] = {
    [STATES] = {9, NEED_COORDINATES | NEED_PATHS, 4, put_states},
    [POINTS] = {6, NEED_POINT, 0, put_points},
    [SLIP] = {2, NEED_PATHS | NEED_TURN, 0, put_slip},
    [SLIP_SPEED] = {1, NEED_PATHS, 0, put_slip_speed},
    [TWIST] = {6, NEED_FRAME | NEED_SHAPE | NEED_VELOCITY | NEED_PATHS, 0, put_twist},
    [POSE] = {16, NEED_FRAME, 0, put_pose},
    [ACCELERATION] = {2, NEED_PATHS | NEED_TURN | NEED_PUSH, 0, put_acceleration},
    [CARRIED] = {6, NEED_COORDINATES | NEED_PATHS, 3, put_carried},
    [FRAMES] = {24, NEED_FRAME | NEED_SHAPE, 0, put_frames},
};

static int needs_of(double *const *out) {
  int needs = 0;
  for (int k = 0; k < N_OUTPUTS; k++) needs |= out[k] ? RESULTS[k].needs : 0;
  return needs;
}

/* ---- a contact ---- */

static void put_block(sample_t *m, int needs) {
  const int pushed = m->segment->v_panels != NULL;
  const int slips = pushed || any(m->segment->v) || any(m->side[1].track->offset);
  int of_body = needs & OF_BODY;
  if (needs & NEED_PATHS) sample_paths(m);
  if (needs & NEED_PUSH && pushed) of_body |= NEED_STATE;
  sample_body(m, 0, of_body);
  if (needs & NEED_TURN && slips) of_body |= NEED_COORDINATES;
  sample_body(m, 1, of_body);
  for (int k = 0; k < N_OUTPUTS; k++)
    if (m->out[k]) RESULTS[k].put(m);
}

/* Results in contact frames are not finite at a pole or an umbilic. The first such time becomes the
   failure; the other contacts are evaluated all the same. */
static void report_singular(work_t *w, const contact_t *c, int64_t n, const double *t,
                            double *const *out) {
  for (int k = 0; k < N_OUTPUTS && !w->failure->code; k++) {
    const int64_t size = out[k] && RESULTS[k].needs & IN_FRAMES ? n * RESULTS[k].rows : 0;
    int64_t i = 0;
    while (i < size && isfinite(out[k][i])) i++;
    if (i == size) continue;
    w->failure->contact = c - w->plan->contacts, w->failure->t = t[i % n];
    w->failure->side = i / n >= RESULTS[k].of_finger, w->failure->code = SINGULAR_TIME;
  }
}

/* A contact, by blocks of times on one segment and one track of each body */
static void evaluate_contact(work_t *w, const contact_t *c, int64_t n, const double *times,
                             double *const *out) {
  const int needs = needs_of(out);
  sample_t m;
  int64_t segment = 0, track[2] = {0, 0};
  m.w = w, m.contact = c, m.out = out, m.n = n;
  for (m.first = 0; m.first < n; m.first += m.count) {
    const double *t = times + m.first;
    segment = interval(c->segment_edges, c->n_segments, t[0], segment);
    m.segment = c->segments + segment;
    double from = c->segment_edges[segment], until = c->segment_edges[segment + 1];
    for (int s = 0; s < 2; s++) {
      const double *edges = c->track_edges[s];
      track[s] = interval(edges, c->n_tracks[s], t[0], track[s]);
      m.side[s].track = c->tracks[s] + track[s];
      /* not fmax(), which gcc calls without vzeroupper: it took a quarter of the time of points */
      if (edges[track[s]] > from) from = edges[track[s]];
      if (edges[track[s] + 1] < until) until = edges[track[s] + 1];
    }
    m.count = 1;
    while (m.count < L && m.first + m.count < n && t[m.count] >= from && t[m.count] < until)
      m.count++;
    gather(m.t, t, m.count);
    put_block(&m, needs);
  }
  report_singular(w, c, n, times, out);
}
