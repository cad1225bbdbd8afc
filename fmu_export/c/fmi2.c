/* FMI 2.0.4 over component.h. */
#include "fmi.h"

#include "fmi2_types.h"

#define STATUS fmi2Status
#define INSTANCE fmi2Component
#define REFERENCE fmi2ValueReference
#define REAL fmi2Real
#define BYTE fmi2Byte
#define BOOLEAN fmi2Boolean
#define FMU_STATE fmi2FMUstate
#define PREFIX "fmi2"
#define PASTED(name) fmi2##name
#define FMI(name) PASTED(name)
/* elements are variables; time is none */
#define SIZE(c, r) (unsigned)((r) > 0 && (long)(r) < (c)->model->n_values)
#define OTHER_TOKEN "the GUID is another model's"
/* names that FMI 3 writes otherwise */
#define GetFMUState GetFMUstate
#define SetFMUState SetFMUstate
#define FreeFMUState FreeFMUstate
#define SerializedFMUStateSize SerializedFMUstateSize
#define SerializeFMUState SerializeFMUstate
#define DeserializeFMUState DeSerializeFMUstate
#define GetContinuousStateDerivatives GetDerivatives
#include "fmi_both.h"

/* The logger takes a format. Many importers print it as it is, and would print nothing but "%s" if
   that were it; so the text itself is the format, every percent sign in it doubled. */
static void log_text(component_t *c, status_t status, const char *category, const char *text) {
  const instance_t *instance = c->host;
  char format[1100], *to = format;
  if (!is_told(instance, status, category)) return;
  for (; *text && to < format + sizeof format - 2; text++) {
    *to++ = *text;
    if (*text == '%') *to++ = '%';
  }
  *to = 0;
  ((fmi2CallbackLogger)instance->log)(instance->environment, instance->name, (fmi2Status)status,
                                      category, format);
}

FMI_EXPORT const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }

FMI_EXPORT const char *fmi2GetVersion(void) { return fmi2Version; }

FMI_EXPORT fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid,
                                         fmi2String location,
                                         const fmi2CallbackFunctions *functions,
                                         fmi2Boolean visible, fmi2Boolean logging) {
  (void)visible;
  if (!functions) return NULL;
  return instantiate(name, guid, location, (void (*)(void))functions->logger,
                     functions->componentEnvironment, logging != fmi2False,
                     type == fmi2CoSimulation,
                     type != fmi2CoSimulation && type != fmi2ModelExchange ? "unknown type" : NULL);
}

/* --- initialization --------------------------------------------------------------------------- */

FMI_EXPORT fmi2Status fmi2SetupExperiment(fmi2Component instance, fmi2Boolean tolerance_defined,
                                          fmi2Real tolerance, fmi2Real start_time,
                                          fmi2Boolean stop_defined, fmi2Real stop) {
  BEGIN("fmi2SetupExperiment", INSTANTIATED);
  (void)tolerance_defined, (void)tolerance;
  if (check_times(c, start_time, stop_defined, stop)) return fmi2Error;
  set_time(c, start_time);
  c->now->stop_time = stop_defined ? stop : HUGE_VAL;
  return fmi2OK;
}

FMI_EXPORT fmi2Status fmi2EnterInitializationMode(fmi2Component instance) {
  BEGIN("fmi2EnterInitializationMode", INSTANTIATED);
  enter_initialization(c, c->now->time);
  return fmi2OK;
}

/* --- values ----------------------------------------------------------------------------------- */

FMI_EXPORT fmi2Status fmi2GetReal(fmi2Component instance, const fmi2ValueReference vr[],
                                  size_t count, fmi2Real value[]) {
  BEGIN("fmi2GetReal", RUNNING);
  VALUES("fmi2GetReal", vr, count, value, count);
  return get_all(c, vr, count, value);
}

FMI_EXPORT fmi2Status fmi2SetReal(fmi2Component instance, const fmi2ValueReference vr[],
                                  size_t count, const fmi2Real value[]) {
  BEGIN("fmi2SetReal", SETTABLE);
  VALUES("fmi2SetReal", vr, count, value, count);
  return set_all(c, vr, count, value);
}

/* There are variables of type Real only. */
#define NO_FUNCTION(name, phases, type)                                                            \
  FMI_EXPORT fmi2Status fmi2##name(fmi2Component instance, const fmi2ValueReference vr[],          \
                                   size_t count, type value[]) {                                   \
    BEGIN("fmi2" #name, phases);                                                                   \
    (void)vr, (void)value;                                                                         \
    if (count) REFUSE("fmi2" #name ": there are no variables of this type");                       \
    return fmi2OK;                                                                                 \
  }
#define NO_VARIABLES(name, type)                                                                   \
  NO_FUNCTION(Get##name, RUNNING, type) NO_FUNCTION(Set##name, SETTABLE, const type)

NO_VARIABLES(Integer, fmi2Integer)
NO_VARIABLES(Boolean, fmi2Boolean)
NO_VARIABLES(String, fmi2String)

FMI_EXPORT fmi2Status fmi2GetDirectionalDerivative(
    fmi2Component instance, const fmi2ValueReference unknowns[], size_t n_unknowns,
    const fmi2ValueReference knowns[], size_t n_knowns, const fmi2Real seed[], fmi2Real value[]) {
  BEGIN("fmi2GetDirectionalDerivative", RUNNING);
  CHECK_PRODUCTS("fmi2GetDirectionalDerivative", n_unknowns, n_knowns);
  return products(c, 0, knowns, n_knowns, seed, unknowns, n_unknowns, value);
}

/* --- Model Exchange --------------------------------------------------------------------------- */

FMI_EXPORT fmi2Status fmi2EnterEventMode(fmi2Component instance) {
  BEGIN("fmi2EnterEventMode", EVENT | CONTINUOUS);
  enter_event_mode(c);
  return fmi2OK;
}

FMI_EXPORT fmi2Status fmi2NewDiscreteStates(fmi2Component instance, fmi2EventInfo *info) {
  BEGIN("fmi2NewDiscreteStates", EVENT);
  if (!info) REFUSE("fmi2NewDiscreteStates: a pointer is missing");
  enter_windows(c);
  const double next = next_edge(c);
  const int jumped = take_jump(c);
  /* importers restart their solvers on that, and what acts may have jumped */
  *info = (fmi2EventInfo){.valuesOfContinuousStatesChanged = jumped,
                          .terminateSimulation = c->now->ended && !c->now->stepping,
                          .nextEventTimeDefined = next < HUGE_VAL,
                          .nextEventTime = next < HUGE_VAL ? next : 0.0};
  return fmi2OK;
}

/* --- Co-Simulation ---------------------------------------------------------------------------- */

FMI_EXPORT fmi2Status fmi2SetRealInputDerivatives(fmi2Component instance,
                                                  const fmi2ValueReference vr[], size_t count,
                                                  const fmi2Integer order[],
                                                  const fmi2Real value[]) {
  STEPPING_ONLY("fmi2SetRealInputDerivatives", INSTANTIATED | INITIALIZATION | STEP);
  (void)vr, (void)order, (void)value;
  if (count)
    REFUSE("fmi2SetRealInputDerivatives: inputs are held during a step; make shorter steps");
  return fmi2OK;
}

FMI_EXPORT fmi2Status fmi2GetRealOutputDerivatives(fmi2Component instance,
                                                   const fmi2ValueReference vr[], size_t count,
                                                   const fmi2Integer order[], fmi2Real value[]) {
  STEPPING_ONLY("fmi2GetRealOutputDerivatives", STEP | TERMINATED);
  (void)vr, (void)order, (void)value;
  if (count) REFUSE("fmi2GetRealOutputDerivatives: derivatives are outputs of their own, der(...)");
  return fmi2OK;
}

FMI_EXPORT fmi2Status fmi2DoStep(fmi2Component instance, fmi2Real from, fmi2Real size,
                                 fmi2Boolean no_return) {
  BEGIN("fmi2DoStep", STEP);
  (void)no_return;
  int edge;
  if (check_step(c, from, size)) return fmi2Error;
  return (fmi2Status)step(c, from + size, 0, &edge);
}

FMI_EXPORT fmi2Status fmi2CancelStep(fmi2Component instance) {
  BEGIN("fmi2CancelStep", ANY);
  REFUSE("fmi2CancelStep: no step is under way");
}

/* What is asked of a step that is over; only `known`, if any, has a value. */
#define STATUS_OF_STEP(name, type, known, found, words)                                            \
  FMI_EXPORT fmi2Status fmi2##name(fmi2Component instance, const fmi2StatusKind kind,              \
                                   type *value) {                                                  \
    STEPPING_ONLY("fmi2" #name, STEP | TERMINATED);                                                \
    (void)kind;                                                                                    \
    if (!(known) || !value) return (fmi2Status)report(c, DISCARD, "logStatusDiscard", words);      \
    *value = found;                                                                                \
    return fmi2OK;                                                                                 \
  }
STATUS_OF_STEP(GetStatus, fmi2Status, 0, fmi2OK, "steps are never asynchronous")
STATUS_OF_STEP(GetRealStatus, fmi2Real, kind == fmi2LastSuccessfulTime, c->now->time,
               "only the last successful time is known")
STATUS_OF_STEP(GetIntegerStatus, fmi2Integer, 0, 0, "there is no such status")
STATUS_OF_STEP(GetBooleanStatus, fmi2Boolean, kind == fmi2Terminated, c->now->ended != 0,
               "there is no such status")
STATUS_OF_STEP(GetStringStatus, fmi2String, 0, NULL, "there is no such status")
