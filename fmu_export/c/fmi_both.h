/* The functions that FMI 2 and FMI 3 have alike; fmi2.c and fmi3.c say first what differs:

   FMI(name)  a function's name      PREFIX  the same in log lines
   SIZE(c, r)    how many values a reference has, 0: there is no such reference
   OTHER_TOKEN  what is wrong with a token
   STATUS, INSTANCE, REFERENCE, REAL, BYTE, BOOLEAN, FMU_STATE  types */
#define TEXT_OF(x) #x
#define TEXT(x) TEXT_OF(x)
#define NAME(x) PREFIX TEXT(x)

/* where variables may be set, some of them */
#define SETTABLE (INSTANTIATED | CONFIGURATION | INITIALIZATION | EVENT | CONTINUOUS | STEP)

static void log_text(component_t *, status_t, const char *category, const char *text);

static void free_instance(instance_t *instance) {
  if (!instance) return;
  free_component(&instance->component);
  free(instance);
}

/* wrong: what else is, or NULL */
static instance_t *instantiate(const char *name, const char *token, const char *resources,
                               void (*log)(void), void *environment, int logging, int stepping,
                               const char *wrong) {
  instance_t *instance = calloc(1, sizeof *instance);
  if (!instance) return NULL;
  component_t *c = &instance->component;
  c->report = log_text, c->host = instance;
  instance->log = log, instance->environment = environment;
  if (name) strncpy(instance->name, name, sizeof instance->name - 1);
  if (!name || !*name) wrong = "the instance has no name";
  if (!wrong) wrong = make_component(c, resources);
  if (!wrong && (!token || strcmp(token, token_of(c->model)))) wrong = OTHER_TOKEN;
  if (wrong) {
    report(c, FAILED, "logStatusError", PREFIX "Instantiate: %s", wrong);
    free_instance(instance);
    return NULL;
  }
  for (int k = 0; k < CATEGORIES; k++) instance->logging[k] = logging;
  reset(c, stepping);
  return instance;
}

FMI_EXPORT void FMI(FreeInstance)(INSTANCE instance) { free_instance(instance); }

FMI_EXPORT STATUS FMI(SetDebugLogging)(INSTANCE instance, BOOLEAN on, size_t count,
                                       const char *const categories[]) {
  BEGIN(NAME(SetDebugLogging), ANY);
  return (STATUS)set_logging(instance, NAME(SetDebugLogging), on != 0, count, categories);
}

FMI_EXPORT STATUS FMI(ExitInitializationMode)(INSTANCE instance) {
  BEGIN(NAME(ExitInitializationMode), INITIALIZATION);
  if (start(c)) return (STATUS)FAILED;
  c->now->phase = c->now->stepping && !c->now->uses_events ? STEP : EVENT;
  return (STATUS)OK;
}

FMI_EXPORT STATUS FMI(Terminate)(INSTANCE instance) {
  BEGIN(NAME(Terminate), EVENT | CONTINUOUS | STEP);
  c->now->phase = TERMINATED;
  return (STATUS)OK;
}

FMI_EXPORT STATUS FMI(Reset)(INSTANCE instance) {
  BEGIN(NAME(Reset), ANY);
  reset(c, c->now->stepping);
  c->now->uses_events = ((instance_t *)instance)->uses_events;
  return (STATUS)OK;
}

/* --- values ----------------------------------------------------------------------------------- */

/* Number of values behind references, or -1 where one is unknown, with a log line. */
static long total(component_t *c, const char *function, const REFERENCE vr[], size_t count) {
  long sum = 0;
  for (size_t k = 0; k < count; k++) {
    if (!SIZE(c, vr[k])) {
      report(c, FAILED, "logStatusError", "%s: " NO_SUCH, function, vr[k]);
      return -1;
    }
    sum += SIZE(c, vr[k]);
  }
  return sum;
}

/* Refuses unknown references and another number of values than theirs. */
#define COUNTED(function, vr, count, n)                                                            \
  do {                                                                                             \
    const long all = total(c, function, vr, count);                                                \
    if (all < 0) return (STATUS)FAILED;                                                            \
    if ((size_t)all != (n))                                                                        \
      REFUSE(function ": room for %lu values, but the variables have %ld", (unsigned long)(n),     \
             all);                                                                                 \
  } while (0)
#define VALUES(function, vr, count, value, n)                                                      \
  if ((count) && (!(vr) || !(value))) REFUSE(function ": a pointer is missing");                   \
  COUNTED(function, vr, count, n)

static STATUS get_all(component_t *c, const REFERENCE vr[], size_t count, REAL *value) {
  status_t worst = OK;
  for (size_t k = 0; k < count; value += SIZE(c, vr[k]), k++) {
    status_t s = get_values(c, vr[k], SIZE(c, vr[k]), value);
    worst = s > worst ? s : worst;
  }
  return (STATUS)worst;
}

/* All are set, or none. */
static STATUS set_all(component_t *c, const REFERENCE vr[], size_t count, const REAL *value) {
  for (int sets = 0; sets < 2; sets++) {
    const REAL *next = value;
    for (size_t k = 0; k < count; k++)
      for (unsigned j = 0; j < SIZE(c, vr[k]); j++, next++) {
        const status_t wrong = sets ? OK : check_one(c, vr[k] + j, *next);
        if (wrong) return (STATUS)wrong;
        if (sets) set_value(c, vr[k] + j, *next);
      }
  }
  return (STATUS)OK;
}

static int is_unknown(int kind) { return kind == CALCULATED || kind == EXACT; }
static int is_known(int kind) { return kind != CALCULATED; }

/* Both directions: seeds go to the references `from`, products come from the references `to`. */
static STATUS products(component_t *c, int transposed, const REFERENCE from[], size_t n_from,
                       const REAL seed[], const REFERENCE to[], size_t n_to, REAL value[]) {
  memset(c->seed, 0, (size_t)c->model->n_values * sizeof *c->seed);
  for (size_t k = 0; k < n_from; k++)
    for (unsigned j = 0; j < SIZE(c, from[k]); j++) c->seed[from[k] + j] += *seed++;
  derive(c, transposed);
  for (size_t k = 0; k < n_to; value += SIZE(c, to[k]), k++) {
    const status_t s = check_grown(c, to[k], SIZE(c, to[k]));
    if (s) return (STATUS)s;
    memcpy(value, c->grown + to[k], SIZE(c, to[k]) * sizeof *value);
  }
  return (STATUS)OK;
}

#define CHECK_PRODUCTS(function, n_of_unknowns, n_of_knowns)                                       \
  if ((n_unknowns && !unknowns) || (n_knowns && !knowns) || !seed || !value)                       \
    REFUSE(function ": a pointer is missing");                                                     \
  COUNTED(function, unknowns, n_unknowns, n_of_unknowns);                                          \
  COUNTED(function, knowns, n_knowns, n_of_knowns);                                                \
  for (size_t k = 0; k < n_unknowns; k++)                                                          \
    if (!is_unknown(kind_of(c->model, unknowns[k])))                                               \
      REFUSE(function ": %s is not an unknown; give states or calculated variables",               \
             c->model->names[unknowns[k]]);                                                        \
  for (size_t k = 0; k < n_knowns; k++)                                                            \
    if (!is_known(kind_of(c->model, knowns[k])))                                                   \
  REFUSE(function ": %s is not a known; give inputs, states or parameters",                        \
         c->model->names[knowns[k]])

/* --- FMU states ------------------------------------------------------------------------------- */

FMI_EXPORT STATUS FMI(GetFMUState)(INSTANCE instance, FMU_STATE *state) {
  BEGIN(NAME(GetFMUState), ANY);
  if (!state || (*state && !saved(c, *state))) REFUSE(NAME(GetFMUState) ": a pointer is missing");
  return (STATUS)save(c, state);
}

FMI_EXPORT STATUS FMI(SetFMUState)(INSTANCE instance, FMU_STATE state) {
  BEGIN(NAME(SetFMUState), ANY);
  return (STATUS)restore_saved(c, state);
}

FMI_EXPORT STATUS FMI(FreeFMUState)(INSTANCE instance, FMU_STATE *state) {
  BEGIN(NAME(FreeFMUState), ANY);
  if (!state || !*state) return (STATUS)OK;
  if (!saved(c, *state)) return (STATUS)FAILED;
  free(*state);
  *state = NULL;
  return (STATUS)OK;
}

FMI_EXPORT STATUS FMI(SerializedFMUStateSize)(INSTANCE instance, FMU_STATE state, size_t *size) {
  BEGIN(NAME(SerializedFMUStateSize), ANY);
  if (!size) REFUSE(NAME(SerializedFMUStateSize) ": a pointer is missing");
  if (!saved(c, state)) return (STATUS)FAILED;
  *size = state_bytes(c->model);
  return (STATUS)OK;
}

FMI_EXPORT STATUS FMI(SerializeFMUState)(INSTANCE instance, FMU_STATE state, BYTE bytes[],
                                         size_t size) {
  BEGIN(NAME(SerializeFMUState), ANY);
  const saved_t *s = saved(c, state);
  if (!s) return (STATUS)FAILED;
  if (!bytes || size < state_bytes(c->model))
    REFUSE(NAME(SerializeFMUState) ": the buffer is missing or too small");
  write_state(c->model, &s->memory, (unsigned char *)bytes);
  return (STATUS)OK;
}

FMI_EXPORT STATUS FMI(DeserializeFMUState)(INSTANCE instance, const BYTE bytes[], size_t size,
                                           FMU_STATE *state) {
  BEGIN(NAME(DeserializeFMUState), ANY);
  if (!state) REFUSE(NAME(DeserializeFMUState) ": a pointer is missing");
  return (STATUS)read_bytes(c, (const unsigned char *)bytes, size, state);
}

/* --- Model Exchange --------------------------------------------------------------------------- */

FMI_EXPORT STATUS FMI(EnterContinuousTimeMode)(INSTANCE instance) {
  SYSTEM_ONLY(NAME(EnterContinuousTimeMode), EVENT);
  c->now->phase = CONTINUOUS;
  return (STATUS)OK;
}

FMI_EXPORT STATUS FMI(CompletedIntegratorStep)(INSTANCE instance, BOOLEAN no_return,
                                               BOOLEAN *enter_event_mode, BOOLEAN *terminate) {
  SYSTEM_ONLY(NAME(CompletedIntegratorStep), CONTINUOUS);
  (void)no_return;
  if (!enter_event_mode || !terminate)
    REFUSE(NAME(CompletedIntegratorStep) ": a pointer is missing");
  *enter_event_mode = *terminate = 0;
  return (STATUS)OK;
}

FMI_EXPORT STATUS FMI(SetTime)(INSTANCE instance, REAL time) {
  SYSTEM_ONLY(NAME(SetTime), EVENT | CONTINUOUS);
  if (!(fabs(time) < 1e300)) REFUSE(NAME(SetTime) ": t = %g s is refused", time);
  set_time(c, time);
  return (STATUS)OK;
}

/* What takes or gives a number for each continuous state */
#define OF_STATES(name, phases, type, action)                                                      \
  FMI_EXPORT STATUS FMI(name)(INSTANCE instance, type x[], size_t count) {                         \
    SYSTEM_ONLY(NAME(name), phases);                                                               \
    OF_SIZE(NAME(name), x, count, c->model->n_states);                                             \
    return (STATUS)action;                                                                         \
  }
OF_STATES(SetContinuousStates, EVENT | CONTINUOUS, const REAL, set_states(c, x))
OF_STATES(GetContinuousStates, ME_RUNNING, REAL, get_states(c, x, 0))
OF_STATES(GetContinuousStateDerivatives, ME_RUNNING, REAL, get_states(c, x, 1))
OF_STATES(GetNominalsOfContinuousStates, ANY, REAL,
          (memcpy(x, section(c->model, D_NOMINALS), count * sizeof *x), OK))

FMI_EXPORT STATUS FMI(GetEventIndicators)(INSTANCE instance, REAL indicator[], size_t count) {
  SYSTEM_ONLY(NAME(GetEventIndicators), ME_RUNNING);
  (void)indicator;
  if (count) REFUSE(NAME(GetEventIndicators) ": there are none");
  return (STATUS)OK;
}
