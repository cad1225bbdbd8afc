/* FMI 2.0.4 over component.h. */
#include "fmi.h"

#include "fmi2Functions.h"

#define STATUS fmi2Status

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

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }

const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String location,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible,
                              fmi2Boolean logging) {
  (void)location, (void)visible;
  if (!functions) return NULL;
  instance_t *instance = calloc(1, sizeof *instance);
  if (!instance) return NULL;
  component_t *c = &instance->component;
  c->report = log_text, c->host = instance;
  instance->log = (void (*)(void))functions->logger;
  instance->environment = functions->componentEnvironment;
  if (name) strncpy(instance->name, name, sizeof instance->name - 1);
  const char *wrong = !name || !*name ? "the instance has no name"
                      : !guid || strcmp(guid, model_token) ? "the GUID is another model's"
                      : type != fmi2CoSimulation && type != fmi2ModelExchange
                          ? "unknown type"
                          : NULL;
  if (wrong) {
    report(c, FAILED, "logStatusError", "fmi2Instantiate: %s", wrong);
    free(instance);
    return NULL;
  }
  for (int k = 0; k < CATEGORIES; k++) instance->logging[k] = logging != fmi2False;
  reset(c, type == fmi2CoSimulation);
  return instance;
}

void fmi2FreeInstance(fmi2Component instance) { free(instance); }

fmi2Status fmi2SetDebugLogging(fmi2Component instance, fmi2Boolean on, size_t count,
                               const fmi2String categories[]) {
  BEGIN("fmi2SetDebugLogging", ANY);
  return (fmi2Status)set_logging(instance, "fmi2SetDebugLogging", on != fmi2False, count, categories);
}

/* --- initialization --------------------------------------------------------------------------- */

fmi2Status fmi2SetupExperiment(fmi2Component instance, fmi2Boolean tolerance_defined,
                               fmi2Real tolerance,
                               fmi2Real start_time, fmi2Boolean stop_defined, fmi2Real stop) {
  BEGIN("fmi2SetupExperiment", INSTANTIATED);
  (void)tolerance_defined, (void)tolerance;
  if (check_times(c, start_time, stop_defined, stop)) return fmi2Error;
  set_time(c, start_time);
  c->now.stop_time = stop_defined ? stop : HUGE_VAL;
  return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component instance) {
  BEGIN("fmi2EnterInitializationMode", INSTANTIATED);
  enter_initialization(c, c->now.time);
  return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component instance) {
  BEGIN("fmi2ExitInitializationMode", INITIALIZATION);
  if (start(c)) return fmi2Error;
  c->now.phase = c->now.stepping ? STEP : EVENT;
  return fmi2OK;
}

fmi2Status fmi2Terminate(fmi2Component instance) {
  BEGIN("fmi2Terminate", EVENT | CONTINUOUS | STEP);
  c->now.phase = TERMINATED;
  return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component instance) {
  BEGIN("fmi2Reset", ANY);
  reset(c, c->now.stepping);
  return fmi2OK;
}

/* --- values ----------------------------------------------------------------------------------- */

static int known(unsigned reference) { return reference > 0 && reference < N_VALUES; }

fmi2Status fmi2GetReal(fmi2Component instance, const fmi2ValueReference vr[], size_t count,
                       fmi2Real value[]) {
  BEGIN("fmi2GetReal", RUNNING);
  if (count && (!vr || !value)) REFUSE("fmi2GetReal: a pointer is missing");
  status_t worst = OK;
  for (size_t k = 0; k < count; k++) {
    if (!known(vr[k])) REFUSE("fmi2GetReal: " NO_SUCH, vr[k]);
    status_t s = get_values(c, vr[k], 1, value + k);
    worst = s > worst ? s : worst;
  }
  return (fmi2Status)worst;
}

fmi2Status fmi2SetReal(fmi2Component instance, const fmi2ValueReference vr[], size_t count,
                       const fmi2Real value[]) {
  BEGIN("fmi2SetReal", INSTANTIATED | INITIALIZATION | EVENT | CONTINUOUS | STEP);
  if (count && (!vr || !value)) REFUSE("fmi2SetReal: a pointer is missing");
  for (size_t k = 0; k < count; k++) { /* all are set, or none */
    if (!known(vr[k])) REFUSE("fmi2SetReal: " NO_SUCH, vr[k]);
    const status_t wrong = check_one(c, vr[k], value[k]);
    if (wrong) return (fmi2Status)wrong;
  }
  for (size_t k = 0; k < count; k++) set_value(c, vr[k], value[k]);
  return fmi2OK;
}

/* There are variables of type Real only. */
#define NO_VARIABLES(name, type)                                                                  \
  fmi2Status fmi2Get##name(fmi2Component instance, const fmi2ValueReference vr[], size_t count,   \
                           type value[]) {                                                        \
    BEGIN("fmi2Get" #name, RUNNING);                                                              \
    (void)vr, (void)value;                                                                        \
    if (count) REFUSE("fmi2Get" #name ": there are no variables of this type");                   \
    return fmi2OK;                                                                                \
  }                                                                                               \
  fmi2Status fmi2Set##name(fmi2Component instance, const fmi2ValueReference vr[], size_t count,   \
                           const type value[]) {                                                  \
    BEGIN("fmi2Set" #name, INSTANTIATED | INITIALIZATION | EVENT | CONTINUOUS | STEP);            \
    (void)vr, (void)value;                                                                        \
    if (count) REFUSE("fmi2Set" #name ": there are no variables of this type");                   \
    return fmi2OK;                                                                                \
  }

NO_VARIABLES(Integer, fmi2Integer)
NO_VARIABLES(Boolean, fmi2Boolean)
NO_VARIABLES(String, fmi2String)

fmi2Status fmi2GetDirectionalDerivative(fmi2Component instance, const fmi2ValueReference unknown[],
                                        size_t n_unknown, const fmi2ValueReference vr[],
                                        size_t n_known, const fmi2Real seed[], fmi2Real value[]) {
  BEGIN("fmi2GetDirectionalDerivative", RUNNING);
  if ((n_unknown && (!unknown || !value)) || (n_known && (!vr || !seed)))
    REFUSE("fmi2GetDirectionalDerivative: a pointer is missing");
  memset(c->seed, 0, sizeof c->seed);
  for (size_t k = 0; k < n_known; k++) {
    if (!known(vr[k])) REFUSE("fmi2GetDirectionalDerivative: " NO_SUCH, vr[k]);
    if (kinds[vr[k]] == CALCULATED)
      REFUSE("fmi2GetDirectionalDerivative: %s is not a known; give inputs, states or parameters",
             names[vr[k]]);
    c->seed[vr[k]] += seed[k];
  }
  for (size_t k = 0; k < n_unknown; k++) {
    if (!known(unknown[k])) REFUSE("fmi2GetDirectionalDerivative: " NO_SUCH, unknown[k]);
    if (kinds[unknown[k]] != CALCULATED && kinds[unknown[k]] != EXACT)
      REFUSE("fmi2GetDirectionalDerivative: %s is not an unknown; give states or calculated variables",
             names[unknown[k]]);
  }
  forward(c);
  for (size_t k = 0; k < n_unknown; k++) {
    const status_t s = check_grown(c, unknown[k], 1);
    if (s) return (fmi2Status)s;
    value[k] = c->grown[unknown[k]];
  }
  return fmi2OK;
}

/* --- FMU states ------------------------------------------------------------------------------- */

fmi2Status fmi2GetFMUstate(fmi2Component instance, fmi2FMUstate *state) {
  BEGIN("fmi2GetFMUstate", ANY);
  if (!state || (*state && !saved(c, *state))) REFUSE("fmi2GetFMUstate: a pointer is missing");
  return (fmi2Status)save(c, state);
}

fmi2Status fmi2SetFMUstate(fmi2Component instance, fmi2FMUstate state) {
  BEGIN("fmi2SetFMUstate", ANY);
  return (fmi2Status)restore_saved(c, state);
}

fmi2Status fmi2FreeFMUstate(fmi2Component instance, fmi2FMUstate *state) {
  BEGIN("fmi2FreeFMUstate", ANY);
  if (!state || !*state) return fmi2OK;
  if (!saved(c, *state)) return fmi2Error;
  free(*state);
  *state = NULL;
  return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component instance, fmi2FMUstate state, size_t *size) {
  BEGIN("fmi2SerializedFMUstateSize", ANY);
  if (!size) REFUSE("fmi2SerializedFMUstateSize: a pointer is missing");
  if (!saved(c, state)) return fmi2Error;
  *size = STATE_BYTES;
  return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component instance, fmi2FMUstate state, fmi2Byte bytes[],
                                 size_t size) {
  BEGIN("fmi2SerializeFMUstate", ANY);
  const saved_t *s = saved(c, state);
  if (!s) return fmi2Error;
  if (!bytes || size < STATE_BYTES) REFUSE("fmi2SerializeFMUstate: the buffer is missing or too small");
  write_state(&s->memory, (unsigned char *)bytes);
  return fmi2OK;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component instance, const fmi2Byte bytes[], size_t size,
                                   fmi2FMUstate *state) {
  BEGIN("fmi2DeSerializeFMUstate", ANY);
  if (!state) REFUSE("fmi2DeSerializeFMUstate: a pointer is missing");
  return (fmi2Status)read_bytes(c, (const unsigned char *)bytes, size, state);
}

/* --- Model Exchange --------------------------------------------------------------------------- */

fmi2Status fmi2EnterEventMode(fmi2Component instance) {
  BEGIN("fmi2EnterEventMode", EVENT | CONTINUOUS);
  enter_event_mode(c);
  return fmi2OK;
}

fmi2Status fmi2NewDiscreteStates(fmi2Component instance, fmi2EventInfo *info) {
  BEGIN("fmi2NewDiscreteStates", EVENT);
  if (!info) REFUSE("fmi2NewDiscreteStates: a pointer is missing");
  enter_windows(c);
  const double next = next_edge(&c->now);
  *info = (fmi2EventInfo){.terminateSimulation = c->now.ended && !c->now.stepping,
                          .nextEventTimeDefined = next < HUGE_VAL,
                          .nextEventTime = next < HUGE_VAL ? next : 0.0};
  return fmi2OK;
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component instance) {
  BEGIN("fmi2EnterContinuousTimeMode", EVENT);
  c->now.phase = CONTINUOUS;
  return fmi2OK;
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component instance, fmi2Boolean no_return,
                                       fmi2Boolean *enter_event_mode, fmi2Boolean *terminate) {
  BEGIN("fmi2CompletedIntegratorStep", CONTINUOUS);
  (void)no_return;
  if (!enter_event_mode || !terminate) REFUSE("fmi2CompletedIntegratorStep: a pointer is missing");
  *enter_event_mode = *terminate = fmi2False;
  return fmi2OK;
}

fmi2Status fmi2SetTime(fmi2Component instance, fmi2Real time) {
  BEGIN("fmi2SetTime", EVENT | CONTINUOUS);
  if (!(fabs(time) < 1e300)) REFUSE("fmi2SetTime: t = %g s is refused", time);
  set_time(c, time);
  return fmi2OK;
}

fmi2Status fmi2SetContinuousStates(fmi2Component instance, const fmi2Real x[], size_t count) {
  BEGIN("fmi2SetContinuousStates", EVENT | CONTINUOUS);
  OF_SIZE("fmi2SetContinuousStates", x, count, SYSTEM_STATES * N_CONTACTS);
  return (fmi2Status)set_states(c, x);
}

fmi2Status fmi2GetDerivatives(fmi2Component instance, fmi2Real rate[], size_t count) {
  SYSTEM_ONLY("fmi2GetDerivatives", ME_RUNNING);
  OF_SIZE("fmi2GetDerivatives", rate, count, SYSTEM_STATES * N_CONTACTS);
  return (fmi2Status)get_rates(c, rate);
}

fmi2Status fmi2GetEventIndicators(fmi2Component instance, fmi2Real indicator[], size_t count) {
  SYSTEM_ONLY("fmi2GetEventIndicators", ME_RUNNING);
  (void)indicator;
  if (count) REFUSE("fmi2GetEventIndicators: there are none");
  return fmi2OK;
}

fmi2Status fmi2GetContinuousStates(fmi2Component instance, fmi2Real x[], size_t count) {
  SYSTEM_ONLY("fmi2GetContinuousStates", ME_RUNNING);
  OF_SIZE("fmi2GetContinuousStates", x, count, SYSTEM_STATES * N_CONTACTS);
  return (fmi2Status)get_states(c, x);
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component instance, fmi2Real nominal[],
                                             size_t count) {
  SYSTEM_ONLY("fmi2GetNominalsOfContinuousStates", ANY);
  OF_SIZE("fmi2GetNominalsOfContinuousStates", nominal, count, SYSTEM_STATES * N_CONTACTS);
  memcpy(nominal, nominals, sizeof nominals);
  return fmi2OK;
}

/* --- Co-Simulation ---------------------------------------------------------------------------- */

fmi2Status fmi2SetRealInputDerivatives(fmi2Component instance, const fmi2ValueReference vr[],
                                       size_t count, const fmi2Integer order[],
                                       const fmi2Real value[]) {
  STEPPING_ONLY("fmi2SetRealInputDerivatives", INSTANTIATED | INITIALIZATION | STEP);
  if (count && (!vr || !order || !value))
    REFUSE("fmi2SetRealInputDerivatives: a pointer is missing");
  status_t worst = OK;
  for (size_t k = 0; k < count; k++) {
    if (!known(vr[k])) REFUSE("fmi2SetRealInputDerivatives: " NO_SUCH, vr[k]);
    if (kinds[vr[k]] != INPUT || order[k] < 1)
      REFUSE("fmi2SetRealInputDerivatives: %s, order %d is refused; give first derivatives of "
             "inputs", names[vr[k]], order[k]);
    status_t s = order[k] == 1 ? set_slope(c, vr[k], value[k])
                               : report(c, WARNING, "logStatusWarning",
                                        "derivatives of inputs above the first are ignored");
    worst = s > worst ? s : worst;
  }
  return (fmi2Status)worst;
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component instance, const fmi2ValueReference vr[],
                                        size_t count, const fmi2Integer order[], fmi2Real value[]) {
  STEPPING_ONLY("fmi2GetRealOutputDerivatives", STEP | TERMINATED);
  (void)vr, (void)order, (void)value;
  if (count) REFUSE("fmi2GetRealOutputDerivatives: derivatives are outputs of their own, der(...)");
  return fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component instance, fmi2Real from, fmi2Real size, fmi2Boolean no_return) {
  BEGIN("fmi2DoStep", STEP);
  (void)no_return;
  int edge;
  if (check_step(c, from, size)) return fmi2Error;
  return (fmi2Status)step(c, from + size, 0, &edge);
}

fmi2Status fmi2CancelStep(fmi2Component instance) {
  BEGIN("fmi2CancelStep", ANY);
  REFUSE("fmi2CancelStep: no step is under way");
}

fmi2Status fmi2GetStatus(fmi2Component instance, const fmi2StatusKind kind, fmi2Status *value) {
  STEPPING_ONLY("fmi2GetStatus", STEP | TERMINATED | BROKEN);
  (void)kind, (void)value;
  return (fmi2Status)report(c, DISCARD, "logStatusDiscard", "steps are never asynchronous");
}

fmi2Status fmi2GetRealStatus(fmi2Component instance, const fmi2StatusKind kind, fmi2Real *value) {
  STEPPING_ONLY("fmi2GetRealStatus", STEP | TERMINATED | BROKEN);
  if (kind != fmi2LastSuccessfulTime || !value)
    return (fmi2Status)report(c, DISCARD, "logStatusDiscard",
                              "only the last successful time is known");
  *value = c->now.time;
  return fmi2OK;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component instance, const fmi2StatusKind kind,
                                fmi2Integer *value) {
  STEPPING_ONLY("fmi2GetIntegerStatus", STEP | TERMINATED | BROKEN);
  (void)kind, (void)value;
  return (fmi2Status)report(c, DISCARD, "logStatusDiscard", "there is no such status");
}

fmi2Status fmi2GetBooleanStatus(fmi2Component instance, const fmi2StatusKind kind,
                                fmi2Boolean *value) {
  STEPPING_ONLY("fmi2GetBooleanStatus", STEP | TERMINATED | BROKEN);
  if (kind != fmi2Terminated || !value)
    return (fmi2Status)report(c, DISCARD, "logStatusDiscard", "there is no such status");
  *value = c->now.ended ? fmi2True : fmi2False;
  return fmi2OK;
}

fmi2Status fmi2GetStringStatus(fmi2Component instance, const fmi2StatusKind kind,
                               fmi2String *value) {
  STEPPING_ONLY("fmi2GetStringStatus", STEP | TERMINATED | BROKEN);
  (void)kind, (void)value;
  return (fmi2Status)report(c, DISCARD, "logStatusDiscard", "there is no such status");
}
