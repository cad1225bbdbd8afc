/* Results, each group where it is asked for: of plans, or of the equations at the states. */

#define BIT(group) (1u << (group))
#define ALL_RESULTS (BIT(GROUPS) - BIT(OF_STATES))

static void put_states(const layout_t *l, const double *row, double *to) {
  const int frame[2] = {K_FRAME_1, K_FRAME_2}, place[2] = {K_PLACE_1, K_PLACE_2};
  for (int side = 0; side < 2; to += l->frame[side++])
    memcpy(to, row + (l->frame[side] == 6 ? frame : place)[side],
           (size_t)l->frame[side] * sizeof *to);
  memcpy(to, row + K_W1, 4 * sizeof *to);
}

/* Evaluates groups of contact i at time t into its values; returns not 0 where a group has none. */
static int look(component_t *c, long i, double t, unsigned groups) {
  const layout_t *l = c->model->layout + i;
  double pose[16], row[CONTACT_SIZE], *v = c->value, *out[N_OUTPUTS] = {0};
  if (groups & BIT(OF_COORDINATES)) out[STATES] = v + l->at[OF_COORDINATES];
  if (groups & BIT(OF_SLIP)) out[SLIP] = v + l->at[OF_SLIP];
  if (groups & BIT(OF_TWIST)) out[TWIST] = v + l->at[OF_TWIST];
  if (groups & BIT(OF_POSE)) out[POSE] = pose;
  if (groups & BIT(OF_POINTS)) out[POINTS] = v + l->at[OF_POINTS];
  if (groups & BIT(OF_CONDITION)) out[SLIP_SPEED] = v + l->at[OF_CONDITION] + 1;
  if (look_at(c, i, t, out)) return 1;
  if (groups & BIT(OF_STATES)) {
    if (moment_at(c, c->live[i].plan, t, row + K_PLACE_1)) return 1;
    put_states(l, row, v + l->at[OF_STATES]);
  }
  for (int r = 0; r < 3 && out[POSE]; r++) {
    memcpy(v + l->at[OF_POSE] + 3 * r, pose + 4 * r, 3 * sizeof *v);
    v[l->at[OF_POSE] + 9 + r] = pose[4 * r + 3];
  }
  return 0;
}

static void no_values(component_t *c, long i, unsigned groups) {
  const long *at = c->model->layout[i].at;
  for (int g = OF_STATES; g < GROUPS; g++)
    for (long j = at[g]; groups & BIT(g) && j < at[g + 1]; j++) c->value[j] = NAN;
}

/* Rates, from the equations at the states; sigma and what follows from it */
static void find_rates(component_t *c, long i, unsigned groups) {
  const layout_t *l = c->model->layout + i;
  const double *found = run_system(c, i),
               *condition = found + l->at[OF_CONDITION] - l->at[OF_RATES];
  for (int j = 0; j < 4 && groups & BIT(OF_CONDITION); j++)
    if (j != 1) c->value[l->at[OF_CONDITION] + j] = condition[j];
  if (groups & BIT(OF_RATES))
    memcpy(c->value + l->at[OF_RATES], found, (size_t)l->states * sizeof *found);
}

/* Brings groups of contact i up to date. */
static status_t find(component_t *c, long i, unsigned groups) {
  live_t *k = c->live + i;
  if (SYSTEM(c->now)) {
    if (!k->valid && groups) {
      find_system(c, i);
      k->valid = ALL_RESULTS;
    }
    return OK;
  }
  const unsigned rates = BIT(OF_RATES), states = BIT(OF_STATES);
  if (groups & rates) groups |= states;
  const unsigned missing = groups & ~k->valid, asked = missing & ~rates;
  if (asked) {
    if (!k->plan && cover(c, i, c->now->time))
      return refuse_motion(c, DISCARD, i, "values", c->now->time);
    /* at a pole or an umbilic there are values of what comes a moment before */
    const double t = time_on(c, i), before = t - 1e-8 * (t - c->segment[i].begin);
    if (look(c, i, t, asked) && look(c, i, before, asked))
      no_values(c, i, missing | (missing & states ? rates : 0));
  }
  if (missing & (rates | BIT(OF_CONDITION))) find_rates(c, i, missing);
  k->valid |= missing;
  return OK;
}

/* The group to be found for a value, as a bit; 0 where it is given */
static unsigned group_of(const component_t *c, long i, long reference) {
  const long *at = c->model->layout[i].at;
  int g = OF_INPUTS;
  while (reference >= at[g + 1]) g++;
  if (SYSTEM(c->now)) return g < OF_RATES ? 0 : ALL_RESULTS;
  return BIT(g) & ALL_RESULTS;
}

/* The first of these values that there is not; count where there are all */
static long without_value(const component_t *c, unsigned reference, const double *value,
                          long count) {
  const long owner = c->model->owners[reference];
  long i = 0;
  for (; i < count; i++) {
    if (fabs(value[i]) <= 1e200) continue; /* tables divide an acceleration by 1e-300 at rest */
    if (!(fabs(value[i]) <= DBL_MAX) ||
        (kind_of(c->model, reference + i) == CALCULATED && rests(c, owner)))
      break;
  }
  return i;
}

/* Says why there is no value. */
static status_t refuse(component_t *c, unsigned reference) {
  const memory_t *now = c->now;
  const char *what = c->model->names[reference];
  const long i = c->model->owners[reference];
  if (past_end(c))
    return report(
        c, DISCARD,
        "%s has no value at t = %.17g s: sigma is negative from t = %.9g s on; end there, "
        "or change the profile",
        what, now->time, now->limit);
  if (i >= 0 && rests(c, i))
    return report(c, DISCARD, "%s has no value at t = %.17g s: " AT_REST, what, now->time);
  return report(c, DISCARD,
                "%s has no value at t = %.17g s, at a singular point of a chart (a pole or an "
                "umbilic); %s",
                what, now->time,
                SYSTEM(now) ? "start elsewhere, or run the Co-Simulation, which passes such points"
                            : "ask a moment later");
}

static status_t get_values(component_t *c, unsigned reference, long count, double *value) {
  const long i = c->model->owners[reference];
  if (i >= 0) {
    const unsigned group = group_of(c, i, reference);
    const int stuck = group && !SYSTEM(c->now) ? settle(c) : 0;
    if (stuck) return refuse_motion(c, DISCARD, stuck - 1, "values", c->now->time);
    if (group & ~c->live[i].valid) {
      const status_t s = find(c, i, group);
      if (s) return s;
    }
  }
  memcpy(value, c->value + reference, (size_t)count * sizeof *value);
  const long wrong = without_value(c, reference, value, count);
  return wrong == count ? OK : refuse(c, reference + (unsigned)wrong);
}

/* ---- derivatives ---- */

/* Runs the equations of contact i along tangents of their point and constants. */
static double (*run_along(component_t *c, long i)) [L] {
  const table_t *t = system_of(c->model, i);
  memset(c->tangents[t->first_lit], 0, (size_t)(t->n_regs - t->first_lit) * sizeof *c->tangents);
  UNTRAPPED({
    load_system(c, i, c->tangents);
    c->engine->along(&(program_t){t->prologue, c->live[i].registers}, c->tangents);
    c->engine->along(&(program_t){t->body, c->live[i].registers}, c->tangents);
  });
  return c->tangents + t->first_out;
}

/* Windows on contact i act as its inputs do, which take over their seed or hand back what grew. */
static void derive_windows(component_t *c, long i, int transposed) {
  const long scale = (long)c->model->data[D_SCALE];
  for (long k = 0; k < c->model->n_windows; k++)
    for (int a = 0; a < 2 && acts(c, k, i); a++) {
      const long at = (long)window_of(c, k)[V_VALUES] + 2 + a;
      const long input = c->model->layout[i].at[OF_INPUTS] + 2 * (int)window_of(c, k)[V_SLOT] + a;
      if (transposed) {
        c->grown[at] += c->value[scale] * c->grown[input];
        c->grown[scale] += c->value[at] * c->grown[input];
      } else {
        c->seed[input] += c->value[scale] * c->seed[at] + c->value[at] * c->seed[scale];
      }
    }
}

/* J seed of contact i, all of it in one lane */
static void grow_along(component_t *c, long i, const double *column, long inputs, double *grown) {
  double any = 0.0;
  memset(c->tangents, 0, (size_t)inputs * sizeof *c->tangents);
  for (long r = 0; r < inputs; r++) {
    if (column[r] >= 0) c->tangents[r][0] = c->seed[(long)column[r]]; /* else a leg's own number */
    any = fmax(any, fabs(c->tangents[r][0]));
  }
  if (any == 0.0) return;
  double (*found)[L] = run_along(c, i);
  for (long j = 0; j < n_results(c->model->layout + i); j++) grown[j] = found[j][0];
}

/* J^T seed of contact i, by blocks of columns of J */
static void hand_back(component_t *c, long i, const double *column, long inputs,
                      const double *seed) {
  const long results = n_results(c->model->layout + i);
  for (long from = 0; from < inputs; from += L) {
    memset(c->tangents, 0, (size_t)inputs * sizeof *c->tangents);
    for (long r = from; r < inputs && r < from + L; r++) c->tangents[r][r - from] = 1.0;
    double (*found)[L] = run_along(c, i);
    for (long r = from; r < inputs && r < from + L; r++)
      for (long j = 0; column[r] >= 0 && j < results; j++)
        if (seed[j] != 0.0) c->grown[(long)column[r]] += seed[j] * found[j][r - from];
  }
}

/* grown = J seed over all references, or J^T seed */
static void derive(component_t *c, int transposed) {
  const model_t *m = c->model;
  memcpy(c->grown, c->seed, (size_t)m->n_values * sizeof(double));
  for (long i = 0; i < m->n_contacts; i++) {
    const layout_t *l = m->layout + i;
    const table_t *t = system_of(m, i);
    const long inputs = t->n_in + t->n_const, results = n_results(l);
    const double *seed = c->seed + l->at[OF_RATES];
    const double *column = m->data + (long)contact_of(m, i)[P_COLUMNS];
    double *grown = c->grown + l->at[OF_RATES];
    long used = 0;
    while (transposed && used < results && seed[used] == 0.0) used++;
    if (used == results) continue;
    if (!SYSTEM(c->now)) { /* brings the states up to date */
      double state;
      get_values(c, (unsigned)l->at[OF_STATES], 1, &state);
    }
    if (transposed) {
      hand_back(c, i, column, inputs, seed);
      derive_windows(c, i, 1);
    } else {
      derive_windows(c, i, 0);
      memset(grown, 0, (size_t)results * sizeof *grown);
      grow_along(c, i, column, inputs, grown);
    }
    if (SYSTEM(c->now)) find_system(c, i);
    if (past_end(c))
      for (long j = 0; j < m->n_values; j++)
        if (transposed ? j < l->at[OF_RATES] : j >= l->at[OF_RATES] && j < l->at[GROUPS])
          c->grown[j] = NAN;
  }
}
