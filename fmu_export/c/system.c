/* A contact as a system of equations: everything from its states, by one table of instructions.

   point: time, states, disturbances (6); constants: gain, profile, numbers of finger and object;
   results: the values from `rate` on, then the object's theta. */

static const table_t *system_of(const model_t *m, long i) {
  return m->systems + (long)contact_of(m, i)[P_SYSTEM];
}

static long n_results(const layout_t *l) { return l->at[GROUPS] - l->at[OF_RATES]; }

/* Inputs and windows on contact i */
static void acting_on(const component_t *c, long i, double out[DISTURBANCES]) {
  const double scale = c->value[(long)c->model->data[D_SCALE]];
  memcpy(out, c->value + c->model->layout[i].at[OF_INPUTS], DISTURBANCES * sizeof *out);
  for (long k = 0; k < c->model->n_windows; k++)
    for (int a = 0; a < 2 && acts(c, k, i); a++)
      out[2 * (int)window_of(c, k)[V_SLOT] + a] += scale * window_values(c, k)[2 + a];
}

/* Loads the registers with the point; the prologue runs where constants have changed. */
static void load_system(component_t *c, long i, int again) {
  const model_t *m = c->model;
  const layout_t *l = m->layout + i;
  const table_t *t = system_of(m, i);
  live_t *k = c->live + i;
  double *r = k->registers;
  const long which = leg_now(c, i);
  const leg_t leg = leg_of(c, i, which);
  r[0] = c->now->time - leg.start;
  memcpy(r + 1, c->value + l->at[OF_STATES], (size_t)l->states * sizeof *r);
  acting_on(c, i, r + 1 + l->states);
  if (k->prepared && k->leg == which && !again) return;
  const double *column = m->data + (long)contact_of(m, i)[P_COLUMNS];
  for (long j = t->n_in, own = 0; j < t->n_in + t->n_const; j++)
    r[j] = column[j] >= 0 ? c->value[(long)column[j]] : leg.sigma[own++];
  k->leg = which;
  if (!again) c->engine->step(&(program_t){t->prologue, r});
  k->prepared = !again;
}

/* The results of contact i at its states */
static const double *run_system(component_t *c, long i) {
  const table_t *t = system_of(c->model, i);
  UNTRAPPED(load_system(c, i, 0); c->engine->step(&(program_t){t->body, c->live[i].registers}));
  return c->live[i].registers + t->first_out;
}

static void find_system(component_t *c, long i) {
  const layout_t *l = c->model->layout + i;
  const double *found = run_system(c, i);
  memcpy(c->value + l->at[OF_RATES], found, (size_t)n_results(l) * sizeof *found);
  c->live[i].theta = found[n_results(l)];
  for (long j = l->at[OF_RATES]; j < l->at[GROUPS] && past_end(c); j++) c->value[j] = NAN;
}

/* States without slip */
static void no_slip(const layout_t *l, double *x) { x[l->states - 2] = x[l->states - 1] = 0.0; }

/* The path turns where a leg begins. What slips goes on slipping, but behind a rest under a law
   that makes up for growth. */
static void turn_path(component_t *c, long i, const leg_t *leg) {
  const layout_t *l = c->model->layout + i;
  const double cs = leg->turn[0], sn = leg->turn[1];
  double *x = c->value + l->at[OF_STATES], *w = x + l->states - 4;
  const double turned[2] = {cs * w[0] - sn * w[1], sn * w[0] + cs * w[1]};
  memcpy(w, turned, sizeof turned);
  if (c->model->data[D_MAKES_UP] > 0 && leg->sigma[0] == 0.0) no_slip(l, x);
}

/* ---- Model Exchange ---- */

static status_t get_values(component_t *c, unsigned reference, long count, double *value);
static status_t refuse(component_t *c, unsigned reference);
static status_t check_value(component_t *c, unsigned reference, double value);
static long without_value(const component_t *c, unsigned reference, const double *value,
                          long count);

static status_t set_states(component_t *c, const double *state) {
  for (long i = 0, at = 0; i < c->model->n_contacts; at += c->model->layout[i++].states)
    for (long j = 0; j < c->model->layout[i].states; j++)
      if (check_value(c, (unsigned)(c->model->layout[i].at[OF_STATES] + j), state[at + j]))
        return DISCARD;
  for (long i = 0; i < c->model->n_contacts; i++) {
    const layout_t *l = c->model->layout + i;
    memcpy(c->value + l->at[OF_STATES], state, (size_t)l->states * sizeof *state);
    state += l->states;
  }
  forget_values(c);
  return OK;
}

static status_t get_states(component_t *c, double *state, int rates) {
  for (long i = 0; i < c->model->n_contacts; i++) {
    const layout_t *l = c->model->layout + i;
    const status_t s =
        get_values(c, (unsigned)(rates ? l->at[OF_RATES] : l->at[OF_STATES]), l->states, state);
    if (s) return s;
    state += l->states;
  }
  return OK;
}

/* ---- derivatives ---- */

/* Runs the equations of contact i along tangents of their point and constants. */
static double (*run_along(component_t *c, long i)) [L] {
  const table_t *t = system_of(c->model, i);
  memset(c->tangents[t->first_lit], 0, (size_t)(t->n_regs - t->first_lit) * sizeof *c->tangents);
  UNTRAPPED({
    load_system(c, i, 1);
    c->engine->along(&(program_t){t->prologue, c->live[i].registers}, c->tangents);
    c->engine->along(&(program_t){t->body, c->live[i].registers}, c->tangents);
  });
  return c->tangents + t->first_out;
}

/* Part of a disturbance's growth: a reference, and by how much its growth counts */
typedef struct {
  long reference;
  double part;
} part_t;

enum { MOST_PARTS = 64 };

/* What column r of contact i's point and constants is the sum of; returns how many parts */
static long parts_of(const component_t *c, long i, long r, part_t out[MOST_PARTS]) {
  const layout_t *l = c->model->layout + i;
  const long scale = (long)c->model->data[D_SCALE], slot = r - 1 - l->states;
  const long own = (long)(c->model->data + (long)contact_of(c->model, i)[P_COLUMNS])[r];
  long n = 0;
  if (own >= 0) out[n++] = (part_t){own, 1.0}; /* else a leg's own number */
  for (long k = 0; slot >= 0 && slot < DISTURBANCES && k < c->model->n_windows; k++) {
    if ((long)window_of(c, k)[V_SLOT] != slot / 2 || !acts(c, k, i) || n + 2 > MOST_PARTS) continue;
    const long at = (long)window_of(c, k)[V_VALUES] + 2 + slot % 2;
    out[n++] = (part_t){at, c->value[scale]}, out[n++] = (part_t){scale, c->value[at]};
  }
  return n;
}

static status_t check_grown(component_t *c, unsigned reference, long count) {
  const long wrong = without_value(c, reference, c->grown + reference, count);
  return wrong == count ? OK : refuse(c, reference + (unsigned)wrong);
}

/* grown = J seed over all references, or J^T seed */
static void derive(component_t *c, int transposed) {
  const model_t *m = c->model;
  part_t part[MOST_PARTS];
  memcpy(c->grown, c->seed, (size_t)m->n_values * sizeof(double));
  for (long i = 0; i < m->n_contacts; i++) {
    const layout_t *l = m->layout + i;
    const table_t *t = system_of(m, i);
    const long inputs = t->n_in + t->n_const, results = n_results(l);
    const double *seed = c->seed + l->at[OF_RATES];
    double *grown = c->grown + l->at[OF_RATES];
    long used = 0;
    while (transposed && used < results && seed[used] == 0.0) used++;
    if (used == results) continue;
    if (!SYSTEM(c->now)) { /* brings the states up to date */
      double state;
      get_values(c, (unsigned)l->at[OF_STATES], 1, &state);
    }
    if (!transposed) memset(grown, 0, (size_t)results * sizeof *grown);
    for (long from = 0; from < inputs; from += L) {
      memset(c->tangents, 0, (size_t)inputs * sizeof *c->tangents);
      for (long r = from; r < inputs && r < from + L; r++) c->tangents[r][r - from] = 1.0;
      double (*found)[L] = run_along(c, i);
      for (long r = from; r < inputs && r < from + L; r++) {
        const long n = parts_of(c, i, r, part);
        double sum = 0.0;
        for (long q = 0; q < n && !transposed; q++)
          sum += part[q].part * c->seed[part[q].reference];
        for (long j = 0; j < results; j++) {
          if (!transposed && sum != 0.0) grown[j] += found[j][r - from] * sum;
          if (transposed && seed[j] != 0.0) sum += seed[j] * found[j][r - from];
        }
        for (long q = 0; q < n && transposed; q++)
          c->grown[part[q].reference] += part[q].part * sum;
      }
    }
    if (SYSTEM(c->now)) find_system(c, i);
    if (past_end(c))
      for (long j = 0; j < m->n_values; j++)
        if (transposed ? j < l->at[OF_RATES] : j >= l->at[OF_RATES] && j < l->at[GROUPS])
          c->grown[j] = NAN;
  }
}
