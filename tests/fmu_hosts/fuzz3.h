/* The calls of FMI 3 with random arguments. */

/* Reads a value, tries calls that are not allowed in a step, and may ask for an early return. */
static void intermediate_update(fmi3InstanceEnvironment environment, fmi3Float64 time,
                                fmi3Boolean set, fmi3Boolean can_get, fmi3Boolean finished,
                                fmi3Boolean can_return, fmi3Boolean *early_return,
                                fmi3Float64 *return_time) {
  double read;
  fmi3Boolean a, b, c;
  (void)environment, (void)set, (void)finished;
  if (can_get && inside && one_in(2))
    fmi3GetFloat64(inside, model.reference, 1, value, MOST_VALUES);
  if (inside && one_in(9) && !fmi3DoStep(inside, time, 0.1, fmi3True, &a, &b, &c, &read))
    fail("a step inside of a step");
  if (inside && one_in(9) && !fmi3Reset(inside)) fail("a reset inside of a step");
  *early_return = can_return && one_in(2), *return_time = time;
}

static fmu_t create_any(int stepping) {
  if (!stepping)
    return fmi3InstantiateModelExchange("one", model.token, resources(""), fmi3False, fmi3True,
                                        NULL, log_line);
  const fmi3Boolean events = one_in(2), early = one_in(2);
  never_early = !events && !early;
  return inside = fmi3InstantiateCoSimulation("one", model.token, resources(""), fmi3False,
                                              fmi3True, events, early, NULL, 0, NULL, log_line,
                                              one_in(2) ? intermediate_update : NULL);
}

static void start_any(fmu_t fmu, int stepping) {
  begin(fmu);
  if (stepping) fmi3EnterStepMode(fmu);
  else if (!one_in(4)) fmi3EnterContinuousTimeMode(fmu);
}

static unsigned char *sizes; /* sizes[reference] of its variable; 0: there is none */

/* Finds the number of states and the sizes of variables, as in the model description. */
static void find_sizes(fmu_t fmu) {
  fmu_t other = fmi3InstantiateModelExchange("one", model.token, resources(""), fmi3False,
                                             fmi3False, NULL, log_line);
  if (!other || fmi3GetNumberOfContinuousStates(other, &n_states)) fail("no number of states");
  release(other);
  sizes = calloc(greatest + 1, 1);
  for (unsigned r = 0; r <= greatest; r++)
    for (unsigned char n = 1; n < 17 && !sizes[r]; n++)
      if (!fmi3GetFloat64(fmu, &r, 1, value, n)) sizes[r] = n;
}

/* Chooses references; *n: how many values their variables have, a wrong number now and then. */
static size_t pick_values(size_t *n) {
  const size_t count = pick_references();
  *n = one_in(15);
  for (size_t k = 0; k < count; k++) *n += reference[k] <= greatest ? sizes[reference[k]] : 1;
  return count;
}

static int instantiate(fmu_t fmu) {
  const char *token = one_in(3) ? NULL : one_in(3) ? "other" : model.token;
  const char *name = one_in(3) ? NULL : "two";
  fmu_t other = one_in(3)
                    ? fmi3InstantiateScheduledExecution(name, token, NULL, fmi3True, fmi3False,
                                                        NULL, log_line, NULL, NULL, NULL)
                    : fmi3InstantiateModelExchange(name, token, NULL, fmi3True, fmi3False, NULL,
                                                   one_in(2) ? NULL : log_line);
  if (other) release(other);
  return fmu ? fmi3OK : fmi3Error;
}

static int configuration(fmu_t fmu) {
  return one_in(2) ? fmi3EnterConfigurationMode(fmu) : fmi3ExitConfigurationMode(fmu);
}

static int enter_initialization(fmu_t fmu) {
  const double from = number();
  const int status =
      fmi3EnterInitializationMode(fmu, one_in(2), number(), from, one_in(3), number());
  if (!status) time_now = from;
  return status;
}

static int get_float(fmu_t fmu) {
  size_t n;
  const size_t count = pick_values(&n);
  const int status = fmi3GetFloat64(fmu, one_in(90) ? NULL : reference, count, value, n);
  if (!status && !finite_values(n)) fail("a value that is not finite, with status OK");
  return status;
}

static int set_float(fmu_t fmu) {
  size_t n;
  const size_t count = pick_values(&n);
  fill_values();
  const int status = fmi3SetFloat64(fmu, reference, count, one_in(90) ? NULL : value, n);
  if (!status && !finite_values(n)) fail("a value that is not finite was taken");
  return status;
}

static int other_types(fmu_t fmu) {
  static fmi3Int32 integer[64];
  static fmi3Boolean boolean[64];
  static fmi3String text[64];
  static size_t size[64];
  static fmi3Binary binary[64];
  static fmi3Clock clock_value[64];
  const size_t n = below(2);
  pick_references();
  switch (below(8)) {
    case 0: return fmi3GetInt32(fmu, reference, n, integer, n);
    case 1: return fmi3SetInt32(fmu, reference, n, integer, n);
    case 2: return fmi3GetBoolean(fmu, reference, n, boolean, n);
    case 3: return fmi3SetString(fmu, reference, n, text, n);
    case 4: return fmi3GetBinary(fmu, reference, n, size, binary, n);
    case 5: return fmi3SetBinary(fmu, reference, n, size, binary, n);
    case 6: return fmi3GetClock(fmu, reference, n, clock_value);
    default: return fmi3ActivateModelPartition(fmu, reference[0], number());
  }
}

static int do_step(fmu_t fmu) {
  fmi3Boolean event, end, early;
  double reached = time_now;
  const double from = one_in(15) ? number() : time_now;
  const double size = one_in(10) ? number() : below(300) / 1000.0;
  const int status =
      fmi3DoStep(fmu, from, size, one_in(2), one_in(90) ? NULL : &event, &end, &early, &reached);
  if (!status) time_now = reached;
  if (status) return status;
  const double left = from + size - reached;
  if (early ? left < 0 : fabs(left) > 1e-9 * (1 + fabs(reached))) fail("not where it should be");
  return status;
}

static int get_output_derivatives(fmu_t fmu) {
  const fmi3Int32 order[4] = {1, 1, 1, 1};
  return fmi3GetOutputDerivatives(fmu, reference, pick_references(), order, value, below(5));
}

static int derivatives(fmu_t fmu) {
  unsigned known[4];
  double product[64];
  size_t n, m;
  const size_t n_known = pick_values(&n);
  memcpy(known, reference, sizeof known);
  const size_t n_unknown = pick_values(&m);
  fill_values();
  if (one_in(2))
    return fmi3GetDirectionalDerivative(fmu, reference, n_unknown, known, n_known, value, n,
                                        product, m);
  return fmi3GetAdjointDerivative(fmu, reference, n_unknown, known, n_known, value, m, product, n);
}

static int set_state(fmu_t fmu) {
  const unsigned time_reference = 0;
  const int status = fmi3SetFMUState(fmu, state[below(KEPT)]);
  if (!status) fmi3GetFloat64(fmu, &time_reference, 1, &time_now, 1), lines = 0;
  return status;
}

static int update_discrete_states(fmu_t fmu) {
  fmi3Boolean a, b, c, d, e;
  double next;
  return fmi3UpdateDiscreteStates(fmu, &a, &b, &c, &d, one_in(50) ? NULL : &e, &next);
}

static int evaluate_discrete_states(fmu_t fmu) { return fmi3EvaluateDiscreteStates(fmu); }
static int enter_step(fmu_t fmu) { return fmi3EnterStepMode(fmu); }

static int get_states(fmu_t fmu) {
  size_t n;
  if (one_in(3)) return fmi3GetNumberOfContinuousStates(fmu, one_in(9) ? NULL : &n);
  if (one_in(3)) return fmi3GetNominalsOfContinuousStates(fmu, value, states_count());
  return fmi3GetContinuousStates(fmu, value, states_count());
}

static int get_indicators(fmu_t fmu) {
  size_t n;
  if (one_in(2)) return fmi3GetNumberOfEventIndicators(fmu, one_in(9) ? NULL : &n);
  return fmi3GetEventIndicators(fmu, value, below(2));
}

static int get_dependencies(fmu_t fmu) {
  size_t n;
  return fmi3GetNumberOfVariableDependencies(fmu, below(greatest), &n);
}

static const call_t calls[] = {{"fmi3Instantiate", 1, instantiate},
                               {"fmi3SetDebugLogging", 1, set_debug_logging},
                               {"configuration mode", 1, configuration},
                               {"fmi3EnterInitializationMode", 2, enter_initialization},
                               {"fmi3ExitInitializationMode", 2, exit_initialization},
                               {"fmi3Terminate", 1, terminate},
                               {"fmi3Reset", 1, reset_any},
                               {"fmi3GetFloat64", 6, get_float},
                               {"fmi3SetFloat64", 8, set_float},
                               {"values of other types", 1, other_types},
                               {"fmi3DoStep", 9, do_step},
                               {"fmi3GetOutputDerivatives", 1, get_output_derivatives},
                               {"derivatives", 5, derivatives},
                               {"fmi3GetFMUState", 2, get_state},
                               {"fmi3SetFMUState", 2, set_state},
                               {"fmi3FreeFMUState", 1, free_state},
                               {"fmi3SerializeFMUState", 1, write_bytes},
                               {"fmi3DeserializeFMUState", 2, deserialize},
                               {"fmi3UpdateDiscreteStates", 2, update_discrete_states},
                               {"fmi3EvaluateDiscreteStates", 1, evaluate_discrete_states},
                               {"fmi3EnterEventMode", 2, enter_event},
                               {"fmi3EnterStepMode", 3, enter_step},
                               {"fmi3EnterContinuousTimeMode", 2, enter_continuous},
                               {"fmi3SetTime", 2, set_time},
                               {"fmi3CompletedIntegratorStep", 1, completed_step},
                               {"fmi3SetContinuousStates", 2, set_states},
                               {"states", 2, get_states},
                               {"fmi3GetContinuousStateDerivatives", 2, get_derivatives},
                               {"event indicators", 1, get_indicators},
                               {"dependencies", 1, get_dependencies},
                               {NULL, 0, NULL}};
