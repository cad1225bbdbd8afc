/* FMI 2.0.4 over component.h. */
#ifdef SCENE_INSIDE /* compiled by an importer, whose headers name the functions */
#include "fmi2Functions.h"
#else
#include <stddef.h>
typedef char fmi2Byte;
typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error } fmi2Status;
typedef enum { fmi2ModelExchange, fmi2CoSimulation } fmi2Type;
typedef int fmi2StatusKind;
enum { fmi2LastSuccessfulTime = 2, fmi2Terminated };
typedef void (*fmi2CallbackLogger)(void *, const char *, fmi2Status, const char *, const char *,
                                   ...);
typedef struct {
  fmi2CallbackLogger logger;
  void *(*allocateMemory)(size_t, size_t);
  void (*freeMemory)(void *);
  void (*stepFinished)(void *, fmi2Status);
  void *componentEnvironment;
} fmi2CallbackFunctions;
typedef struct {
  int newDiscreteStatesNeeded, terminateSimulation, nominalsOfContinuousStatesChanged;
  int valuesOfContinuousStatesChanged, nextEventTimeDefined;
  double nextEventTime;
} fmi2EventInfo;
#endif
#define FMI(name) PASTED(fmi2, name)
#define status_t fmi2Status
#define OK fmi2OK
#define DISCARD fmi2Discard
#define FAILED fmi2Error
#define logger_t fmi2CallbackLogger
#define BYTE fmi2Byte
#define BOOLEAN int
#define ROOM(n)
#define ROOM_OF(count, n) (count)
#define GETTABLE RUNNING
#define TOKEN "GUID"
/* names that FMI 3 spells otherwise */
#define GetFMUState GetFMUstate
#define SetFMUState SetFMUstate
#define FreeFMUState FreeFMUstate
#define SerializedFMUStateSize SerializedFMUstateSize
#define SerializeFMUState SerializeFMUstate
#define DeserializeFMUState DeSerializeFMUstate
#define GetContinuousStateDerivatives GetDerivatives
#define GetOutputDerivatives GetRealOutputDerivatives
#include "fmi.h"

/* The logger takes a format. Many importers print it as it is, and would print nothing but "%s" if
   that were it; so the text itself is the format, every percent sign in it doubled. */
static void log_text(component_t *c, status_t status, const char *text) {
  char format[1400], *to = format;
  for (; *text && to < format + sizeof format - 2; text++) {
    *to++ = *text;
    if (*text == '%') *to++ = '%';
  }
  *to = 0;
  c->log(c->environment, c->name, status, category_of[status], format);
}

EXPORT const char *FMI(GetTypesPlatform)(void) { return "default"; }

EXPORT const char *FMI(GetVersion)(void) { return "2.0"; }

EXPORT void *FMI(Instantiate)(const char *name, fmi2Type type, const char *guid,
                              const char *location, const fmi2CallbackFunctions *functions,
                              int visible, int logging) {
  if (!functions) return NULL;
  return instantiate(__func__, name, guid, location, functions->logger,
                     functions->componentEnvironment, type == fmi2CoSimulation);
}

EXPORT status_t FMI(SetupExperiment)(void *instance, int tolerance_defined, double tolerance,
                                     double start_time, int stop_defined, double stop) {
  BEGIN(INSTANTIATED);
  return set_times(c, start_time, stop_defined, stop);
}

EXPORT status_t FMI(EnterInitializationMode)(void *instance) {
  BEGIN(INSTANTIATED);
  return enter_mode(c, INITIALIZATION);
}

NO_VARIABLES(Integer, int)
NO_VARIABLES(Boolean, int)
NO_VARIABLES(String, const char *)

/* --- Model Exchange --------------------------------------------------------------------------- */

EXPORT status_t FMI(EnterEventMode)(void *instance) {
  BEGIN(EVENT | CONTINUOUS);
  return enter_mode(c, EVENT);
}

EXPORT status_t FMI(NewDiscreteStates)(void *instance, fmi2EventInfo *info) {
  BEGIN(EVENT);
  NEEDS(info);
  info->newDiscreteStatesNeeded = info->nominalsOfContinuousStatesChanged = 0;
  update(c, &info->terminateSimulation, &info->valuesOfContinuousStatesChanged,
         &info->nextEventTimeDefined, &info->nextEventTime);
  return OK;
}

/* --- Co-Simulation ---------------------------------------------------------------------------- */

OF_NOTHING(SetRealInputDerivatives, STEPPING_ONLY(INSTANTIATED | INITIALIZATION | STEP),
           "inputs are held during a step; make shorter steps", const int order[],
           const double value[])

EXPORT status_t FMI(DoStep)(void *instance, double from, double size, int no_return) {
  BEGIN(STEP);
  if (check_step(c, from, size)) return FAILED;
  return step(c, from + size);
}

NOT_THERE(CancelStep, "no step is under way", void *instance)

/* The status of the last step, which has a value only where `known` is true */
#define STATUS_OF_STEP(name, type, known, found, words)                                            \
  EXPORT status_t FMI(name)(void *instance, const fmi2StatusKind kind, type *value) {              \
    STEPPING_ONLY(STEP | TERMINATED);                                                              \
    if (!(known) || !value) return report(c, DISCARD, words);                                      \
    *value = found;                                                                                \
    return OK;                                                                                     \
  }
STATUS_OF_STEP(GetStatus, fmi2Status, 0, fmi2OK, "steps are never asynchronous")
STATUS_OF_STEP(GetRealStatus, double, kind == fmi2LastSuccessfulTime, c->now->time,
               "only the last successful time is known")
STATUS_OF_STEP(GetIntegerStatus, int, 0, 0, "there is no such status")
STATUS_OF_STEP(GetBooleanStatus, int, kind == fmi2Terminated, c->now->ended != 0,
               "there is no such status")
STATUS_OF_STEP(GetStringStatus, const char *, 0, NULL, "there is no such status")
