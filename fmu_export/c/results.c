/* Results, each group when it is asked for: from plans, or by the equations from the states. */

/* Brings a group of contact i's results up to date, in c->value. */
static status_t refresh(component_t *c, long i, int group) {
  live_t *k = c->live + i;
  const int from_states = FROM_STATES(c->now);
  if (k->valid & BIT(group)) return OK;
  if (group == OF_RATES && !from_states) {
    const status_t s = refresh(c, i, OF_STATES);
    if (s) return s;
  }
  if (!from_states && !k->plan && plan_to(c, i, c->now->time))
    return refuse_motion(c, DISCARD, i, c->now->time, NULL);
  if (from_states || group == OF_RATES || group == OF_CONDITION) {
    compute_from_states(c, i, from_states ? OF_RATES : group, from_states ? GROUPS : group + 1);
  } else {
    /* at a pole or an umbilic, the values of a moment before are given */
    const double t = time_on(c, i), before = t - 1e-8 * (t - c->segment[i].begin);
    const int none = evaluate(c, i, t, BIT(group)) &&
                     (c->failure.code == NO_MEMORY || evaluate(c, i, before, BIT(group)));
    if (none && c->failure.code == NO_MEMORY)
      return refuse_motion(c, DISCARD, i, c->now->time, NULL);
    for (double *x = values_of(c, i, group); none && x < values_of(c, i, group + 1); x++) *x = NAN;
  }
  k->valid |= from_states ? BIT(GROUPS) - 1 : BIT(group);
  return OK;
}

/* a greater result is no value: at rest, tables divide an acceleration by 1e-300 */
#define BEYOND_VALUES 1e200

/* Says why there is no value. */
static status_t refuse(component_t *c, unsigned reference) {
  const memory_t *now = c->now;
  const char *what = name_of(c->model, reference);
  const long i = (long)c->model->values[reference].owner;
  if (past_end(c))
    return report(c, DISCARD, "%s has no value at t = %.17g s: " PAST_END, what, now->time,
                  now->limit);
  if (i >= 0 && rests(c, i))
    return report(c, DISCARD, "%s has no value at t = %.17g s: " AT_REST, what, now->time);
  return report(c, DISCARD,
                "%s has no value at t = %.17g s, at a singular point of a chart (a pole or an "
                "umbilic); %s",
                what, now->time,
                FROM_STATES(now)
                    ? "start elsewhere, or run the Co-Simulation, which passes such points"
                    : "ask a moment later");
}

/* Refuses the first of these values that does not exist. */
static status_t check_found(component_t *c, unsigned reference, const double *value, long count) {
  for (long i = 0; i < count; i++) {
    const unsigned r = reference + (unsigned)i;
    const double most = c->model->values[r].kind == CALCULATED ? BEYOND_VALUES : DBL_MAX;
    if (!islessequal(fabs(value[i]), most)) return refuse(c, r);
  }
  return OK;
}

static status_t get_values(component_t *c, unsigned reference, long count, double *value) {
  const long i = (long)c->model->values[reference].owner;
  int group = OF_INPUTS;
  while (i >= 0 && (long)reference >= at_of(c->model, i, group + 1)) group++;
  if (group >= (FROM_STATES(c->now) ? OF_RATES : OF_STATES)) { /* others are as they were set */
    status_t s = settle(c, c->now->time);
    if (!s) s = refresh(c, i, group);
    if (s) return s;
  }
  memcpy(value, c->value + reference, (size_t)count * sizeof *value);
  return check_found(c, reference, value, count);
}
