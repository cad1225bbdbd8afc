/* A block that adds up how far contacts have slid: FMI 2.0.4, Co-Simulation, no more than that.

   The consumer of an SSP written by ssp.py. Variables, by value reference: slip (2 a contact, m/s),
   then the distance slid (1 a contact, m). slip_integrator.h is generated: N_CONTACTS, TOKEN. */
#include "slip_integrator.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"

#define N_INPUTS (2 * N_CONTACTS)
#define N_VALUES (3 * N_CONTACTS)

typedef struct {
  double value[N_VALUES];
  int begun; /* initialized: distances are no start values any more */
} block_t;

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }

const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String location,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible,
                              fmi2Boolean logging) {
  (void)name, (void)location, (void)functions, (void)visible, (void)logging;
  if (type != fmi2CoSimulation || !guid || strcmp(guid, TOKEN)) return NULL;
  return calloc(1, sizeof(block_t));
}

void fmi2FreeInstance(fmi2Component c) { free(c); }

fmi2Status fmi2Reset(fmi2Component c) {
  memset(c, 0, sizeof(block_t));
  return fmi2OK;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t count, fmi2Real value[]) {
  for (size_t k = 0; k < count; k++) {
    if (vr[k] >= N_VALUES) return fmi2Error;
    value[k] = ((block_t *)c)->value[vr[k]];
  }
  return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t count,
                       const fmi2Real value[]) {
  block_t *block = c;
  const fmi2ValueReference n = block->begun ? N_INPUTS : N_VALUES;
  for (size_t k = 0; k < count; k++)
    if (vr[k] >= n || !(fabs(value[k]) < HUGE_VAL)) return fmi2Error;
  for (size_t k = 0; k < count; k++) block->value[vr[k]] = value[k];
  return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
  ((block_t *)c)->begun = 1;
  return fmi2OK;
}

/* The inputs are held. */
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real from, fmi2Real size, fmi2Boolean no_return) {
  double *value = ((block_t *)c)->value;
  (void)from, (void)no_return;
  if (!(size >= 0)) return fmi2Error;
  for (long i = 0; i < N_CONTACTS; i++)
    value[N_INPUTS + i] += size * hypot(value[2 * i], value[2 * i + 1]);
  return fmi2OK;
}

#define NOTHING_TO_DO(name, ...) \
  fmi2Status name(__VA_ARGS__) { return fmi2OK; }

NOTHING_TO_DO(fmi2SetDebugLogging, fmi2Component c, fmi2Boolean on, size_t n, const fmi2String x[])
NOTHING_TO_DO(fmi2SetupExperiment, fmi2Component c, fmi2Boolean tolerance_defined, fmi2Real tolerance,
              fmi2Real start, fmi2Boolean stop_defined, fmi2Real stop)
NOTHING_TO_DO(fmi2EnterInitializationMode, fmi2Component c)
NOTHING_TO_DO(fmi2Terminate, fmi2Component c)

#define NOT_HERE(name, ...) \
  fmi2Status name(__VA_ARGS__) { return fmi2Error; }
#define REFERENCES fmi2Component c, const fmi2ValueReference vr[], size_t n

NOT_HERE(fmi2GetInteger, REFERENCES, fmi2Integer x[])
NOT_HERE(fmi2GetBoolean, REFERENCES, fmi2Boolean x[])
NOT_HERE(fmi2GetString, REFERENCES, fmi2String x[])
NOT_HERE(fmi2SetInteger, REFERENCES, const fmi2Integer x[])
NOT_HERE(fmi2SetBoolean, REFERENCES, const fmi2Boolean x[])
NOT_HERE(fmi2SetString, REFERENCES, const fmi2String x[])
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
