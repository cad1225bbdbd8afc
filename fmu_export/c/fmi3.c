/* FMI 3.0.2 over component.h. */
#include "fmi.h"

#include "fmi3Functions.h"

#define STATUS fmi3Status

static void log_text(component_t *c, status_t status, const char *category, const char *text) {
  const instance_t *instance = c->host;
  if (!is_told(instance, status, category)) return;
  ((fmi3LogMessageCallback)instance->log)(instance->environment, (fmi3Status)status, category,
                                          text);
}

const char *fmi3GetVersion(void) { return fmi3Version; }

static instance_t *instantiate(fmi3String name, fmi3String token, fmi3Boolean logging,
                               fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                               int stepping) {
  instance_t *instance = calloc(1, sizeof *instance);
  if (!instance) return NULL;
  component_t *c = &instance->component;
  c->report = log_text, c->host = instance;
  instance->log = (void (*)(void))log, instance->environment = environment;
  const char *wrong = !name || !*name ? "the instance has no name"
                      : !token || strcmp(token, model_token)
                          ? "the instantiation token is another model's"
                          : NULL;
  if (wrong) {
    report(c, FAILED, "logStatusError", "fmi3Instantiate: %s", wrong);
    free(instance);
    return NULL;
  }
  for (int k = 0; k < CATEGORIES; k++) instance->logging[k] = logging;
  reset(c, stepping);
  return instance;
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources,
                                          fmi3Boolean visible, fmi3Boolean logging,
                                          fmi3InstanceEnvironment environment,
                                          fmi3LogMessageCallback log) {
  (void)resources, (void)visible;
  return instantiate(name, token, logging, environment, log, 0);
}

fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
    fmi3Boolean logging, fmi3Boolean event_mode, fmi3Boolean early_return,
    const fmi3ValueReference required[], size_t n_required, fmi3InstanceEnvironment environment,
    fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update) {
  (void)resources, (void)visible, (void)required, (void)n_required;
  instance_t *instance = instantiate(name, token, logging, environment, log, 1);
  if (!instance) return NULL;
  instance->component.now.uses_events = instance->uses_events = event_mode;
  instance->early_return = early_return, instance->update = (void (*)(void))update;
  return instance;
}

fmi3Instance fmi3InstantiateScheduledExecution(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
    fmi3Boolean logging, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
    fmi3ClockUpdateCallback clock, fmi3LockPreemptionCallback lock,
    fmi3UnlockPreemptionCallback unlock) {
  (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)clock, (void)lock,
      (void)unlock;
  if (log)
    log(environment, fmi3Error, "logStatusError", "this model has no Scheduled Execution");
  return NULL;
}

void fmi3FreeInstance(fmi3Instance instance) { free(instance); }

fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean on, size_t count,
                               const fmi3String categories[]) {
  BEGIN("fmi3SetDebugLogging", ANY);
  return (fmi3Status)set_logging(instance, "fmi3SetDebugLogging", on, count, categories);
}

/* --- initialization --------------------------------------------------------------------------- */

fmi3Status fmi3EnterConfigurationMode(fmi3Instance instance) {
  BEGIN("fmi3EnterConfigurationMode", INSTANTIATED);
  c->now.phase = CONFIGURATION;
  return fmi3OK;
}

fmi3Status fmi3ExitConfigurationMode(fmi3Instance instance) {
  BEGIN("fmi3ExitConfigurationMode", CONFIGURATION);
  c->now.phase = INSTANTIATED;
  return fmi3OK;
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean tolerance_defined,
                                       fmi3Float64 tolerance, fmi3Float64 start_time,
                                       fmi3Boolean stop_defined, fmi3Float64 stop) {
  BEGIN("fmi3EnterInitializationMode", INSTANTIATED);
  (void)tolerance_defined, (void)tolerance;
  if (check_times(c, start_time, stop_defined, stop)) return fmi3Error;
  c->now.stop_time = stop_defined ? stop : HUGE_VAL;
  enter_initialization(c, start_time);
  return fmi3OK;
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance instance) {
  BEGIN("fmi3ExitInitializationMode", INITIALIZATION);
  if (start(c)) return fmi3Error;
  c->now.phase = c->now.stepping && !c->now.uses_events ? STEP : EVENT;
  return fmi3OK;
}

fmi3Status fmi3Terminate(fmi3Instance instance) {
  BEGIN("fmi3Terminate", EVENT | CONTINUOUS | STEP);
  c->now.phase = TERMINATED;
  return fmi3OK;
}

fmi3Status fmi3Reset(fmi3Instance instance) {
  BEGIN("fmi3Reset", ANY);
  reset(c, c->now.stepping);
  c->now.uses_events = ((instance_t *)instance)->uses_events;
  return fmi3OK;
}

/* --- values ----------------------------------------------------------------------------------- */

/* Number of values behind references, or -1 where one is unknown, with a log line. */
static long total(component_t *c, const char *function, const fmi3ValueReference vr[],
                  size_t count) {
  long sum = 0;
  for (size_t k = 0; k < count; k++) {
    if (vr[k] >= N_VALUES || !sizes[vr[k]]) {
      report(c, FAILED, "logStatusError", "%s: " NO_SUCH, function, vr[k]);
      return -1;
    }
    sum += sizes[vr[k]];
  }
  return sum;
}

/* Refuses unknown references and another number of values than theirs. */
#define COUNTED(function, vr, count, n)                                                           \
  do {                                                                                            \
    const long all = total(c, function, vr, count);                                               \
    if (all < 0) return fmi3Error;                                                                \
    if ((size_t)all != (n))                                                                       \
      REFUSE(function ": room for %lu values, but the variables have %ld", (unsigned long)(n),    \
             all);                                                                                \
  } while (0)

#define VALUES(function, vr, count, value, n)                                                     \
  if ((count) && (!(vr) || !(value))) REFUSE(function ": a pointer is missing");                  \
  COUNTED(function, vr, count, n)

fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference vr[], size_t count,
                          fmi3Float64 value[], size_t n) {
  BEGIN("fmi3GetFloat64", INSTANTIATED | RUNNING | INTERMEDIATE);
  VALUES("fmi3GetFloat64", vr, count, value, n);
  for (size_t k = 0; k < count; k++)
    if (c->now.phase == INSTANTIATED && kinds[vr[k]] == CALCULATED)
      REFUSE("fmi3GetFloat64: %s is calculated and has no start value; ask from initialization on",
             names[vr[k]]);
  status_t worst = OK;
  for (size_t k = 0; k < count; value += sizes[vr[k++]]) {
    status_t s = get_values(c, vr[k], sizes[vr[k]], value);
    worst = s > worst ? s : worst;
  }
  return (fmi3Status)worst;
}

fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference vr[], size_t count,
                          const fmi3Float64 value[], size_t n) {
  BEGIN("fmi3SetFloat64",
        INSTANTIATED | CONFIGURATION | INITIALIZATION | EVENT | CONTINUOUS | STEP);
  VALUES("fmi3SetFloat64", vr, count, value, n);
  const fmi3Float64 *next = value;
  for (size_t k = 0; k < count; k++) /* all are set, or none */
    for (unsigned j = 0; j < sizes[vr[k]]; j++) {
      const status_t wrong = check_one(c, vr[k] + j, *next++);
      if (wrong) return (fmi3Status)wrong;
    }
  for (size_t k = 0; k < count; k++)
    for (unsigned j = 0; j < sizes[vr[k]]; j++) set_value(c, vr[k] + j, *value++);
  return fmi3OK;
}

/* There are variables of type Float64 only. */
#define NO_GETTER(name, ...)                                                                      \
  fmi3Status fmi3Get##name(fmi3Instance instance, const fmi3ValueReference vr[], size_t count,    \
                           __VA_ARGS__) {                                                         \
    BEGIN("fmi3Get" #name, RUNNING | INTERMEDIATE);                                               \
    (void)vr, (void)value;                                                                        \
    if (count) REFUSE("fmi3Get" #name ": there are no variables of this type");                   \
    return fmi3OK;                                                                                \
  }
#define NO_SETTER(name, ...)                                                                      \
  fmi3Status fmi3Set##name(fmi3Instance instance, const fmi3ValueReference vr[], size_t count,    \
                           __VA_ARGS__) {                                                         \
    BEGIN("fmi3Set" #name,                                                                        \
          INSTANTIATED | CONFIGURATION | INITIALIZATION | EVENT | CONTINUOUS | STEP);             \
    (void)vr, (void)value;                                                                        \
    if (count) REFUSE("fmi3Set" #name ": there are no variables of this type");                   \
    return fmi3OK;                                                                                \
  }
#define NO_VARIABLES(name, type)                                                                  \
  NO_GETTER(name, type value[], size_t n) NO_SETTER(name, const type value[], size_t n)

#if defined(__GNUC__)
#pragma GCC diagnostic ignored "-Wunused-parameter" /* the standard's signatures, from here on */
#endif
NO_VARIABLES(Float32, fmi3Float32)
NO_VARIABLES(Int8, fmi3Int8)
NO_VARIABLES(UInt8, fmi3UInt8)
NO_VARIABLES(Int16, fmi3Int16)
NO_VARIABLES(UInt16, fmi3UInt16)
NO_VARIABLES(Int32, fmi3Int32)
NO_VARIABLES(UInt32, fmi3UInt32)
NO_VARIABLES(Int64, fmi3Int64)
NO_VARIABLES(UInt64, fmi3UInt64)
NO_VARIABLES(Boolean, fmi3Boolean)
NO_VARIABLES(String, fmi3String)
NO_GETTER(Binary, size_t value_sizes[], fmi3Binary value[], size_t n)
NO_SETTER(Binary, const size_t value_sizes[], const fmi3Binary value[], size_t n)
NO_GETTER(Clock, fmi3Clock value[])
NO_SETTER(Clock, const fmi3Clock value[])
NO_GETTER(IntervalDecimal, fmi3Float64 value[], fmi3IntervalQualifier qualifiers[])
NO_GETTER(IntervalFraction, fmi3UInt64 value[], fmi3UInt64 resolutions[],
          fmi3IntervalQualifier qualifiers[])
NO_GETTER(ShiftDecimal, fmi3Float64 value[])
NO_GETTER(ShiftFraction, fmi3UInt64 value[], fmi3UInt64 resolutions[])
NO_SETTER(IntervalDecimal, const fmi3Float64 value[])
NO_SETTER(IntervalFraction, const fmi3UInt64 value[], const fmi3UInt64 resolutions[])
NO_SETTER(ShiftDecimal, const fmi3Float64 value[])
NO_SETTER(ShiftFraction, const fmi3UInt64 value[], const fmi3UInt64 resolutions[])

fmi3Status fmi3GetNumberOfVariableDependencies(fmi3Instance instance, fmi3ValueReference vr,
                                               size_t *count) {
  BEGIN("fmi3GetNumberOfVariableDependencies", ANY);
  REFUSE("dependencies are given in the model description only");
}

fmi3Status fmi3GetVariableDependencies(fmi3Instance instance, fmi3ValueReference dependent,
                                       size_t elements[], fmi3ValueReference independents[],
                                       size_t independent_elements[], fmi3DependencyKind of_kind[],
                                       size_t count) {
  BEGIN("fmi3GetVariableDependencies", ANY);
  REFUSE("dependencies are given in the model description only");
}

/* --- derivatives ------------------------------------------------------------------------------ */

static int is_unknown(fmi3ValueReference r) { return kinds[r] == CALCULATED || kinds[r] == EXACT; }
static int is_known(fmi3ValueReference r) { return kinds[r] != CALCULATED; }

/* Both directions: seeds go to the references `from`, products come from the references `to`. */
static status_t products(component_t *c, void (*apply)(component_t *),
                         const fmi3ValueReference from[], size_t n_from, const fmi3Float64 seed[],
                         const fmi3ValueReference to[], size_t n_to, fmi3Float64 value[]) {
  memset(c->seed, 0, sizeof c->seed);
  for (size_t k = 0; k < n_from; k++)
    for (unsigned j = 0; j < sizes[from[k]]; j++) c->seed[from[k] + j] += *seed++;
  apply(c);
  for (size_t k = 0; k < n_to; value += sizes[to[k++]]) {
    const status_t s = check_grown(c, to[k], sizes[to[k]]);
    if (s) return s;
    memcpy(value, c->grown + to[k], sizes[to[k]] * sizeof *value);
  }
  return OK;
}

#define CHECK_PRODUCTS(function, n_from, n_to)                                                    \
  if ((n_unknowns && !unknowns) || (n_knowns && !knowns) || !seed || !value)                      \
    REFUSE(function ": a pointer is missing");                                                    \
  COUNTED(function, unknowns, n_unknowns, n_from);                                                \
  COUNTED(function, knowns, n_knowns, n_to);                                                      \
  for (size_t k = 0; k < n_unknowns; k++)                                                         \
    if (!is_unknown(unknowns[k]))                                                                 \
      REFUSE(function ": %s is not an unknown; give states or calculated variables",              \
             names[unknowns[k]]);                                                                 \
  for (size_t k = 0; k < n_knowns; k++)                                                           \
    if (!is_known(knowns[k]))                                                                     \
      REFUSE(function ": %s is not a known; give inputs, states or parameters", names[knowns[k]])

fmi3Status fmi3GetDirectionalDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[],
                                        size_t n_unknowns, const fmi3ValueReference knowns[],
                                        size_t n_knowns, const fmi3Float64 seed[], size_t n_seed,
                                        fmi3Float64 value[], size_t n) {
  BEGIN("fmi3GetDirectionalDerivative", RUNNING | INTERMEDIATE);
  CHECK_PRODUCTS("fmi3GetDirectionalDerivative", n, n_seed);
  return (fmi3Status)products(c, forward, knowns, n_knowns, seed, unknowns, n_unknowns, value);
}

fmi3Status fmi3GetAdjointDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[],
                                    size_t n_unknowns, const fmi3ValueReference knowns[],
                                    size_t n_knowns, const fmi3Float64 seed[], size_t n_seed,
                                    fmi3Float64 value[], size_t n) {
  BEGIN("fmi3GetAdjointDerivative", RUNNING | INTERMEDIATE);
  CHECK_PRODUCTS("fmi3GetAdjointDerivative", n_seed, n);
  return (fmi3Status)products(c, reverse, unknowns, n_unknowns, seed, knowns, n_knowns, value);
}

/* --- FMU states ------------------------------------------------------------------------------- */

fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *state) {
  BEGIN("fmi3GetFMUState", ANY);
  if (!state || (*state && !saved(c, *state))) REFUSE("fmi3GetFMUState: a pointer is missing");
  return (fmi3Status)save(c, state);
}

fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState state) {
  BEGIN("fmi3SetFMUState", ANY);
  return (fmi3Status)restore_saved(c, state);
}

fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *state) {
  BEGIN("fmi3FreeFMUState", ANY);
  if (!state || !*state) return fmi3OK;
  if (!saved(c, *state)) return fmi3Error;
  free(*state);
  *state = NULL;
  return fmi3OK;
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState state, size_t *size) {
  BEGIN("fmi3SerializedFMUStateSize", ANY);
  if (!size) REFUSE("fmi3SerializedFMUStateSize: a pointer is missing");
  if (!saved(c, state)) return fmi3Error;
  *size = STATE_BYTES;
  return fmi3OK;
}

fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState state, fmi3Byte bytes[],
                                 size_t size) {
  BEGIN("fmi3SerializeFMUState", ANY);
  const saved_t *s = saved(c, state);
  if (!s) return fmi3Error;
  if (!bytes || size < STATE_BYTES) REFUSE("fmi3SerializeFMUState: the buffer is missing or too small");
  write_state(&s->memory, bytes);
  return fmi3OK;
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const fmi3Byte bytes[], size_t size,
                                   fmi3FMUState *state) {
  BEGIN("fmi3DeserializeFMUState", ANY);
  if (!state) REFUSE("fmi3DeserializeFMUState: a pointer is missing");
  return (fmi3Status)read_bytes(c, bytes, size, state);
}

/* --- events ----------------------------------------------------------------------------------- */

fmi3Status fmi3EnterEventMode(fmi3Instance instance) {
  BEGIN("fmi3EnterEventMode", CONTINUOUS | STEP);
  if (c->now.stepping && !c->now.uses_events)
    REFUSE("fmi3EnterEventMode: the instance was made without event mode");
  enter_event_mode(c);
  return fmi3OK;
}

fmi3Status fmi3EvaluateDiscreteStates(fmi3Instance instance) {
  BEGIN("fmi3EvaluateDiscreteStates", INITIALIZATION | EVENT);
  return fmi3OK;
}

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance instance, fmi3Boolean *again,
                                    fmi3Boolean *terminate,
                                    fmi3Boolean *nominals, fmi3Boolean *values,
                                    fmi3Boolean *next_defined, fmi3Float64 *next_time) {
  BEGIN("fmi3UpdateDiscreteStates", EVENT);
  if (!again || !terminate || !nominals || !values || !next_defined || !next_time)
    REFUSE("fmi3UpdateDiscreteStates: a pointer is missing");
  enter_windows(c);
  const double next = c->now.stepping ? next_window(&c->now) : next_edge(&c->now);
  *again = *nominals = *values = fmi3False;
  *terminate = c->now.ended && !c->now.stepping;
  *next_defined = next < HUGE_VAL;
  *next_time = next < HUGE_VAL ? next : 0.0;
  return fmi3OK;
}

/* --- Model Exchange --------------------------------------------------------------------------- */

fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance instance) {
  SYSTEM_ONLY("fmi3EnterContinuousTimeMode", EVENT);
  c->now.phase = CONTINUOUS;
  return fmi3OK;
}

fmi3Status fmi3CompletedIntegratorStep(fmi3Instance instance, fmi3Boolean no_return,
                                       fmi3Boolean *enter_event_mode, fmi3Boolean *terminate) {
  SYSTEM_ONLY("fmi3CompletedIntegratorStep", CONTINUOUS);
  if (!enter_event_mode || !terminate) REFUSE("fmi3CompletedIntegratorStep: a pointer is missing");
  *enter_event_mode = *terminate = fmi3False;
  return fmi3OK;
}

fmi3Status fmi3SetTime(fmi3Instance instance, fmi3Float64 time) {
  SYSTEM_ONLY("fmi3SetTime", EVENT | CONTINUOUS);
  if (!(fabs(time) < 1e300)) REFUSE("fmi3SetTime: t = %g s is refused", time);
  set_time(c, time);
  return fmi3OK;
}

fmi3Status fmi3SetContinuousStates(fmi3Instance instance, const fmi3Float64 x[], size_t count) {
  SYSTEM_ONLY("fmi3SetContinuousStates", EVENT | CONTINUOUS);
  OF_SIZE("fmi3SetContinuousStates", x, count, SYSTEM_STATES * N_CONTACTS);
  return (fmi3Status)set_states(c, x);
}

fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance instance, fmi3Float64 rate[],
                                             size_t count) {
  SYSTEM_ONLY("fmi3GetContinuousStateDerivatives", ME_RUNNING);
  OF_SIZE("fmi3GetContinuousStateDerivatives", rate, count, SYSTEM_STATES * N_CONTACTS);
  return (fmi3Status)get_rates(c, rate);
}

fmi3Status fmi3GetEventIndicators(fmi3Instance instance, fmi3Float64 indicator[], size_t count) {
  SYSTEM_ONLY("fmi3GetEventIndicators", ME_RUNNING);
  if (count) REFUSE("fmi3GetEventIndicators: there are none");
  return fmi3OK;
}

fmi3Status fmi3GetContinuousStates(fmi3Instance instance, fmi3Float64 x[], size_t count) {
  SYSTEM_ONLY("fmi3GetContinuousStates", ME_RUNNING);
  OF_SIZE("fmi3GetContinuousStates", x, count, SYSTEM_STATES * N_CONTACTS);
  return (fmi3Status)get_states(c, x);
}

fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance instance, fmi3Float64 nominal[],
                                             size_t count) {
  SYSTEM_ONLY("fmi3GetNominalsOfContinuousStates", ANY);
  OF_SIZE("fmi3GetNominalsOfContinuousStates", nominal, count, SYSTEM_STATES * N_CONTACTS);
  memcpy(nominal, nominals, sizeof nominals);
  return fmi3OK;
}

fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance instance, size_t *count) {
  SYSTEM_ONLY("fmi3GetNumberOfEventIndicators", ANY);
  if (!count) REFUSE("fmi3GetNumberOfEventIndicators: a pointer is missing");
  *count = 0;
  return fmi3OK;
}

fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance instance, size_t *count) {
  SYSTEM_ONLY("fmi3GetNumberOfContinuousStates", ANY);
  if (!count) REFUSE("fmi3GetNumberOfContinuousStates: a pointer is missing");
  *count = SYSTEM_STATES * N_CONTACTS;
  return fmi3OK;
}

/* --- Co-Simulation ---------------------------------------------------------------------------- */

fmi3Status fmi3EnterStepMode(fmi3Instance instance) {
  STEPPING_ONLY("fmi3EnterStepMode", EVENT);
  c->now.phase = STEP;
  return fmi3OK;
}

fmi3Status fmi3GetOutputDerivatives(fmi3Instance instance, const fmi3ValueReference vr[],
                                    size_t count,
                                    const fmi3Int32 orders[], fmi3Float64 value[], size_t n) {
  STEPPING_ONLY("fmi3GetOutputDerivatives", STEP | TERMINATED | INTERMEDIATE);
  if (count) REFUSE("fmi3GetOutputDerivatives: derivatives are outputs of their own, der(...)");
  return fmi3OK;
}

/* Tells the importer of an internal step; returns until when to go on, `target` at most. */
static double told(component_t *c, double target) {
  const instance_t *instance = c->host;
  fmi3Boolean wants = fmi3False;
  fmi3Float64 when = c->now.time;
  if (!instance->update) return target;
  c->now.phase = INTERMEDIATE;
  ((fmi3IntermediateUpdateCallback)instance->update)(instance->environment, c->now.time, fmi3False,
                                                     fmi3True, fmi3True, instance->early_return,
                                                     &wants, &when);
  c->now.phase = STEP;
  return instance->early_return && wants && when < target ? fmax(when, c->now.time) : target;
}

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 from, fmi3Float64 size,
                      fmi3Boolean no_return,
                      fmi3Boolean *event, fmi3Boolean *terminate, fmi3Boolean *early,
                      fmi3Float64 *last_time) {
  BEGIN("fmi3DoStep", STEP);
  const instance_t *own = instance;
  const double target = from + size;
  double until = target;
  int edge = 0, back = 0;
  if (!event || !terminate || !early || !last_time) REFUSE("fmi3DoStep: a pointer is missing");
  *event = *terminate = *early = fmi3False, *last_time = c->now.time;
  if (check_step(c, from, size)) return fmi3Error;
  while (c->now.time < until && !back) {
    const double before = c->now.time;
    status_t s = step(c, until, 1, &edge);
    *last_time = c->now.time;
    *terminate = c->now.ended;
    if (s) return (fmi3Status)s;
    if (edge)
      report(c, OK, "logEvents", "a disturbance window begins or ends at t = %.17g s", c->now.time);
    until = told(c, until);
    back = (edge && c->now.uses_events && (own->early_return || reached(c->now.time, until))) ||
           c->now.time <= before;
  }
  *event = edge && c->now.uses_events;
  *early = !reached(c->now.time, target);
  if (edge && !*event) enter_windows(c);
  return fmi3OK;
}

fmi3Status fmi3ActivateModelPartition(fmi3Instance instance, fmi3ValueReference clock,
                                      fmi3Float64 time) {
  BEGIN("fmi3ActivateModelPartition", ANY);
  REFUSE("fmi3ActivateModelPartition: this model has no Scheduled Execution");
}
