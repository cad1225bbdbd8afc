/* From the schedule of a contact to its tracks: on each interval the cheapest exact way.

   * A finger that nothing accelerates runs on a geodesic, in closed form where there is one, else
     integrated once in arc length.
   * The object runs on a geodesic too while slip is negligible, else on the developed curve
     W s - V g.
   * While accelerations act, the bodies are integrated together with W_1 and V. */

/* Slip is ignored once all the displacement that it can still cause is below this part of
   tolerance * size; on developable surfaces, where it costs little, below ROUNDING * size. With 0.1
   its error counts beside that of panels, for 0.6 % fewer sweeps. */
static const double NEGLIGIBLE_PART = 0.01;
/* Length of a path, in sizes of a body, after which rounding leaves fewer than four digits */
static const double ENDLESS = 1e11;

/* a contact that is being planned, with its path velocities at the time reached */
typedef struct {
  work_t *w;
  contact_t *contact;
  double w1[2], w2[2], v[2];
} course_t;

static double norm(const double *d) { return hypot(d[0], d[1]); }

static const double *offset_on(const segment_t *s, int side) {
  return side ? s->acting + 4 : UNDISTURBED;
}

/* A track of a body that begins with a segment */
static track_t *add_track(course_t *c, int side, const segment_t *s, double stop, int reason) {
  const int64_t n = c->contact->n_tracks[side]++;
  track_t *k = c->contact->tracks[side] + n;
  double *edges = c->contact->track_edges[side] + n;
  edges[0] = s->drive->start, edges[1] = HUGE_VAL;
  k->body = &c->contact->body[side], k->drive = s->drive, k->stop = stop, k->reason = reason;
  k->in_space = moves_in_space(k->body->surface);
  k->push = s->acting + 2 * side, k->offset = offset_on(s, side);
  memcpy(k->w, side ? c->w2 : c->w1, sizeof k->w);
  return k;
}

/* ---- states of bodies ---- */

/* The state of a body where its last track ends, or where the contact begins */
static void state_of(course_t *c, int side, double *state) {
  const contact_t *contact = c->contact;
  const int64_t n = contact->n_tracks[side];
  const body_t *b = &contact->body[side];
  const double *frame = contact->row + (side ? K_FRAME_2 : K_FRAME_1), *p = frame + 3;
  if (n > 0) {
    const track_t *last = contact->tracks[side] + n - 1;
    usual_state(c->w, last, last->stop, state);
  } else if (!moves_in_space(b->surface)) {
    memcpy(state, start_place(contact, side), 3 * sizeof *state);
  } else if (any(p) || p[2] != 0.0) {
    memcpy(state, frame, 6 * sizeof *state);
    run_body(c->w, b, IN_SPACE, A_RESTORE, state, state);
  } else {
    run_body(c->w, b, IN_SPACE, A_START, start_place(contact, side), state);
  }
}

/* The same in space or in the chart */
static void in_form(course_t *c, int side, int in_space, double *state) {
  if (moves_in_space(c->contact->body[side].surface) == in_space)
    state_of(c, side, state);
  else if (c->contact->n_tracks[side] == 0)
    memcpy(state, start_place(c->contact, side), 3 * sizeof *state);
  else
    require_place(c->w, c->contact, side, c->contact->n_tracks[side] - 1, HUGE_VAL, state);
}

/* ---- integrated tracks ---- */

/* Begins a new track of a body, where its last one ends. Where its chart is a double cover, the
   sign of chart components depends on the branch that the path is on, which only u v theta show. */
static motion_t add_motion(course_t *c, int side, const segment_t *s, int reason) {
  const body_t *b = &c->contact->body[side];
  const drive_t *d = s->drive;
  const int disturbed = any(s->acting + 2 * side) || any(offset_on(s, side));
  const int by_branch = b->surface->double_cover && disturbed;
  const int in_space = moves_in_space(b->surface) && !by_branch;
  motion_t m = {.n = state_size(in_space), .r0 = c->contact->r0, .panel_limit = b->panel_limit};
  in_form(c, side, in_space, m.state);
  scales(c->w, in_space, b, m.state, m.scale);
  m.track = add_track(c, side, s, d->stop, reason), m.length = d->stop - d->start;
  m.track->kind = PANELS, m.track->in_space = in_space;
  return m;
}

/* Integrates a motion; if it finishes early, so does its track. */
static track_t *integrate_motion(course_t *c, motion_t *m) {
  track_t *k = m->track;
  c->w->failure->side = k->body->side;
  k->panels = integrate(c->w, m, c->w->plan->scene[S_TOLERANCE]);
  const double reached = k->panels.edges[k->panels.n];
  if (reached < m->length) k->stop = k->drive->start + reached;
  require_regular(c->w, k);
  return k;
}

/* Length of a first panel's path at a tolerance of 1e-12; twice as much takes as many sweeps, half
   of it 1 % more. With a part of the least radius alone, many contacts on ellipsoids took a fifth
   more panels. */
static double first_length(const body_t *b) { return 0.5 * sqrt(b->least_radius * b->size); }

/* ---- geodesics ---- */

/* In closed form, on a developable surface also under a rate offset, or integrated in arc length */
static track_t *add_geodesic(course_t *c, int side, const segment_t *s, double stop, int reason) {
  const body_t *b = &c->contact->body[side];
  /* where rolling is imposed, the finger's curve is integrated: it shows to be a geodesic */
  const int imposed = side == 0 && c->contact->row[K_FOLLOWS] > 0;
  const int form = imposed ? NO_CLOSED_FORM : b->surface->closed_form;
  if (form != NO_CLOSED_FORM) {
    double state[6];
    state_of(c, side, state);
    track_t *k = add_track(c, side, s, stop, reason);
    (form == GREAT_CIRCLES ? lay_circle : lay_line)(c->w, state, k);
    return k;
  }
  motion_t m = add_motion(c, side, s, reason);
  const double speed = norm(m.track->w);
  /* where sigma touches zero at a window's edge, an interval may be as short as rounding */
  m.track->by_length = 1, m.track->stop = stop;
  m.length = fmax(length_at(s->drive, stop - s->drive->start), 1e-300);
  m.first = speed > 0 ? first_length(b) / speed : HUGE_VAL;
  return integrate_motion(c, &m);
}

/* ---- slip and rate offsets ---- */

/* Length of a first panel, s: the time in which a path grows by first_length at sigma's mean */
static double first_time(const drive_t *d, double span, const body_t *b) {
  return span * (first_length(b) / fmax(length_at(d, span), 1e-300));
}

/* g(t) = int sigma exp(-L), right to rounding whatever the tolerance */
static panels_t slip_length(course_t *c, const drive_t *d) {
  track_t bodiless = {.drive = d};
  motion_t m = {.n = 1, .track = &bodiless, .length = d->stop - d->start};
  m.first = HUGE_VAL, m.slip = 1.0, m.panel_limit = HUGE_VAL;
  m.scale[0] = d->per_metre; /* the inverse of the most that g may be */
  return integrate(c->w, &m, 0.0);
}

/* Develops the object under a rate offset, or under slip until what is left of it is negligible;
   from there on it runs on a geodesic. */
static void develop(course_t *c, const segment_t *s, double negligible, int reason) {
  const drive_t *d = s->drive;
  motion_t m = add_motion(c, 1, s, reason);
  memcpy(m.v, c->v, sizeof m.v);
  m.slip = norm(c->v), m.finish = any(s->acting + 4) ? 0.0 : negligible;
  m.first = first_time(d, m.length, m.track->body);
  const double reached = integrate_motion(c, &m)->stop;
  if (!(reached < d->stop)) return;
  segment_t *rest = keep(c->w, 1, sizeof *rest);
  *rest = *s, rest->drive = drive_on(c->w, d->leg, reached, d->stop);
  add_geodesic(c, 1, rest, d->stop, NEGLIGIBLE);
}

/* The object on a segment on which nothing accelerates; `stop`: the end of the run of such segments
   without rate offsets. Returns the time reached. */
static double free_object(course_t *c, const segment_t *s, double stop) {
  const drive_t *d = s->drive;
  const body_t *b = &c->contact->body[1];
  const int straight = b->surface->closed_form == DEVELOPABLE, offset = any(s->acting + 4);
  const double part = straight ? ROUNDING : NEGLIGIBLE_PART * c->w->plan->scene[S_TOLERANCE];
  const double slip = norm(c->v), negligible = part * b->size * d->per_metre;
  const int reason = slip == 0 ? NO_SLIP : slip <= negligible ? NEGLIGIBLE : SLIPS;
  if (reason != NO_SLIP || offset) stop = d->stop;
  if (!straight && (reason == SLIPS || offset)) {
    develop(c, s, negligible, reason);
  } else {
    track_t *k = add_geodesic(c, 1, s, stop, reason);
    if (reason == SLIPS)
      k->panels = slip_length(c, d), chart_slope(c->w, b, k->begin, c->v, k->aside);
  }
  if (slip > 0) {
    const double left = decay_at(d, d->stop - d->start);
    c->v[0] *= left, c->v[1] *= left;
  }
  return stop;
}

/* ---- accelerations ---- */

/* Sets W_1 = w1 and W_2 = R_0 W_1; V stays. */
static void set_path_velocity(course_t *c, const double *w1) {
  const double *r = c->contact->r0;
  memcpy(c->w1, w1, sizeof c->w1);
  for (int a = 0; a < 2; a++) c->w2[a] = r[2 * a] * w1[0] + r[2 * a + 1] * w1[1];
}

/* The motion of a body under accelerations; more: W_1 or V, which follows the body's state, and
   whose errors are multiplied by `scale` */
static motion_t pushed_motion(course_t *c, int side, const segment_t *s, const double *more,
                              double scale) {
  const drive_t *d = s->drive;
  motion_t m = add_motion(c, side, s, PUSHED);
  for (int a = 0; a < 2; a++) m.state[m.n + a] = more[a], m.scale[m.n + a] = scale;
  m.n += 2, m.pushed = 1, m.first = first_time(d, m.length, m.track->body);
  return m;
}

/* About the time constant of slip, s: 1/lam at the start or the end, where lam is less */
static double time_constant(const drive_t *d) {
  return 1.0 / fmax(fmin(gain_at(d, 0.0), gain_at(d, d->stop - d->start)), 1e-9);
}

/* First the finger, if it is accelerated, with its W_1, then the object with V */
static void push_contact(course_t *c, segment_t *s) {
  const drive_t *d = s->drive;
  const double *act = s->acting;
  const track_t *finger = NULL;
  if (any(act)) {
    motion_t m = pushed_motion(c, 0, s, c->w1, 1.0);
    finger = integrate_motion(c, &m);
    s->w1_panels = &finger->panels;
    set_path_velocity(c, m.state + m.n - 2);
  }
  /* The unit of V's errors: |V| or, if greater, what the accelerations can cause, from 1e-3 to 1.
     With 0.01 as the least, 3 % fewer sweeps, small slip is half as exact. */
  double push = 0.0;
  for (int k = 0; k < 4; k++) push = fmax(push, fabs(act[k]) * c->contact->body[k / 2].size);
  const double grown =
      fmax(push / fmax(d->least, 1e-300) * fmin(d->stop - d->start, time_constant(d)), 1e-3);
  motion_t m = pushed_motion(c, 1, s, c->v, 1.0 / fmin(fmax(norm(c->v), grown), 1.0));
  m.slip = 1.0, m.finger = finger;
  s->v_panels = &integrate_motion(c, &m)->panels;
  memcpy(c->v, m.state + m.n - 2, sizeof c->v);
}

/* ---- a contact ---- */

/* The end of the run of segments of a leg, from one on, in which the finger (0) is not accelerated,
   or nothing acts on the object (1) */
static double free_until(const course_t *c, int side, int64_t k) {
  const segment_t *segments = c->contact->segments;
  double stop = segments[k].drive->stop;
  for (k++; k < c->contact->n_segments && !segments[k].turn; k++) {
    const double *act = segments[k].acting;
    if (any(act) || (side && (any(act + 2) || any(act + 4)))) break;
    stop = segments[k].drive->stop;
  }
  return stop;
}

static void refuse_endless(course_t *c) {
  double path = 0.0;
  for (int64_t k = 0; k < c->contact->n_segments; k++) {
    const drive_t *d = c->contact->segments[k].drive;
    path += length_at(d, d->stop - d->start);
  }
  const double given[2] = {c->w2[0] - c->v[0], c->w2[1] - c->v[1]};
  for (int side = 0; side < 2; side++) {
    const double sizes = norm(side ? given : c->w1) * path / c->contact->body[side].size;
    if (sizes <= ENDLESS) continue;
    failure_t *e = c->w->failure;
    e->side = side, e->value = sizes, e->end = ENDLESS;
    fail(c->w, TOO_LONG);
  }
}

static body_t body_of(const plan_t *plan, const double *row, int side) {
  return (body_t){plan->surfaces[(int64_t)row[B_SURFACE]],
                  plan->scene + (int64_t)row[B_NUMBERS],
                  row[B_SIZE],
                  row[B_LEAST_RADIUS],
                  row[B_PANEL_LIMIT],
                  side};
}

/* W_1, W_2, V and R_0 where a contact starts */
static void begin(course_t *c) {
  const double *row = c->contact->row;
  double found[6], in[5] = {row[K_ANGLE], row[K_W1], row[K_W1 + 1], row[K_Y], row[K_Y + 1]};
  run_one(c->w, contact_tables + T_START, NULL, in, found);
  memcpy(c->contact->r0, found, sizeof c->contact->r0);
  set_path_velocity(c, row + K_W1);
  memcpy(c->v, row[K_MOMENT] > 0 ? row + K_Y : found + 4, sizeof c->v);
}

/* Plans a segment's tracks, unless earlier ones cover it; until: where each body's last one ends */
static void plan_segment(course_t *c, int64_t index, double *until) {
  segment_t *s = c->contact->segments + index;
  const drive_t *d = s->drive;
  if (s->turn) {
    const double cosine = s->turn[0], sine = s->turn[1], *w1 = c->w1;
    set_path_velocity(c, (double[2]){cosine * w1[0] - sine * w1[1], sine * w1[0] + cosine * w1[1]});
  }
  /* under a law that cancels growth, no slip is left after a rest */
  if (d->grows && d->sigma[0] == 0.0) c->v[0] = c->v[1] = 0.0;
  memcpy(s->w1, c->w1, sizeof c->w1), memcpy(s->v, c->v, sizeof c->v);
  if (any(s->acting)) {
    until[0] = d->stop;
  } else if (until[0] <= d->start) {
    until[0] = free_until(c, 0, index);
    add_geodesic(c, 0, s, until[0], NO_SLIP);
  }
  if (any(s->acting) || any(s->acting + 2)) {
    push_contact(c, s);
    until[1] = d->stop;
  } else if (until[1] <= d->start) {
    until[1] = free_object(c, s, free_until(c, 1, index));
  }
}

static void plan_contact(work_t *w, int64_t index) {
  plan_t *plan = w->plan;
  contact_t *contact = plan->contacts + index;
  course_t c = {.w = w, .contact = contact};
  contact->row = plan->scene + S_HEADER + index * CONTACT_SIZE;
  w->failure->contact = index, w->begun = w->failure->tried;
  contact->body[0] = body_of(plan, contact->row + K_FINGER, 0);
  contact->body[1] = body_of(plan, plan->scene + S_OBJECT, 1);
  begin(&c);
  schedule(w, contact);
  refuse_endless(&c);
  for (int side = 0; side < 2; side++) {
    const int64_t most = (1 + side) * contact->n_segments;
    contact->tracks[side] = keep(w, most, sizeof(track_t));
    contact->track_edges[side] = keep(w, most + 1, sizeof(double));
  }
  double until[2] = {plan->scene[S_BEGIN], plan->scene[S_BEGIN]};
  for (int64_t k = 0; k < contact->n_segments; k++) plan_segment(&c, k, until);
}
