/* Derivatives of results by states, inputs and parameters: tangents of all values, in up to L
   directions at once. */

/* Adds the tangents of windows on contact i to those of its inputs, which act alike. */
static void add_window_tangents(component_t *c, long i) {
  for (long k = 0; k < c->model->n_windows; k++)
    for (int a = 0; a < 2 && acts(c, k, i); a++) {
      const window_t *w = c->model->windows + k;
      const long at = (long)w->values + 2 + a;
      double *input = c->tangents[at_of(c->model, i, OF_INPUTS) + 2 * (long)w->slot + a];
      for (int d = 0; d < L; d++)
        input[d] += c->value[SCALE] * c->tangents[at][d] + c->value[at] * c->tangents[SCALE][d];
    }
}

/* Tangents of contact i's results, from those of its states, inputs and parameters */
static void find_result_tangents(component_t *c, long i) {
  const long n = at_of(c->model, i, GROUPS) - at_of(c->model, i, OF_RATES);
  const table_t *t = system_of(c->model, i);
  const int64_t *column = data_at(c->model, c->model->contacts[i].columns);
  double (*results)[L] = c->tangents + at_of(c->model, i, OF_RATES);
  const size_t bytes = (size_t)n * sizeof *results;
  int any = 0;
  memset(results, 0, bytes);
  /* a leg's own numbers and literals have no tangents */
  memset(c->system_tangents, 0, (size_t)(t->first_lit + t->n_lit) * sizeof *c->system_tangents);
  for (long r = 0; r < t->n_in + t->n_const; r++)
    for (int d = 0; d < L && column[r] >= 0; d++)
      any |= (c->system_tangents[r][d] = c->tangents[column[r]][d]) != 0.0;
  if (any) {
    UNTRAPPED({
      double *r = load_system(c, i, c->system_tangents);
      c->engine->step_tangents(&(program_t){t->prologue, r}, c->system_tangents);
      c->engine->step_tangents(&(program_t){t->body, r}, c->system_tangents);
    });
    memcpy(results, c->system_tangents + t->first_out, bytes);
    const long n_states = states_of(c->model, i), w = 1 + n_states;
    /* V' is zero at rest, as in compute_from_states, unless an acceleration acts or changes */
    if (leaves_slip_behind(c, i) && none_accelerates(c->registers + w, 1))
      for (int d = 0; d < L; d++)
        if (none_accelerates(c->system_tangents[w] + d, L))
          results[n_states - 2][d] = results[n_states - 1][d] = 0.0;
  }
  for (long j = 0; j < n && past_end(c); j++)
    for (int d = 0; d < L; d++) results[j][d] = NAN;
}

/* Tangents of the results that are asked for, from those of the other values in c->tangents */
static status_t derive(component_t *c) {
  for (long i = 0; i < c->model->n_contacts; i++) {
    if (!c->live[i].derived) continue;
    const status_t s = FROM_STATES(c->now) ? OK : refresh(c, i, OF_STATES);
    if (s) return s;
    add_window_tangents(c, i);
    find_result_tangents(c, i);
  }
  return OK;
}

/* Jacobian times seed, by derivatives in one direction; or transposed, Jacobian^T times seed, by
   derivatives along each known, L at once. */
static status_t multiply(component_t *c, int transposed, const unsigned unknowns[],
                         size_t n_unknowns, const unsigned knowns[], size_t n_knowns,
                         const double *seed, double *value, size_t n) {
  size_t at = 0;
  if (n) memset(value, 0, n * sizeof *value);
  for (long i = 0; i < c->model->n_contacts; i++) c->live[i].derived = 0;
  EACH_VALUE(r, unknowns, n_unknowns)
  c->live[c->model->values[r].owner].derived |= !transposed || seed[at++] != 0.0;
  for (size_t done = 0; done < (transposed ? n : 1); done += L) {
    const size_t more = !transposed ? 1 : n - done < L ? n - done : L;
    at = 0;
    memset(c->tangents, 0, (size_t)c->model->n_values * sizeof *c->tangents);
    EACH_VALUE(r, knowns, n_knowns) {
      if (!transposed)
        c->tangents[r][0] += seed[at];
      else if (at >= done && at < done + more)
        c->tangents[r][at - done] = 1.0;
      at++;
    }
    const status_t s = derive(c);
    if (s) return s;
    at = 0;
    EACH_VALUE(r, unknowns, n_unknowns) {
      for (size_t d = 0; d < more && (!transposed || seed[at] != 0.0); d++) {
        const status_t wrong = check_found(c, r, c->tangents[r] + d, 1);
        if (wrong) return wrong;
        value[transposed ? done + d : at] += (transposed ? seed[at] : 1.0) * c->tangents[r][d];
      }
      at++;
    }
  }
  return OK;
}
