/* FMI 3.0.2 over component.h. */
#include "fmi.h"

#include "fmi3_types.h"

#define STATUS fmi3Status
#define INSTANCE fmi3Instance
#define REFERENCE fmi3ValueReference
#define REAL fmi3Float64
#define BYTE fmi3Byte
#define BOOLEAN fmi3Boolean
#define FMU_STATE fmi3FMUState
#define PREFIX "fmi3"
#define PASTED(name) fmi3##name
#define FMI(name) PASTED(name)
#define SIZE(c, r)                                                                                 \
  ((long)(r) < (c)->model->n_values ? (unsigned)section((c)->model, D_SIZES)[r] : 0u)
#define OTHER_TOKEN "the instantiation token is another model's"
#include "fmi_both.h"

static void log_text(component_t *c, status_t status, const char *category, const char *text) {
  const instance_t *instance = c->host;
  if (!is_told(instance, status, category)) return;
  ((fmi3LogMessageCallback)instance->log)(instance->environment, (fmi3Status)status, category,
                                          text);
}

FMI_EXPORT const char *fmi3GetVersion(void) { return fmi3Version; }

FMI_EXPORT fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token,
                                                     fmi3String resources, fmi3Boolean visible,
                                                     fmi3Boolean logging,
                                                     fmi3InstanceEnvironment environment,
                                                     fmi3LogMessageCallback log) {
  (void)visible;
  return instantiate(name, token, resources, (void (*)(void))log, environment, logging, 0, NULL);
}

FMI_EXPORT fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
    fmi3Boolean logging, fmi3Boolean event_mode, fmi3Boolean early_return,
    const fmi3ValueReference required[], size_t n_required, fmi3InstanceEnvironment environment,
    fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update) {
  (void)visible, (void)required, (void)n_required, (void)update;
  instance_t *instance =
      instantiate(name, token, resources, (void (*)(void))log, environment, logging, 1, NULL);
  if (!instance) return NULL;
  instance->component.now->uses_events = instance->uses_events = event_mode;
  instance->early_return = early_return;
  return instance;
}

FMI_EXPORT fmi3Instance fmi3InstantiateScheduledExecution(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
    fmi3Boolean logging, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
    fmi3ClockUpdateCallback clock, fmi3LockPreemptionCallback lock,
    fmi3UnlockPreemptionCallback unlock) {
  (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)clock, (void)lock,
      (void)unlock;
  if (log) log(environment, fmi3Error, "logStatusError", "this model has no Scheduled Execution");
  return NULL;
}

/* --- initialization --------------------------------------------------------------------------- */

FMI_EXPORT fmi3Status fmi3EnterConfigurationMode(fmi3Instance instance) {
  BEGIN("fmi3EnterConfigurationMode", INSTANTIATED);
  c->now->phase = CONFIGURATION;
  return fmi3OK;
}

FMI_EXPORT fmi3Status fmi3ExitConfigurationMode(fmi3Instance instance) {
  BEGIN("fmi3ExitConfigurationMode", CONFIGURATION);
  c->now->phase = INSTANTIATED;
  return fmi3OK;
}

FMI_EXPORT fmi3Status fmi3EnterInitializationMode(fmi3Instance instance,
                                                  fmi3Boolean tolerance_defined,
                                                  fmi3Float64 tolerance, fmi3Float64 start_time,
                                                  fmi3Boolean stop_defined, fmi3Float64 stop) {
  BEGIN("fmi3EnterInitializationMode", INSTANTIATED);
  (void)tolerance_defined, (void)tolerance;
  if (check_times(c, start_time, stop_defined, stop)) return fmi3Error;
  c->now->stop_time = stop_defined ? stop : HUGE_VAL;
  enter_initialization(c, start_time);
  return fmi3OK;
}

/* --- values ----------------------------------------------------------------------------------- */

FMI_EXPORT fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference vr[],
                                     size_t count, fmi3Float64 value[], size_t n) {
  BEGIN("fmi3GetFloat64", INSTANTIATED | RUNNING);
  VALUES("fmi3GetFloat64", vr, count, value, n);
  for (size_t k = 0; k < count; k++)
    if (c->now->phase == INSTANTIATED && kind_of(c->model, vr[k]) == CALCULATED)
      REFUSE("fmi3GetFloat64: %s is calculated and has no start value; ask from initialization on",
             c->model->names[vr[k]]);
  return get_all(c, vr, count, value);
}

FMI_EXPORT fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference vr[],
                                     size_t count, const fmi3Float64 value[], size_t n) {
  BEGIN("fmi3SetFloat64", SETTABLE);
  VALUES("fmi3SetFloat64", vr, count, value, n);
  return set_all(c, vr, count, value);
}

/* There are variables of type Float64 only. */
#define NO_FUNCTION(name, phases, ...)                                                             \
  FMI_EXPORT fmi3Status fmi3##name(fmi3Instance instance, const fmi3ValueReference vr[],           \
                                   size_t count, __VA_ARGS__) {                                    \
    BEGIN("fmi3" #name, phases);                                                                   \
    (void)vr, (void)value;                                                                         \
    if (count) REFUSE("fmi3" #name ": there are no variables of this type");                       \
    return fmi3OK;                                                                                 \
  }
#define NO_GETTER(name, ...) NO_FUNCTION(Get##name, RUNNING, __VA_ARGS__)
#define NO_SETTER(name, ...) NO_FUNCTION(Set##name, SETTABLE, __VA_ARGS__)
#define NO_VARIABLES(name, type)                                                                   \
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

FMI_EXPORT fmi3Status fmi3GetNumberOfVariableDependencies(fmi3Instance instance,
                                                          fmi3ValueReference vr, size_t *count) {
  BEGIN("fmi3GetNumberOfVariableDependencies", ANY);
  REFUSE("dependencies are given in the model description only");
}

FMI_EXPORT fmi3Status fmi3GetVariableDependencies(fmi3Instance instance,
                                                  fmi3ValueReference dependent, size_t elements[],
                                                  fmi3ValueReference independents[],
                                                  size_t independent_elements[],
                                                  fmi3DependencyKind of_kind[], size_t count) {
  BEGIN("fmi3GetVariableDependencies", ANY);
  REFUSE("dependencies are given in the model description only");
}

/* --- derivatives ------------------------------------------------------------------------------ */

FMI_EXPORT fmi3Status fmi3GetDirectionalDerivative(fmi3Instance instance,
                                                   const fmi3ValueReference unknowns[],
                                                   size_t n_unknowns,
                                                   const fmi3ValueReference knowns[],
                                                   size_t n_knowns, const fmi3Float64 seed[],
                                                   size_t n_seed, fmi3Float64 value[], size_t n) {
  BEGIN("fmi3GetDirectionalDerivative", RUNNING);
  CHECK_PRODUCTS("fmi3GetDirectionalDerivative", n, n_seed);
  return products(c, 0, knowns, n_knowns, seed, unknowns, n_unknowns, value);
}

FMI_EXPORT fmi3Status fmi3GetAdjointDerivative(fmi3Instance instance,
                                               const fmi3ValueReference unknowns[],
                                               size_t n_unknowns, const fmi3ValueReference knowns[],
                                               size_t n_knowns, const fmi3Float64 seed[],
                                               size_t n_seed, fmi3Float64 value[], size_t n) {
  BEGIN("fmi3GetAdjointDerivative", RUNNING);
  CHECK_PRODUCTS("fmi3GetAdjointDerivative", n_seed, n);
  return products(c, 1, unknowns, n_unknowns, seed, knowns, n_knowns, value);
}

/* --- events ----------------------------------------------------------------------------------- */

FMI_EXPORT fmi3Status fmi3EnterEventMode(fmi3Instance instance) {
  BEGIN("fmi3EnterEventMode", CONTINUOUS | STEP);
  if (c->now->stepping && !c->now->uses_events)
    REFUSE("fmi3EnterEventMode: the instance was made without event mode");
  enter_event_mode(c);
  return fmi3OK;
}

FMI_EXPORT fmi3Status fmi3EvaluateDiscreteStates(fmi3Instance instance) {
  BEGIN("fmi3EvaluateDiscreteStates", INITIALIZATION | EVENT);
  return fmi3OK;
}

FMI_EXPORT fmi3Status fmi3UpdateDiscreteStates(fmi3Instance instance, fmi3Boolean *again,
                                               fmi3Boolean *terminate, fmi3Boolean *nominals,
                                               fmi3Boolean *values, fmi3Boolean *next_defined,
                                               fmi3Float64 *next_time) {
  BEGIN("fmi3UpdateDiscreteStates", EVENT);
  if (!again || !terminate || !nominals || !values || !next_defined || !next_time)
    REFUSE("fmi3UpdateDiscreteStates: a pointer is missing");
  enter_windows(c);
  const double next = c->now->stepping ? next_window(c) : next_edge(c);
  *again = *nominals = 0;
  /* importers restart their solvers on that, and what acts may have jumped */
  *values = take_jump(c) && !c->now->stepping;
  *terminate = c->now->ended && !c->now->stepping;
  *next_defined = next < HUGE_VAL;
  *next_time = next < HUGE_VAL ? next : 0.0;
  return fmi3OK;
}

/* --- Model Exchange --------------------------------------------------------------------------- */

FMI_EXPORT fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance instance, size_t *count) {
  SYSTEM_ONLY("fmi3GetNumberOfEventIndicators", ANY);
  if (!count) REFUSE("fmi3GetNumberOfEventIndicators: a pointer is missing");
  *count = 0;
  return fmi3OK;
}

FMI_EXPORT fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance instance, size_t *count) {
  SYSTEM_ONLY("fmi3GetNumberOfContinuousStates", ANY);
  if (!count) REFUSE("fmi3GetNumberOfContinuousStates: a pointer is missing");
  *count = (size_t)c->model->n_states;
  return fmi3OK;
}

/* --- Co-Simulation ---------------------------------------------------------------------------- */

FMI_EXPORT fmi3Status fmi3EnterStepMode(fmi3Instance instance) {
  STEPPING_ONLY("fmi3EnterStepMode", EVENT);
  c->now->phase = STEP;
  return fmi3OK;
}

FMI_EXPORT fmi3Status fmi3GetOutputDerivatives(fmi3Instance instance, const fmi3ValueReference vr[],
                                               size_t count, const fmi3Int32 orders[],
                                               fmi3Float64 value[], size_t n) {
  STEPPING_ONLY("fmi3GetOutputDerivatives", STEP | TERMINATED);
  if (count) REFUSE("fmi3GetOutputDerivatives: derivatives are outputs of their own, der(...)");
  return fmi3OK;
}

FMI_EXPORT fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 from, fmi3Float64 size,
                                 fmi3Boolean no_return, fmi3Boolean *event, fmi3Boolean *terminate,
                                 fmi3Boolean *early, fmi3Float64 *last_time) {
  BEGIN("fmi3DoStep", STEP);
  const instance_t *own = instance;
  const double target = from + size;
  int edge = 0;
  if (!event || !terminate || !early || !last_time) REFUSE("fmi3DoStep: a pointer is missing");
  *event = *terminate = *early = 0, *last_time = c->now->time;
  if (check_step(c, from, size)) return fmi3Error;
  status_t s = OK;
  do /* across edges where the importer does not let a step end early */
    s = step(c, target, own->uses_events, &edge);
  while (!s && edge && !own->early_return && !reached(c->now->time, target));
  *last_time = c->now->time, *terminate = c->now->ended;
  *event = edge && !s, *early = !s && !reached(c->now->time, target);
  return (fmi3Status)s;
}

FMI_EXPORT fmi3Status fmi3ActivateModelPartition(fmi3Instance instance, fmi3ValueReference clock,
                                                 fmi3Float64 time) {
  BEGIN("fmi3ActivateModelPartition", ANY);
  REFUSE("fmi3ActivateModelPartition: this model has no Scheduled Execution");
}
