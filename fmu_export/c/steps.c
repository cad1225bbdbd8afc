/* Starting, and stepping. */

/* Begins the segment of contact i at its states, of which the values stay as they were set. */
static const char *place_contact(component_t *c, long i) {
  const model_t *m = c->model;
  segment_t *s = c->segment + i;
  double states[MOST_STATES], *x = states, *to = s->row;
  memcpy(x, values_of(c, i, OF_STATES), (size_t)states_of(m, i) * sizeof *x);
  const char *wrong = put_frames(c, i, x, NULL);
  if (wrong) return wrong;
  drop_plan(c, i);
  memset(s, 0, sizeof *s);
  s->begin = c->now->time, s->gain = c->value[GAIN];
  if (leaves_slip_behind(c, i)) no_slip(m, i, x);
  to[K_MOMENT] = 1.0; /* psi = -theta_1 - theta_2, R_0 = diag(1, -1) */
  for (int side = 0; side < 2; x += frame_of(m, i, side++)) {
    double *place = to + (side ? K_PLACE_2 : K_PLACE_1);
    if (frame_of(m, i, side) == 6) {
      memcpy(to + (side ? K_FRAME_2 : K_FRAME_1), x, 6 * sizeof *x);
      find_place(c, i, side, x, place);
    } else
      memcpy(place, x, 3 * sizeof *x);
  }
  memcpy(to + K_W1, x, 4 * sizeof *x);
  if (frame_of(m, i, 0) == 6) { /* whole turns are added to psi, to be nearest the scene's */
    const double turn = 6.283185307179586, psi = -to[K_PLACE_1 + 2] - to[K_PLACE_2 + 2];
    to[K_PLACE_1 + 2] -= turn * ceil((row_of(m, i)[K_ANGLE] - psi) / turn - 0.5);
  }
  if (!all_finite(s->row, CONTACT_SIZE))
    return "its charts have no coordinates there, as at a pole";
  const double stop = c->now->stop_time, horizon = m->scene[S_END];
  const double far = stop < HUGE_VAL ? stop : s->begin < horizon ? horizon : s->begin + horizon;
  s->end = end_of(c, s->begin, far, s->begin);
  return NULL;
}

/* Evaluates contact i after each of its own edges, then now, so that steps allocate nothing. */
static void warm(component_t *c, long i) {
  const double at = c->now->acts_at;
  for (long k = n_edges(c->model); k >= 0; k--) {
    if (k && k <= 2 * c->model->n_windows && c->model->windows[(k - 1) / 2].contact != i) continue;
    c->now->acts_at = k ? edge_of(c, k - 1) : at;
    for (int g = OF_STATES; g < GROUPS; g++) evaluate(c, i, time_on(c, i), BIT(g));
  }
}

/* Starts all contacts, or leaves all values as they were set. */
static status_t start(component_t *c) {
  memory_t *now = c->now;
  const model_t *m = c->model;
  const int64_t *order = data_at(m, m->head->orders.at);
  study_profiles(c);
  if (now->limit <= now->time)
    REFUSE("sigma is negative from t = %.9g s on; change the profile", now->time);
  for (long k = 0; k < m->head->orders.count; k++, order += 2) {
    const unsigned greater = (unsigned)order[0], less = (unsigned)order[1];
    if (!(c->value[greater] > c->value[less]))
      REFUSE("%s = %.9g is refused: it must be greater than %s = %.9g; set both, or export a scene "
             "that has this",
             name_of(m, greater), c->value[greater], name_of(m, less), c->value[less]);
  }
  pass_edges(c);
  for (long i = 0; i < m->n_contacts; i++) {
    const char *wrong = place_contact(c, i);
    if (wrong)
      REFUSE(
          "contact[%ld] cannot start: %s; change its start values or the parameters of the surface",
          i + 1, wrong);
    if (now->stepping && plan_to(c, i, now->time))
      return refuse_motion(c, FAILED, i, now->time, NULL);
  }
  for (long i = 0; i < m->n_contacts; i++) {
    put_states(m, i, c->segment[i].row, values_of(c, i, OF_STATES));
    if (now->stepping) warm(c, i);
  }
  now->settled = 0; /* inputs act from here on */
  forget_values(c);
  return OK;
}

/* ---- steps ---- */

/* Moves all contacts to a time, or none. If the importer allows it, the step ends before that time,
   where sigma ends or, with events, at an edge. */
static status_t step(component_t *c, double target) {
  memory_t *now = c->now;
  const long n = c->model->n_contacts;
  const int may_end = c->early_return && !reached(now->time, now->limit);
  now->ended = !may_end && !reached(now->limit, target);
  if (now->ended) return report(c, DISCARD, "no step to t = %.9g s: " PAST_END, target, now->limit);
  if (now->pending) pass_edges(c);
  for (long i = 0; i < n; i++)
    if (pushed_at_rest(c, i)) return report(c, DISCARD, "no step to t = %.9g s: " AT_REST, target);
  const status_t s = settle(c, target);
  if (s) return s;
  const double next = next_edge(c), end = fmin(target, now->limit);
  const double goal = c->uses_events && c->early_return && reached(end, next) ? next : end;
  for (long i = 0; i < n; i++)
    if (plan_to(c, i, goal)) return refuse_motion(c, DISCARD, i, target, NULL);
  set_time(c, goal);
  if (!c->uses_events || !reached(goal, next)) return OK;
  const double edge = edge_at(c, goal, 0);
  if (edge < HUGE_VAL) now->pending = 1, now->acts_at = nextafter(edge, -HUGE_VAL);
  return OK;
}
