/* The calls of FMI 2 with random arguments. */

static fmu_t create_any(int stepping) {
  never_early = 1;
  return fmi2Instantiate("one", stepping ? fmi2CoSimulation : fmi2ModelExchange, model.token,
                         resources("file://"), &callbacks, fmi2False, fmi2True);
}

static void start_any(fmu_t fmu, int stepping) {
  fmi2EventInfo info;
  begin(fmu);
  if (stepping) return;
  fmi2NewDiscreteStates(fmu, &info);
  if (!one_in(4)) fmi2EnterContinuousTimeMode(fmu);
}

/* Finds the number of states, which an importer would read in the model description. */
static void find_sizes(fmu_t fmu) {
  logging = 0;
  while (++n_states < MOST_VALUES && fmi2GetNominalsOfContinuousStates(fmu, value, n_states))
    continue;
}

static int instantiate(fmu_t fmu) {
  static char name[400];
  (void)fmu;
  memset(name, 'x', below(sizeof name));
  name[below(sizeof name)] = 0, name[sizeof name - 1] = 0;
  fmu_t other = fmi2Instantiate(one_in(3) ? NULL : name, (fmi2Type)below(3),
                                one_in(3)   ? NULL
                                : one_in(3) ? "other"
                                            : model.token,
                                NULL, one_in(5) ? NULL : &callbacks, fmi2True, fmi2False);
  if (other) release(other);
  return fmu ? fmi2OK : fmi2Error;
}

static int setup(fmu_t fmu) {
  return fmi2SetupExperiment(fmu, one_in(2), number(), number(), one_in(3), number());
}

static int enter_initialization(fmu_t fmu) { return fmi2EnterInitializationMode(fmu); }

static int get_real(fmu_t fmu) {
  const size_t n = pick_references();
  const int status = fmi2GetReal(fmu, one_in(90) ? NULL : reference, n, value);
  if (!status && !finite_values(n)) fail("a value that is not finite, with status OK");
  return status;
}

static int set_real(fmu_t fmu) {
  const size_t n = pick_references();
  fill_values();
  const int status = fmi2SetReal(fmu, reference, n, one_in(90) ? NULL : value);
  if (!status && !finite_values(n)) fail("a value that is not finite was taken");
  return status;
}

static int other_types(fmu_t fmu) {
  const size_t n = below(2);
  fmi2Integer integer[4] = {0};
  fmi2String text[4] = {"", "", "", ""};
  pick_references();
  switch (below(6)) {
    case 0: return fmi2GetInteger(fmu, reference, n, integer);
    case 1: return fmi2SetInteger(fmu, reference, n, integer);
    case 2: return fmi2GetBoolean(fmu, reference, n, integer);
    case 3: return fmi2SetBoolean(fmu, reference, n, integer);
    case 4: return fmi2GetString(fmu, reference, n, text);
    default: return fmi2SetString(fmu, reference, n, text);
  }
}

static int do_step(fmu_t fmu) {
  const double from = one_in(15) ? number() : time_now;
  const double size = one_in(10) ? number() : below(300) / 1000.0;
  const int status = fmi2DoStep(fmu, from, size, one_in(2));
  if (!status) time_now = from + size;
  return status;
}

static int set_input_derivatives(fmu_t fmu) {
  const fmi2Integer order[4] = {1, 1, one_in(5) ? 2 : 1, one_in(9) ? 0 : 1};
  const size_t n = pick_references();
  fill_values();
  return fmi2SetRealInputDerivatives(fmu, reference, n, order, value);
}

static int get_output_derivatives(fmu_t fmu) {
  const fmi2Integer order[4] = {1, 1, 1, 1};
  return fmi2GetRealOutputDerivatives(fmu, reference, pick_references(), order, value);
}

static int directional(fmu_t fmu) {
  unsigned known[4];
  double product[4];
  const size_t n = pick_references();
  memcpy(known, reference, sizeof known);
  fill_values();
  return fmi2GetDirectionalDerivative(fmu, reference, pick_references(), known, n,
                                      one_in(90) ? NULL : value, product);
}

static int set_state(fmu_t fmu) {
  const int status = fmi2SetFMUstate(fmu, state[below(KEPT)]);
  if (!status) fmi2GetRealStatus(fmu, fmi2LastSuccessfulTime, &time_now), lines = 0;
  return status;
}

static int new_discrete_states(fmu_t fmu) {
  fmi2EventInfo info;
  return fmi2NewDiscreteStates(fmu, one_in(50) ? NULL : &info);
}

static int get_states(fmu_t fmu) { return fmi2GetContinuousStates(fmu, value, states_count()); }

static int get_indicators(fmu_t fmu) { return fmi2GetEventIndicators(fmu, value, below(2)); }

static int get_status(fmu_t fmu) {
  fmi2Status status;
  fmi2Integer integer;
  fmi2Boolean boolean;
  fmi2String text;
  double real;
  switch (below(6)) {
    case 0: return fmi2GetStatus(fmu, (fmi2StatusKind)below(4), &status);
    case 1: return fmi2GetRealStatus(fmu, (fmi2StatusKind)below(4), one_in(9) ? NULL : &real);
    case 2: return fmi2GetIntegerStatus(fmu, (fmi2StatusKind)below(4), &integer);
    case 3: return fmi2GetBooleanStatus(fmu, (fmi2StatusKind)below(4), &boolean);
    case 4: return fmi2GetStringStatus(fmu, (fmi2StatusKind)below(4), &text);
    default: return fmi2CancelStep(fmu);
  }
}

static const call_t calls[] = {{"fmi2Instantiate", 1, instantiate},
                               {"fmi2SetDebugLogging", 1, set_debug_logging},
                               {"fmi2SetupExperiment", 1, setup},
                               {"fmi2EnterInitializationMode", 2, enter_initialization},
                               {"fmi2ExitInitializationMode", 2, exit_initialization},
                               {"fmi2Terminate", 1, terminate},
                               {"fmi2Reset", 1, reset_any},
                               {"fmi2GetReal", 4, get_real},
                               {"fmi2SetReal", 6, set_real},
                               {"values of other types", 1, other_types},
                               {"fmi2DoStep", 9, do_step},
                               {"fmi2SetRealInputDerivatives", 2, set_input_derivatives},
                               {"fmi2GetRealOutputDerivatives", 1, get_output_derivatives},
                               {"fmi2GetDirectionalDerivative", 2, directional},
                               {"fmi2GetFMUstate", 2, get_state},
                               {"fmi2SetFMUstate", 2, set_state},
                               {"fmi2FreeFMUstate", 1, free_state},
                               {"fmi2SerializeFMUstate", 1, write_bytes},
                               {"fmi2DeSerializeFMUstate", 2, deserialize},
                               {"fmi2NewDiscreteStates", 2, new_discrete_states},
                               {"fmi2EnterEventMode", 1, enter_event},
                               {"fmi2EnterContinuousTimeMode", 2, enter_continuous},
                               {"fmi2SetTime", 2, set_time},
                               {"fmi2CompletedIntegratorStep", 1, completed_step},
                               {"fmi2SetContinuousStates", 2, set_states},
                               {"fmi2GetContinuousStates", 1, get_states},
                               {"fmi2GetDerivatives", 2, get_derivatives},
                               {"fmi2GetEventIndicators", 1, get_indicators},
                               {"fmi2GetStatus", 1, get_status},
                               {NULL, 0, NULL}};
