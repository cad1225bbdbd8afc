/* Finds where bodies touch by Newton's method. A table, `measured_contact` of contact_sensor.py,
   computes one step: its results begin with the next n unknowns, the length of the step to them,
   and the relative curvature of the bodies. */

static void sense(const table_t *table, double *r, int64_t n, const sensor_t *limits) {
  const double *next = r + table->first_out, *length = next + n;
  double *curvature = r + table->first_out + n + 1;
  const program_t one_step = {table->body, r};
  step(&one_step);
  const double first = *curvature;
  /* without a contact frame the length is NaN */
  for (int i = 0; i < limits->most_steps && *length > limits->small; i++) {
    memcpy(r, next, (size_t)n * sizeof *r);
    step(&one_step);
  }
  /* where bodies conform, steps may lead to places where they do not */
  if (fabs(first) <= limits->conformal && !(*length <= limits->small)) *curvature = first;
}
