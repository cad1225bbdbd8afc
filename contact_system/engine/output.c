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

/* What is needed of a body */
enum {
  NEED_POINT = 1,
  NEED_STATE = 2,
  NEED_COORDINATES = 4,
  NEED_FRAME = 8,
  NEED_SHAPE = 16,
  NEED_VELOCITY = 32
};

typedef struct {
  const track_t *track;
  double state[6][L], velocity[2][L], offset[2][L];
  double coordinates[N_COORDINATES][L], frame[9][L], shape[3][L];
} side_t;

typedef struct {
  const segment_t *segment;
  double t[L], sigma[L], w[2][2][L], v[2][L], slip[2][L]; /* w: W_1 and W_2 */
  side_t side[2];
} sample_t;

/* sigma, W_1, W_2 and V */
static void sample_paths(const contact_t *c, sample_t *m) {
  const segment_t *s = m->segment;
  const drive_t *d = s->drive;
  double tau[L], decay[L];
  for (int i = 0; i < L; i++) tau[i] = m->t[i] - d->start;
  horners(d->sigma, d->n_sigma, tau, m->sigma);
  path_velocity(s->w1_panels, s->w1, tau, m->w[0]);
  to_object(c->r0, m->w[0], m->w[1]);
  path_velocity(s->v_panels, s->v, tau, m->v);
  if (s->v_panels || !any(s->v)) return;
  decays(d, tau, m->sigma, decay);
  for (int a = 0; a < 2; a++)
    EACH_LANE(i) m->v[a][i] *= decay[i];
}

static void find_coordinates(work_t *w, side_t *a, const double *x, const double *turns, int n) {
  const track_t *k = a->track;
  if (k->in_space) {
    copy_rows(a->coordinates, principal(w, k->body, a->state, a->velocity), N_COORDINATES);
    wind_all(k, x, turns, a->coordinates, n);
  } else {
    unit_t *u = table_at(w, k, M_COORDINATES, a->state);
    copy_rows(u->r + 3, a->velocity, 2);
    copy_rows(a->coordinates, run(u), N_COORDINATES);
  }
  for (int j = 0; j < 2 && any(k->offset); j++)
    for (int i = 0; i < L; i++) a->coordinates[DU + j][i] += k->offset[j];
}

/* Samples one body; of L times only the first n are asked for. */
static void sample_body(work_t *w, sample_t *m, int s, int n, int needs) {
  side_t *a = &m->side[s];
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
        a->velocity[j][i] = m->sigma[i] * (m->w[s][j][i] - (s ? m->v[j][i] : 0.0));
  if (needs & NEED_COORDINATES) find_coordinates(w, a, x, turns, n);
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

/* Slip along (p_2, q_2): sigma V less the rate offset */
static void sample_slip(sample_t *m) {
  const side_t *o = &m->side[1];
  for (int a = 0; a < 2; a++) {
    EACH_LANE(i) m->slip[a][i] = m->sigma[i] * m->v[a][i];
    if (any(o->track->offset))
      for (int i = 0; i < L; i++) m->slip[a][i] -= o->offset[a][i];
  }
}

static int all_zero(lanes_t y) {
  double sum = 0.0;
  for (int a = 0; a < 2; a++)
    for (int i = 0; i < L; i++) sum += y[a][i] != 0.0;
  return sum == 0.0;
}

/* From the object's parallel frame to E2 */
static void turn_to_contact_frame(work_t *w, const sample_t *m, lanes_t y) {
  if (all_zero(y)) return;
  unit_t *u = pair_table(w, T_TURNED, NULL);
  copy_rows(u->r, m->side[1].coordinates + THETA, 1);
  copy_rows(u->r + 1, y, 2);
  copy_rows(y, run(u), 2);
}

/* (sigma'/sigma - lam) v_rel, and what the accelerations add, along (p_2, q_2) */
static void slip_acceleration(work_t *w, const contact_t *c, sample_t *m, lanes_t out) {
  const segment_t *s = m->segment;
  const int slips = !all_zero(m->v);
  unit_t *u = pair_table(w, T_ACCELERATION, c->r0);
  copy_lanes(u->r[0], m->sigma);
  for (int i = 0; i < L; i++) {
    const double tau = m->t[i] - s->drive->start;
    u->r[1][i] = slips ? slope_of(s->drive->sigma, s->drive->n_sigma, tau) : 0.0;
    u->r[2][i] = slips ? gain_at(s->drive, tau) : 0.0;
  }
  copy_rows(u->r + 3, m->v, 2);
  for (int r = 5; r < 9; r++) fill_lanes(u->r[r], 0.0);
  for (int k = 0; k < 2; k++) {
    const double *d = s->acting + 2 * k;
    const side_t *a = &m->side[k];
    if (!any(d)) continue;
    lanes_t found = to_parallel(w, a->track, a->state, d);
    copy_rows(u->r + 5 + 2 * k, found, 2);
  }
  copy_rows(out, run(u), 2);
}

static void fill_pair(unit_t *u, const sample_t *m) {
  for (int s = 0; s < 2; s++) copy_rows(u->r + 9 * s, m->side[s].frame, 9);
}

/* ---- writing ---- */

static const int OUTPUT_ROWS[N_OUTPUTS] = {[STATES] = 9,       [POINTS] = 6,  [SLIP] = 2,
                                           [SLIP_SPEED] = 1,   [TWIST] = 6,   [POSE] = 16,
                                           [ACCELERATION] = 2, [CARRIED] = 6, [FRAMES] = 24};

/* where the results of a block go: out[row][n_times], `count` of them from `first` on */
typedef struct {
  double *const *out;
  int64_t n, first;
  int count;
} target_t;

/* Writes some rows of an output. */
static void put(const target_t *to, int output, int row, const double (*values)[L], int rows) {
  double *out = to->out[output] + row * to->n + to->first;
  for (int r = 0; r < rows; r++, out += to->n)
    if (to->count == L)
      copy_lanes(out, values[r]);
    else
      memcpy(out, values[r], (size_t)to->count * sizeof *out);
}

static void put_states(const target_t *to, const contact_t *c, const sample_t *m) {
  double psi[1][L];
  for (int s = 0; s < 2; s++) put(to, STATES, 4 * s, m->side[s].coordinates, 4);
  for (int i = 0; i < L; i++)
    psi[0][i] =
        c->row[K_ANGLE] - (m->side[0].coordinates[THETA][i] + m->side[1].coordinates[THETA][i]);
  put(to, STATES, 8, psi, 1);
}

static void put_carried(const target_t *to, const sample_t *m) {
  double path[2][L];
  for (int a = 0; a < 2; a++)
    for (int i = 0; i < L; i++) path[a][i] = m->w[1][a][i] - m->v[a][i];
  for (int s = 0; s < 2; s++) {
    put(to, CARRIED, 3 * s, m->side[s].coordinates + THETA, 1);
    put(to, CARRIED, 3 * s + 1, s ? path : m->w[0], 2);
  }
}

static void put_frames(const target_t *to, const sample_t *m) {
  for (int s = 0; s < 2; s++) {
    put(to, FRAMES, 12 * s, m->side[s].frame, 9);
    put(to, FRAMES, 12 * s + 9, m->side[s].shape, 3);
  }
}

static void put_pose(work_t *w, const target_t *to, const contact_t *c, const sample_t *m) {
  double last[4][L] = {{0}};
  fill_lanes(last[3], 1.0);
  unit_t *u = pair_table(w, T_POSE, c->r0);
  fill_pair(u, m);
  lanes_t found = run(u);
  for (int i = 0; i < 3; i++) {
    put(to, POSE, 4 * i, found + 3 * i, 3);
    put(to, POSE, 4 * i + 3, found + 9 + i, 1);
  }
  put(to, POSE, 12, last, 4);
}

static void put_twist(work_t *w, const target_t *to, const contact_t *c, const sample_t *m) {
  unit_t *u = pair_table(w, T_TWIST, c->r0);
  fill_pair(u, m);
  for (int s = 0; s < 2; s++) {
    copy_rows(u->r + 18 + 3 * s, m->side[s].shape, 3);
    copy_rows(u->r + 24 + 2 * s, m->side[s].velocity, 2);
  }
  copy_rows(u->r + 28, m->slip, 2);
  put(to, TWIST, 0, run(u), 6);
}

/* Speed of slip, and slip and acceleration in the contact frame */
static void put_slip(work_t *w, const target_t *to, const contact_t *c, sample_t *m) {
  if (to->out[SLIP_SPEED]) {
    double speed[1][L];
    for (int i = 0; i < L; i++) speed[0][i] = hypot(m->slip[0][i], m->slip[1][i]);
    put(to, SLIP_SPEED, 0, speed, 1);
  }
  if (to->out[ACCELERATION]) {
    double a[2][L];
    slip_acceleration(w, c, m, a);
    turn_to_contact_frame(w, m, a);
    put(to, ACCELERATION, 0, a, 2);
  }
  if (to->out[SLIP]) {
    turn_to_contact_frame(w, m, m->slip);
    put(to, SLIP, 0, m->slip, 2);
  }
}

/* A block of times on one track of each body and one interval of slip */
static void put_block(work_t *w, const contact_t *c, sample_t *m, const target_t *to, int needs) {
  double *const *out = to->out;
  const int turned = out[SLIP] || out[ACCELERATION];
  const int pushed = m->segment->v_panels != NULL;
  const int accelerated = out[ACCELERATION] && pushed;
  const int slip = turned || out[SLIP_SPEED] || out[TWIST] || out[CARRIED];
  if (slip || out[STATES]) sample_paths(c, m);
  for (int s = 0; s < 2; s++) {
    /* where there is slip, turning it into the contact frame takes the object's theta */
    const int slides = pushed || any(m->segment->v) || any(m->side[1].track->offset);
    int more = accelerated ? NEED_STATE : 0;
    if (s && turned && slides) more |= NEED_COORDINATES;
    sample_body(w, m, s, to->count, needs | more);
  }
  if (out[POINTS])
    for (int s = 0; s < 2; s++) put(to, POINTS, 3 * s, m->side[s].frame, 3);
  if (out[STATES]) put_states(to, c, m);
  if (out[FRAMES]) put_frames(to, m);
  if (out[POSE]) put_pose(w, to, c, m);
  if (!slip) return;
  sample_slip(m);
  if (out[TWIST]) put_twist(w, to, c, m);
  if (out[CARRIED]) put_carried(to, m);
  put_slip(w, to, c, m);
}

/* Results in contact frames, and how many of their first rows are the finger's */
enum { N_IN_FRAMES = 4 };
static const struct {
  int output, of_finger;
} IN_FRAMES[N_IN_FRAMES] = {{STATES, 4}, {SLIP, 0}, {ACCELERATION, 0}, {CARRIED, 3}};

/* Such results are not finite at a pole or an umbilic. The first such time becomes the failure; the
   other contacts are evaluated all the same. */
static void report_singular(work_t *w, const contact_t *c, int64_t n, const double *t,
                            double *const *out) {
  for (int a = 0; a < N_IN_FRAMES && !w->failure->code; a++) {
    const double *y = out[IN_FRAMES[a].output];
    const int64_t size = y ? n * OUTPUT_ROWS[IN_FRAMES[a].output] : 0;
    int64_t i = 0;
    while (i < size && isfinite(y[i])) i++;
    if (i == size) continue;
    w->failure->contact = c - w->plan->contacts, w->failure->t = t[i % n];
    w->failure->side = i / n >= IN_FRAMES[a].of_finger, w->failure->code = SINGULAR_TIME;
  }
}

static int needs_of(double *const *out) {
  int needs = 0;
  if (out[STATES] || out[CARRIED]) needs |= NEED_COORDINATES;
  if (out[POINTS]) needs |= NEED_POINT;
  if (out[POSE] || out[TWIST]) needs |= NEED_FRAME;
  if (out[TWIST]) needs |= NEED_SHAPE | NEED_VELOCITY;
  if (out[FRAMES]) needs |= NEED_FRAME | NEED_SHAPE;
  return needs;
}

static void evaluate_contact(work_t *w, const contact_t *c, int64_t n, const double *times,
                             double *const *out) {
  const int needs = needs_of(out);
  sample_t m;
  int64_t segment = 0, track[2] = {0, 0};
  for (int64_t i = 0, count; i < n; i += count) {
    segment = interval(c->segment_edges, c->n_segments, times[i], segment);
    m.segment = c->segments + segment;
    double from = c->segment_edges[segment], until = c->segment_edges[segment + 1];
    for (int s = 0; s < 2; s++) {
      const double *edges = c->track_edges[s];
      track[s] = interval(edges, c->n_tracks[s], times[i], track[s]);
      m.side[s].track = c->tracks[s] + track[s];
      /* not fmax(), which gcc calls without vzeroupper: it took a quarter of the time of points */
      if (edges[track[s]] > from) from = edges[track[s]];
      if (edges[track[s] + 1] < until) until = edges[track[s] + 1];
    }
    count = 1;
    while (count < L && i + count < n && times[i + count] >= from && times[i + count] < until)
      count++;
    gather(m.t, times + i, (int)count);
    put_block(w, c, &m, &(target_t){out, n, i, (int)count}, needs);
  }
  report_singular(w, c, n, times, out);
}
