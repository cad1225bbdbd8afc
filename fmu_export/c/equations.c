/* A contact as a system of equations: all results from its states, by one table of instructions.

   Its inputs: time, states, disturbances (6); constants: gain, profile, parameters of finger and
   object; outputs: the values from the group OF_RATES on. */

/* The disturbances of contact i, by inputs and windows */
static void acting_on(const component_t *c, long i, double out[DISTURBANCES]) {
  memcpy(out, values_of(c, i, OF_INPUTS), DISTURBANCES * sizeof *out);
  for (long k = 0; k < c->model->n_windows; k++)
    for (int a = 0; a < 2 && acts(c, k, i); a++)
      out[2 * c->model->windows[k].slot + a] += c->value[SCALE] * window_values(c, k)[2 + a];
}

/* Loads the equations of contact i; returns their registers. During initialization, frames are put
   onto their surfaces here, while values stay as they were set. tangents: of the table's inputs, or
   NULL if no derivatives are asked for. */
static double *load_system(component_t *c, long i, double (*tangents)[L]) {
  const model_t *m = c->model;
  const long n = states_of(m, i);
  const table_t *t = system_of(m, i);
  const leg_t leg = leg_now(c, i);
  const int64_t *column = (const int64_t *)data_at(m, m->contacts[i].columns) + t->n_in;
  double x[MOST_STATES];
  memcpy(x, values_of(c, i, OF_STATES), (size_t)n * sizeof *x);
  if (c->now->phase == INITIALIZATION) put_frames(c, i, x, tangents ? tangents + 1 : NULL);
  for (long j = 0, own = 0; j < t->n_const; j++)
    c->scratch[j] = column[j] >= 0 ? c->value[column[j]] : own < leg.n ? leg.sigma[own++] : 0.0;
  double *r = load_table(c, t);
  r[0] = c->now->time - leg.start;
  memcpy(r + 1, x, (size_t)n * sizeof *x);
  acting_on(c, i, r + 1 + n);
  return r;
}

/* Whether none of the four accelerations acts; their stride: L in tangents */
static int none_accelerates(const double *w, int stride) {
  for (int j = 0; j < 4; j++)
    if (w[j * stride] != 0.0) return 0;
  return 1;
}

/* Sets V among states, or V' among rates, to zero. */
static void no_slip(const model_t *m, long i, double *x) {
  x[states_of(m, i) - 2] = x[states_of(m, i) - 1] = 0.0;
}

/* Computes the results of contact i from its states: groups from `group` up to, not with, `end`. */
static void compute_from_states(component_t *c, long i, int group, int end) {
  const model_t *m = c->model;
  const table_t *t = system_of(m, i);
  double *r;
  UNTRAPPED(r = load_system(c, i, NULL); c->engine->step(&(program_t){t->body, r}));
  double *found = r + t->first_out;
  const double *w = r + 1 + states_of(m, i);
  /* V' is infinite at rest, also without an acceleration: solvers evaluate a rest in mid-motion
     before the event there, which sets V to zero */
  if (leaves_slip_behind(c, i) && none_accelerates(w, 1)) no_slip(m, i, found);
  for (long k = at_of(m, i, group); k < at_of(m, i, end); k++)
    c->value[k] = past_end(c) ? NAN : found[k - at_of(m, i, OF_RATES)];
}
