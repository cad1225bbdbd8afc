/* A block that adds up how far contacts have slid: FMI 2.0.4, Co-Simulation, no more than that.

   The consumer of an SSP written by ssp.py. Variables, by value reference: slip (2 a contact, m/s),
   then the distance slid (1 a contact, m). slip_integrator.h is generated: N_CONTACTS, TOKEN. */
#include "slip_integrator.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"

#define N_INPUTS (2 * N_CONTACTS)
#define N_VALUES (3 * N_CONTACTS)

enum { INSTANTIATED = 1, INITIALIZATION = 2, STEP = 4, TERMINATED = 8, ANY = 15 };

typedef struct {
  double value[N_VALUES], time;
  int state;
  fmi2CallbackLogger log;
  void *environment;
  char name[256];
} block_t;

/* Errors are told always, as by the planners; the text holds no percent sign. */
static fmi2Status refuse(const block_t *block, const char *format, ...) {
  char text[256];
  va_list arguments;
  va_start(arguments, format);
  vsnprintf(text, sizeof text, format, arguments);
  va_end(arguments);
  if (block->log) block->log(block->environment, block->name, fmi2Error, "logStatusError", text);
  return fmi2Error;
}

static fmi2Status allowed(const block_t *block, const char *function, int states) {
  if (!block) return fmi2Error;
  if (block->state & states) return fmi2OK;
  return refuse(block, "%s is not allowed %s", function,
                block->state == INSTANTIATED     ? "before initialization begins"
                : block->state == INITIALIZATION ? "during initialization"
                : block->state == STEP           ? "after initialization; reset first"
                                                 : "after the simulation has ended; reset first");
}

#define BEGIN(function, states)                                                                    \
  block_t *const block = c;                                                                        \
  if (allowed(block, function, states)) return fmi2Error

#if defined(__GNUC__)
#pragma GCC diagnostic ignored "-Wunused-parameter" /* the standard's signatures, from here on */
#endif

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }

const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String location,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible,
                              fmi2Boolean logging) {
  block_t *block = calloc(1, sizeof *block);
  if (!block) return NULL;
  block->state = INSTANTIATED;
  if (functions)
    block->log = functions->logger, block->environment = functions->componentEnvironment;
  if (name) strncpy(block->name, name, sizeof block->name - 1);
  const char *wrong = type != fmi2CoSimulation       ? "this block is for Co-Simulation only"
                      : !guid || strcmp(guid, TOKEN) ? "the GUID is another model's"
                                                     : NULL;
  if (!wrong) return block;
  refuse(block, "fmi2Instantiate: %s", wrong);
  free(block);
  return NULL;
}

void fmi2FreeInstance(fmi2Component c) { free(c); }

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String x[]) {
  return allowed(c, "fmi2SetDebugLogging", ANY);
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerance_defined, fmi2Real tolerance,
                               fmi2Real start, fmi2Boolean stop_defined, fmi2Real stop) {
  BEGIN("fmi2SetupExperiment", INSTANTIATED);
  if (!(fabs(start) < HUGE_VAL)) return refuse(block, "a start at %g s is refused", start);
  block->time = start;
  return fmi2OK;
}

#define CHANGE(name, from, to)                                                                     \
  fmi2Status name(fmi2Component c) {                                                               \
    BEGIN(#name, from);                                                                            \
    block->state = to;                                                                             \
    return fmi2OK;                                                                                 \
  }
CHANGE(fmi2EnterInitializationMode, INSTANTIATED, INITIALIZATION)
CHANGE(fmi2ExitInitializationMode, INITIALIZATION, STEP)
CHANGE(fmi2Terminate, STEP, TERMINATED)

fmi2Status fmi2Reset(fmi2Component c) {
  BEGIN("fmi2Reset", ANY);
  memset(block->value, 0, sizeof block->value);
  block->time = 0.0, block->state = INSTANTIATED;
  return fmi2OK;
}

#define VALUES(function)                                                                           \
  if (count && (!vr || !value)) return refuse(block, function ": a pointer is missing");           \
  for (size_t k = 0; k < count; k++)                                                               \
    if (vr[k] >= N_VALUES)                                                                         \
  return refuse(block, function ": there is no variable with value reference %u", vr[k])

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t count,
                       fmi2Real value[]) {
  BEGIN("fmi2GetReal", INITIALIZATION | STEP | TERMINATED);
  VALUES("fmi2GetReal");
  for (size_t k = 0; k < count; k++) value[k] = block->value[vr[k]];
  return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t count,
                       const fmi2Real value[]) {
  BEGIN("fmi2SetReal", INSTANTIATED | INITIALIZATION | STEP);
  VALUES("fmi2SetReal");
  for (size_t k = 0; k < count; k++) { /* all are set, or none */
    if (vr[k] >= N_INPUTS && block->state == STEP)
      return refuse(block, "distance[%u] is a start value; set it before initialization ends",
                    vr[k] - N_INPUTS + 1);
    if (!(fabs(value[k]) < HUGE_VAL))
      return refuse(block, "value reference %u = %g is refused; give a finite number", vr[k],
                    value[k]);
  }
  for (size_t k = 0; k < count; k++) block->value[vr[k]] = value[k];
  return fmi2OK;
}

/* The inputs are held. */
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real from, fmi2Real size, fmi2Boolean no_return) {
  BEGIN("fmi2DoStep", STEP);
  double *value = block->value;
  if (!(size > 0 && size < HUGE_VAL))
    return refuse(block, "a step of %g s is refused; give a positive length", size);
  if (!(fabs(from - block->time) <= 1e-9 * fmax(1.0, fabs(from + size))))
    return refuse(block, "the step begins at t = %.17g s, but the instance stands at t = %.17g s",
                  from, block->time);
  for (long i = 0; i < N_CONTACTS; i++)
    value[N_INPUTS + i] += size * hypot(value[2 * i], value[2 * i + 1]);
  block->time = from + size;
  return fmi2OK;
}

#define REFERENCES fmi2Component c, const fmi2ValueReference vr[], size_t n

#define NO_VARIABLES(name, ...)                                                                    \
  fmi2Status name(REFERENCES, __VA_ARGS__) {                                                       \
    BEGIN(#name, ANY);                                                                             \
    return n ? refuse(block, #name ": there are no such variables") : fmi2OK;                      \
  }

NO_VARIABLES(fmi2GetInteger, fmi2Integer x[])
NO_VARIABLES(fmi2GetBoolean, fmi2Boolean x[])
NO_VARIABLES(fmi2GetString, fmi2String x[])
NO_VARIABLES(fmi2SetInteger, const fmi2Integer x[])
NO_VARIABLES(fmi2SetBoolean, const fmi2Boolean x[])
NO_VARIABLES(fmi2SetString, const fmi2String x[])

#define NOT_HERE(name, ...)                                                                        \
  fmi2Status name(__VA_ARGS__) {                                                                   \
    BEGIN(#name, ANY);                                                                             \
    return refuse(block, #name ": this block does not have it; see modelDescription.xml");         \
  }

NOT_HERE(fmi2GetFMUstate, fmi2Component c, fmi2FMUstate *state)
NOT_HERE(fmi2SetFMUstate, fmi2Component c, fmi2FMUstate state)
NOT_HERE(fmi2FreeFMUstate, fmi2Component c, fmi2FMUstate *state)
NOT_HERE(fmi2SerializedFMUstateSize, fmi2Component c, fmi2FMUstate state, size_t *size)
NOT_HERE(fmi2SerializeFMUstate, fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
NOT_HERE(fmi2DeSerializeFMUstate, fmi2Component c, const fmi2Byte bytes[], size_t size,
         fmi2FMUstate *state)
NOT_HERE(fmi2GetDirectionalDerivative, fmi2Component c, const fmi2ValueReference unknown[],
         size_t n_unknown, const fmi2ValueReference known[], size_t n_known, const fmi2Real seed[],
         fmi2Real value[])
NOT_HERE(fmi2SetRealInputDerivatives, REFERENCES, const fmi2Integer order[], const fmi2Real x[])
NOT_HERE(fmi2GetRealOutputDerivatives, REFERENCES, const fmi2Integer order[], fmi2Real x[])
NOT_HERE(fmi2CancelStep, fmi2Component c)
NOT_HERE(fmi2GetStatus, fmi2Component c, const fmi2StatusKind kind, fmi2Status *x)
NOT_HERE(fmi2GetRealStatus, fmi2Component c, const fmi2StatusKind kind, fmi2Real *x)
NOT_HERE(fmi2GetIntegerStatus, fmi2Component c, const fmi2StatusKind kind, fmi2Integer *x)
NOT_HERE(fmi2GetBooleanStatus, fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *x)
NOT_HERE(fmi2GetStringStatus, fmi2Component c, const fmi2StatusKind kind, fmi2String *x)
