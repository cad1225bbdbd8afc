/* Events: edges of windows, corners of legs, new inputs, a new gain, a measurement. */

/* Turns the path velocity where a leg begins. V stays, but is zero after a rest under a law that
   cancels growth. */
static void turn_path(component_t *c, long i, const leg_t *leg) {
  const double cs = leg->turn[0], sn = leg->turn[1];
  double *x = values_of(c, i, OF_STATES), *w = x + states_of(c->model, i) - 4;
  const double turned[2] = {cs * w[0] - sn * w[1], sn * w[0] + cs * w[1]};
  memcpy(w, turned, sizeof turned);
  if (cancels_growth(c->model) && leg->sigma[0] == 0.0) no_slip(c->model, i, x);
}

/* From here on, values at an edge are those after it. */
static void pass_edges(component_t *c) {
  memory_t *now = c->now;
  const double before = now->acts_at;
  now->acts_at = snapped(c, now->time);
  forget_values(c);
  now->pending = 0;
  if (now->stepping) return;
  now->ended = reached(now->time, now->limit);
  if (!(now->phase & (EVENT | CONTINUOUS))) return;
  for (long k = 0; k < n_edges(c->model); k++)
    now->jumped |= before < edge_of(c, k) && edge_of(c, k) <= now->acts_at;
  for (long i = 0; i < c->model->n_contacts; i++) {
    for (long k = 1; k < n_legs(c->model, i); k++) {
      const leg_t leg = leg_of(c, i, k);
      if (before < leg.start && leg.start <= now->acts_at) turn_path(c, i, &leg);
    }
    if (!leaves_slip_behind(c, i)) continue;
    no_slip(c->model, i, values_of(c, i, OF_STATES));
    now->jumped = 1;
  }
}

/* Whether an input accelerates contact i at rest: then W' is infinite, and no step is possible. */
static int pushed_at_rest(const component_t *c, long i) {
  return !none_accelerates(values_of(c, i, OF_INPUTS), 1) && rests(c, i);
}

enum { TRIGGER, MEASURED }; /* offsets in the group OF_MEASURED */

/* Finds the states of contact i at the measured pose, by Newton's method from its planned place; or
   takes the states that are measured, with a table of no unknowns. found: states; M_1 and M_2,
   column by column. */
static const char *find_measured(component_t *c, long i, double **found) {
  const contact_t *k = c->model->contacts + i;
  const sensor_t *limit = data_at(c->model, c->model->head->sensor);
  const table_t *t = c->model->tables + k->sensor;
  double *next = c->scratch, body[BODY_SIZE];
  for (int side = 0; side < 2; side++) put_body(c, i, side, &next, body), *next++ = body[B_SIZE];
  double *r = load_table(c, t), *x = r, *y = r + t->first_out;
  for (int side = 0; side < 2; side++) {
    const size_t n = (size_t)k->unknowns[side];
    const double *planned =
        n == 3 ? values_of(c, i, OF_POINTS) + 3 * side : values_of(c, i, OF_COORDINATES) + 4 * side;
    memcpy(x, planned, n * sizeof *x), x += n;
  }
  const long unknowns = (long)(x - r);
  memcpy(x, values_of(c, i, OF_MEASURED) + MEASURED, (size_t)(t->n_in - unknowns) * sizeof *x);
  c->engine->sense(t, r, unknowns, limit);
  y += unknowns; /* length of the step, relative curvature, states, metric roots */
  *found = y + 2;
  if (fabs(y[1]) <= limit->conformal)
    return "the surfaces conform at the contact, so that a twist does not tell where they touch; "
           "measure states";
  if (!(y[0] <= limit->settled))
    return "near its planned place no common normal of the surfaces is found at the measured pose; "
           "give X_OF, the finger's frame in the object's, or resynchronise sooner";
  return NULL;
}

/* Lets segment s of contact i begin now at these states, behind which are M_1 and M_2. */
static const char *restart_at_states(component_t *c, long i, segment_t *s, const double *x) {
  const double sigma = sigma_now(c, i), *root = x + N_STATES;
  double acting[DISTURBANCES], path[2][2], *to = s->row;
  acting_on(c, i, acting);
  for (int side = 0; side < 2; side++, root += 4) {
    const double *offset = acting + 4; /* in the object's rates, but not in its path velocity */
    const double du = x[4 * side + 2] - side * offset[0], dv = x[4 * side + 3] - side * offset[1];
    for (int a = 0; a < 2; a++) path[side][a] = (root[a] * du + root[2 + a] * dv) / sigma;
  }
  if (!all_finite(path[0], 4))
    return "it is measured at a pole or an umbilic of a chart, where there is no contact frame, or "
           "outside the chart, as at u < 0 of a sphere; measure a moment later, or in principal "
           "values";
  memset(to, 0, sizeof s->row);
  memcpy(to + K_PLACE_1, x + U1, 2 * sizeof *x), memcpy(to + K_PLACE_2, x + U2, 2 * sizeof *x);
  /* the finger's frame is turned by -psi, so that R_0 = diag(1, -1) as in the equations */
  const double cs = cos(x[PSI]), sn = sin(x[PSI]), *w = path[0];
  to[K_PLACE_1 + 2] = -x[PSI];
  to[K_W1] = cs * w[0] - sn * w[1], to[K_W1 + 1] = sn * w[0] + cs * w[1];
  memcpy(to + K_Y, path[1], 2 * sizeof *x);
  s->begin = c->now->acts_at;
  return NULL;
}

/* Lets segment s of contact i begin where it is measured. */
static const char *restart_at_measurement(component_t *c, long i, segment_t *s) {
  const int posed = c->model->contacts[i].unknowns[0] > 0;
  const double *planned = values_of(c, i, OF_COORDINATES);
  double *x;
  if (!(sigma_now(c, i) > 0))
    return "sigma is zero, so that rates do not determine path velocities; measure while sigma > 0";
  /* the plan gives the coordinates' turn and branch, and where the search for the contact begins */
  const int by_plan = !plan_to(c, i, c->now->acts_at) &&
                      !evaluate(c, i, time_on(c, i), BIT(OF_COORDINATES) | BIT(OF_POINTS));
  if (!by_plan && c->failure.code == NO_MEMORY) return "there is no memory";
  if (posed && !by_plan) return "its plan has no coordinates there; measure a moment later";
  const char *wrong = find_measured(c, i, &x);
  if (wrong) return wrong;
  for (int side = 0; side < 2 && by_plan; side++) {
    double *own = x + 4 * side, place[5] = {own[0], own[1], own[2], own[3], x[PSI]};
    const double beside[3] = {planned[4 * side], planned[4 * side + 1], planned[PSI]};
    c->engine->wind(surface_of(c->model, i, side), beside, place);
    memcpy(own, place, 4 * sizeof *own), x[PSI] = place[4];
  }
  return restart_at_states(c, i, s, x);
}

/* If results come from plans, begins a new segment of each contact whose inputs, gain or
   measurement have changed. target: the end of a step, or the present time. */
static status_t settle(component_t *c, double target) {
  memory_t *now = c->now;
  if (now->settled || FROM_STATES(now)) return OK;
  int any_pushed = 0;
  for (long i = 0; i < c->model->n_contacts; i++) {
    segment_t *s = c->segment + i;
    const int pushed = pushed_at_rest(c, i);
    any_pushed |= pushed;
    double acting[DISTURBANCES];
    for (int j = 0; j < DISTURBANCES; j++)
      acting[j] = pushed && j < 4 ? 0.0 : values_of(c, i, OF_INPUTS)[j];
    const int measures = at_of(c->model, i, OF_MEASURED) < at_of(c->model, i, OF_STATES);
    const double trigger = measures ? values_of(c, i, OF_MEASURED)[TRIGGER] : 0.0;
    const int fresh = trigger != 0.0 && trigger != s->trigger; /* a new measurement */
    s->trigger = trigger;
    if (!fresh && s->gain == c->value[GAIN] && !memcmp(s->acting, acting, sizeof acting)) continue;
    const double at = now->acts_at, lasted = at - s->begin;
    double end = s->end;
    if (fresh || !reached(s->begin, at)) {
      if (fresh) {
        const char *wrong;
        UNTRAPPED(wrong = restart_at_measurement(c, i, s));
        if (wrong) return refuse_motion(c, DISCARD, i, target, wrong);
      } else if (plan_to(c, i, at) || restart_segment(c, c->live[i].plan, time_on(c, i), s)) {
        return refuse_motion(c, DISCARD, i, target, NULL);
      }
      end = at + lasted; /* when events are frequent, planning far ahead is waste */
    }
    s->end = end_of(c, s->begin, end, target);
    s->gain = c->value[GAIN];
    memcpy(s->acting, acting, sizeof acting);
    drop_plan(c, i);
  }
  forget_values(c);
  now->settled = !any_pushed;
  return OK;
}
