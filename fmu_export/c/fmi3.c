/* FMI 3.0.2 over component.h. */
#ifdef SCENE_INSIDE /* compiled by an importer, whose headers name the functions */
#include "fmi3Functions.h"
#else
#include <stdint.h>
typedef enum { fmi3OK, fmi3Warning, fmi3Discard, fmi3Error } fmi3Status;
typedef int fmi3DependencyKind, fmi3IntervalQualifier; /* enumerations, of which none is used */
typedef void (*fmi3LogMessageCallback)(void *, fmi3Status, const char *, const char *);
typedef void (*fmi3IntermediateUpdateCallback)(void), (*fmi3ClockUpdateCallback)(void),
    (*fmi3LockPreemptionCallback)(void), (*fmi3UnlockPreemptionCallback)(void);
#endif
#define FMI(name) PASTED(fmi3, name)
#define status_t fmi3Status
#define OK fmi3OK
#define DISCARD fmi3Discard
#define FAILED fmi3Error
#define logger_t fmi3LogMessageCallback
#define BYTE uint8_t
#define BOOLEAN _Bool
#define ROOM(n) , size_t n
#define ROOM_OF(count, n) (n)
#define GETTABLE ANY
#define TOKEN "instantiation token"
#define GetReal GetFloat64 /* as FMI 2 calls it */
#define SetReal SetFloat64
#include "fmi.h"

static void log_text(component_t *c, status_t status, const char *text) {
  c->log(c->environment, status, category_of[status], text);
}

EXPORT const char *FMI(GetVersion)(void) { return "3.0"; }

EXPORT void *FMI(InstantiateModelExchange)(const char *name, const char *token,
                                           const char *resources, _Bool visible, _Bool logging,
                                           void *environment, fmi3LogMessageCallback log) {
  return instantiate(__func__, name, token, resources, log, environment, 0);
}

EXPORT void *FMI(InstantiateCoSimulation)(const char *name, const char *token,
                                          const char *resources, _Bool visible, _Bool logging,
                                          _Bool event_mode, _Bool early_return,
                                          const unsigned required[], size_t n_required,
                                          void *environment, fmi3LogMessageCallback log,
                                          fmi3IntermediateUpdateCallback intermediate) {
  component_t *c = instantiate(__func__, name, token, resources, log, environment, 1);
  if (c) c->uses_events = event_mode, c->early_return = early_return;
  return c;
}

EXPORT void *FMI(InstantiateScheduledExecution)(const char *name, const char *token,
                                                const char *resources, _Bool visible, _Bool logging,
                                                void *environment, fmi3LogMessageCallback log,
                                                fmi3ClockUpdateCallback clock,
                                                fmi3LockPreemptionCallback lock,
                                                fmi3UnlockPreemptionCallback unlock) {
  if (log) log(environment, FAILED, category_of[FAILED], "this model has no Scheduled Execution");
  return NULL;
}

/* --- initialization --------------------------------------------------------------------------- */

NOT_THERE(EnterConfigurationMode, "there are no structural parameters", void *instance)
NOT_THERE(ExitConfigurationMode, "there are no structural parameters", void *instance)

EXPORT status_t FMI(EnterInitializationMode)(void *instance, _Bool tolerance_defined,
                                             double tolerance, double start_time,
                                             _Bool stop_defined, double stop) {
  BEGIN(INSTANTIATED);
  if (set_times(c, start_time, stop_defined, stop)) return FAILED;
  return enter_mode(c, INITIALIZATION);
}

/* --- values ----------------------------------------------------------------------------------- */

NO_VARIABLES(Float32, float)
NO_VARIABLES(Int8, int8_t)
NO_VARIABLES(UInt8, uint8_t)
NO_VARIABLES(Int16, int16_t)
NO_VARIABLES(UInt16, uint16_t)
NO_VARIABLES(Int32, int32_t)
NO_VARIABLES(UInt32, uint32_t)
NO_VARIABLES(Int64, int64_t)
NO_VARIABLES(UInt64, uint64_t)
NO_VARIABLES(Boolean, _Bool)
NO_VARIABLES(String, const char *)
NO_GETTER(Binary, size_t value_sizes[], const uint8_t *value[], size_t n)
NO_SETTER(Binary, const size_t value_sizes[], const uint8_t *const value[], size_t n)
NO_GETTER(Clock, _Bool value[])
NO_SETTER(Clock, const _Bool value[])
NO_GETTER(IntervalDecimal, double interval[], fmi3IntervalQualifier qualifiers[])
NO_GETTER(IntervalFraction, uint64_t counter[], uint64_t resolutions[],
          fmi3IntervalQualifier qualifiers[])
NO_GETTER(ShiftDecimal, double shift[])
NO_GETTER(ShiftFraction, uint64_t counter[], uint64_t resolutions[])
NO_SETTER(IntervalDecimal, const double interval[])
NO_SETTER(IntervalFraction, const uint64_t counter[], const uint64_t resolutions[])
NO_SETTER(ShiftDecimal, const double shift[])
NO_SETTER(ShiftFraction, const uint64_t counter[], const uint64_t resolutions[])

NOT_THERE(GetNumberOfVariableDependencies, "dependencies are given in the model description only",
          void *instance, unsigned vr, size_t *count)
NOT_THERE(GetVariableDependencies, "dependencies are given in the model description only",
          void *instance, unsigned dependent, size_t elements[], unsigned independents[],
          size_t independent_elements[], fmi3DependencyKind of_kind[], size_t count)

EXPORT status_t FMI(GetAdjointDerivative)(void *instance, const unsigned unknowns[],
                                          size_t n_unknowns, const unsigned knowns[],
                                          size_t n_knowns, const double seed[], size_t n_seed,
                                          double value[], size_t n) {
  BEGIN(RUNNING);
  return products(c, 1, unknowns, n_unknowns, knowns, n_knowns, seed, n_seed, value, n);
}

/* --- events ----------------------------------------------------------------------------------- */

EXPORT status_t FMI(EnterEventMode)(void *instance) {
  BEGIN(CONTINUOUS | STEP);
  if (c->now->stepping && !c->uses_events) REFUSE("the instance was made without event mode");
  return enter_mode(c, EVENT);
}

EXPORT status_t FMI(EvaluateDiscreteStates)(void *instance) {
  BEGIN(INITIALIZATION | EVENT);
  return OK;
}

EXPORT status_t FMI(UpdateDiscreteStates)(void *instance, _Bool *again, _Bool *terminate,
                                          _Bool *nominals, _Bool *values, _Bool *next_defined,
                                          double *next_time) {
  BEGIN(EVENT);
  NEEDS(again && terminate && nominals && values && next_defined && next_time);
  *again = *nominals = 0;
  update(c, terminate, values, next_defined, next_time);
  return OK;
}

/* --- Model Exchange --------------------------------------------------------------------------- */

#define COUNT_OF(name, found)                                                                      \
  EXPORT status_t FMI(name)(void *instance, size_t *count) {                                       \
    EXCHANGE_ONLY(ANY);                                                                            \
    NEEDS(count);                                                                                  \
    *count = found;                                                                                \
    return OK;                                                                                     \
  }
COUNT_OF(GetNumberOfEventIndicators, 0)
COUNT_OF(GetNumberOfContinuousStates, (size_t)c->model->n_states)

/* --- Co-Simulation ---------------------------------------------------------------------------- */

LEADS_TO(STEP, EnterStepMode, STEPPING_ONLY(EVENT))

EXPORT status_t FMI(DoStep)(void *instance, double from, double size, _Bool no_return, _Bool *event,
                            _Bool *terminate, _Bool *early, double *last_time) {
  BEGIN(STEP);
  NEEDS(event && terminate && early && last_time);
  *event = *terminate = *early = 0, *last_time = c->now->time;
  if (check_step(c, from, size)) return FAILED;
  const status_t s = step(c, from + size);
  *last_time = c->now->time;
  *event = c->now->pending && !s, *early = !s && !reached(c->now->time, from + size);
  *terminate = c->now->ended || (*early && reached(c->now->time, c->now->limit));
  return s;
}

NOT_THERE(ActivateModelPartition, "this model has no Scheduled Execution", void *instance,
          unsigned clock, double time)
