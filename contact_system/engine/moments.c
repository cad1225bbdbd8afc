/* The state of a contact at one time, from which a later track or another plan goes on. */

/* u v theta of a body where the contact begins */
static const double *start_place(const contact_t *c, int side) {
  return c->row + (side ? K_PLACE_2 : K_PLACE_1);
}

/* The state of a body at a time on a track: (x, p) for a body that moves in space unless disturbed,
   whatever the track's own form is */
static void usual_state(work_t *w, const track_t *k, double t, double *state) {
  const body_t *b = k->body;
  sample_t m;
  m.w = w, m.count = 1;
  fill_lanes(m.t, t);
  m.side[b->side].track = k;
  sample_body(&m, b->side, NEED_STATE);
  for (int j = 0; j < state_size(k->in_space); j++) state[j] = m.side[b->side].state[j][0];
  if (!moves_in_space(b->surface)) return;
  if (!k->in_space) run_body(w, b, IN_SPACE, A_START, state, state);
  run_body(w, b, IN_SPACE, A_RESTORE, state, state);
}

/* Path velocities at a time */
static void sample_at(work_t *w, const contact_t *c, double t, sample_t *m) {
  m->w = w, m->contact = c, m->count = 1;
  m->segment = c->segments + interval(c->segment_edges, c->n_segments, t, 0);
  fill_lanes(m->t, t);
  sample_paths(m);
}

/* u v theta at a time; returns nonzero if they are not finite */
static int find_place(work_t *w, const contact_t *c, const track_t *k, double t, double *place) {
  const int side = k->body->side;
  sample_t m;
  sample_at(w, c, t, &m);
  m.side[side].track = k;
  sample_body(&m, side, NEED_COORDINATES);
  const double (*z)[L] = m.side[side].coordinates;
  place[0] = z[U][0], place[1] = z[V][0], place[2] = z[THETA][0];
  return !(isfinite(place[0]) && isfinite(place[1]) && isfinite(place[2]));
}

/* Anchors the first n tracks of a side, each from where the one before it ends. */
static void anchor_side(work_t *w, contact_t *c, int side, int64_t n) {
  track_t *tracks = c->tracks[side];
  double place[3], found[3];
  int64_t known = 0;
  while (known < n && (!tracks[known].in_space || tracks[known].n_anchors)) known++;
  if (known == n) return;
  int64_t last = known; /* the last track before that does not end at a pole */
  while (last > 0 && find_place(w, c, tracks + last - 1, tracks[last - 1].stop, found)) last--;
  memcpy(place, last > 0 ? found : start_place(c, side), sizeof place);
  for (int64_t i = known; i < n; i++) {
    track_t *k = tracks + i;
    if (k->in_space && !k->n_anchors) anchor_track(w, k, place);
    if (i + 1 < n && !find_place(w, c, k, k->stop, found)) memcpy(place, found, sizeof place);
  }
}

/* u v theta at the end of a track, or at an earlier time; if not finite, just before or after */
static void require_place(work_t *w, contact_t *c, int side, int64_t which, double t,
                          double *place) {
  anchor_side(w, c, side, which + 1);
  const track_t *k = c->tracks[side] + which;
  if (t > k->stop) t = k->stop;
  const double start = k->drive->start, aside = 1e-7 * (k->stop - start);
  const double tried[3] = {t, fmax(t - aside, start), fmin(t + aside, k->stop)};
  for (int i = 0; i < 3; i++)
    if (!find_place(w, c, k, tried[i], place)) return;
  w->failure->contact = c - w->plan->contacts, w->failure->side = side, w->failure->t = t;
  fail(w, SINGULAR_TIME);
}

static void moment_of(work_t *w, contact_t *c, double t, double *out) {
  sample_t m;
  double row[CONTACT_SIZE] = {0};
  sample_at(w, c, t, &m);
  row[K_ANGLE] = c->row[K_ANGLE];
  for (int a = 0; a < 2; a++) row[K_W1 + a] = m.path[0][a][0], row[K_Y + a] = m.v[a][0];
  for (int side = 0; side < 2; side++) {
    const int64_t which = interval(c->track_edges[side], c->n_tracks[side], t, 0);
    const track_t *k = c->tracks[side] + which;
    double *frame = row + (side ? K_FRAME_2 : K_FRAME_1);
    require_place(w, c, side, which, t, row + (side ? K_PLACE_2 : K_PLACE_1));
    if (moves_in_space(k->body->surface)) usual_state(w, k, t, frame);
  }
  memcpy(out, row + K_PLACE_1, MOMENT_SIZE * sizeof *out);
}
