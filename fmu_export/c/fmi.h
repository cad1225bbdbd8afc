/* What FMI 2 and FMI 3 have in common: instances, order of calls, values, FMU states. Before they
   include this, fmi2.c and fmi3.c define what differs:

   FMI(name)     a function's name
   status_t      with OK, DISCARD, FAILED;  logger_t, BOOLEAN, BYTE  types
   ROOM(n)       FMI 3's parameter for how many values an array has; ROOM_OF(count, n): that number
   TOKEN         how the standard calls the token
 */
#include "component.c"
#ifdef SCENE_INSIDE
#include "scene.c"
#else
#include "resource.c"
#endif

#if defined(__GNUC__)
#pragma GCC diagnostic ignored "-Wunused-parameter" /* the standard's signatures, from here on */
#endif
#define PASTED(prefix, name) PASTED_AS_IS(prefix, name)
#define PASTED_AS_IS(prefix, name) prefix##name

static const char *const category_of[] = {[DISCARD] = "logStatusDiscard",
                                          [FAILED] = "logStatusError"};

/* states of the instance in which values can be got, and some may be set */
#define RUNNING (INITIALIZATION | EVENT | CONTINUOUS | STEP | TERMINATED)
#define ANY (INSTANTIATED | RUNNING)
#define SETTABLE (ANY & ~TERMINATED)

static status_t allowed(component_t *c, int phases) {
  static const char *const name[] = {"instantiated",         "initialization mode", "event mode",
                                     "continuous-time mode", "step mode",           "terminated"};
  const int phase = c->now->phase, never = c->now->stepping ? CONTINUOUS : STEP;
  const int over = phase & TERMINATED;
  const char *own = "", *remedy = over ? "; reset, or set an FMU state" : "";
  char others[192] = "";
  if (phase & phases) return OK;
  for (int k = 0; k < (int)(sizeof name / sizeof *name); k++) {
    if (phase >> k & 1) own = name[k];
    if ((phases & ~never) >> k & 1) strcat(strcat(others, *others ? ", " : ""), name[k]);
  }
  return report(c, FAILED, "not allowed in the state '%s', only in: %s%s", own,
                *others ? others : "the other interface", remedy);
}

#define BEGIN(phases)                                                                              \
  if (!instance) return FAILED;                                                                    \
  component_t *c = instance;                                                                       \
  c->called = __func__;                                                                            \
  if (allowed(c, phases)) return FAILED
#define NEEDS(pointers)                                                                            \
  if (!(pointers)) REFUSE("a pointer is missing")
/* Functions of one interface only, of Model Exchange or of Co-Simulation */
#define EXCHANGE_ONLY(phases)                                                                      \
  BEGIN(phases);                                                                                   \
  if (c->now->stepping) REFUSE("the instance was made for Co-Simulation")
#define STEPPING_ONLY(phases)                                                                      \
  BEGIN(phases);                                                                                   \
  if (!c->now->stepping) REFUSE("the instance was made for Model Exchange")
/* Functions that only change the state; that this model does not have; that have no variables, as
   all are of one type */
#define LEADS_TO(phase_after, name, begin)                                                         \
  EXPORT status_t FMI(name)(void *instance) {                                                      \
    begin;                                                                                         \
    c->now->phase = phase_after;                                                                   \
    return OK;                                                                                     \
  }
#define NOT_THERE(name, words, ...)                                                                \
  EXPORT status_t FMI(name)(__VA_ARGS__) {                                                         \
    BEGIN(ANY);                                                                                    \
    REFUSE(words);                                                                                 \
  }
#define OF_NOTHING(name, begin, words, ...)                                                        \
  EXPORT status_t FMI(name)(void *instance, const unsigned vr[], size_t count, __VA_ARGS__) {      \
    begin;                                                                                         \
    if (count) REFUSE(words);                                                                      \
    return OK;                                                                                     \
  }
#define NO_GETTER(name, ...)                                                                       \
  OF_NOTHING(Get##name, BEGIN(RUNNING), "there are no variables of this type", __VA_ARGS__)
#define NO_SETTER(name, ...)                                                                       \
  OF_NOTHING(Set##name, BEGIN(SETTABLE), "there are no variables of this type", __VA_ARGS__)
#define NO_VARIABLES(name, type)                                                                   \
  NO_GETTER(name, type value[] ROOM(n)) NO_SETTER(name, type const value[] ROOM(n))

static component_t *instantiate(const char *called, const char *name, const char *token,
                                const char *resources, logger_t log, void *environment,
                                int stepping) {
  component_t *c = calloc(1, sizeof *c);
  if (!c) return NULL;
  c->called = called, c->log = log, c->environment = environment;
  if (name) strncpy(c->name, name, sizeof c->name - 1);
  const char *wrong = name && *name ? make_component(c, resources) : "the instance has no name";
  if (!wrong && (!token || strcmp(token, token_of(c->model))))
    wrong = "the " TOKEN " is another model's; give that of this FMU's modelDescription.xml";
  if (wrong) {
    report(c, FAILED, "%s", wrong);
    free_component(c);
    return NULL;
  }
  reset(c, stepping);
  return c;
}

EXPORT void FMI(FreeInstance)(void *instance) { free_component(instance); }

/* The reason of a refusal is logged in any case, as FMI 2.0.5 expects of errors (section 2.1.3): of
   themselves importers show no more than a status. FMI 3.0.2 silences errors with loggingOn =
   false, but its successor takes that back, and the Reference FMUs never did. */
EXPORT status_t FMI(SetDebugLogging)(void *instance, BOOLEAN on, size_t count,
                                     const char *const categories[]) {
  BEGIN(ANY);
  for (size_t k = 0; k < count; k++) {
    const char *given = categories && categories[k] ? categories[k] : "";
    if (strcmp(given, category_of[DISCARD]) && strcmp(given, category_of[FAILED]))
      REFUSE("unknown category '%.80s'; use those of modelDescription.xml", given);
  }
  return OK;
}

/* FMI leaves the sign of the start open; a scene's profile and windows count from t = 0. */
static status_t set_times(component_t *c, double start, int stop_defined, double stop) {
  if (!stop_defined) stop = HUGE_VAL;
  if (!(start >= 0 && start < 1e300 && stop >= start))
    REFUSE("start %g s and stop %g s are refused; give 0 <= start <= stop, the profile counts from "
           "t = 0",
           start, stop);
  set_time(c, start);
  c->now->stop_time = stop;
  return OK;
}

/* Initialization or event mode. Values are those after an event from here on, and no update changes
   them any more: importers pass them on between the two (FMI 3.0.2, 2.3.5). */
static status_t enter_mode(component_t *c, int phase) {
  pass_edges(c);
  c->now->phase = phase;
  return OK;
}

EXPORT status_t FMI(ExitInitializationMode)(void *instance) {
  BEGIN(INITIALIZATION);
  if (start(c)) return FAILED;
  c->now->phase = c->now->stepping && !c->uses_events ? STEP : EVENT;
  return OK;
}

LEADS_TO(TERMINATED, Terminate, BEGIN(EVENT | CONTINUOUS | STEP))

EXPORT status_t FMI(Reset)(void *instance) {
  BEGIN(ANY);
  reset(c, c->now->stepping);
  return OK;
}

/* --- values ----------------------------------------------------------------------------------- */

/* Refuses missing pointers, unknown references and a wrong number of values. */
static status_t check_values(component_t *c, const unsigned vr[], size_t count, const double *value,
                             size_t room) {
  size_t all = 0;
  NEEDS(!count || (vr && value));
  for (size_t k = 0; k < count; all += size_of(c->model, vr[k]), k++)
    if (!size_of(c->model, vr[k]))
      REFUSE("there is no variable with value reference %u; see modelDescription.xml", vr[k]);
  if (all != room)
    REFUSE("room for %lu values, but the variables have %lu", (unsigned long)room,
           (unsigned long)all);
  return OK;
}

static status_t check_one(component_t *c, unsigned reference, double value) {
  enum { BEFORE = INSTANTIATED | INITIALIZATION };
  static const struct {
    int phases;
    const char *remedy;
  } rule[] = {
      [CALCULATED] = {0, "is calculated; disturb the motion by the inputs, or export with measured "
                         "inputs"},
      [INDEPENDENT] = {0, "is time; it is set by steps, or by SetTime"},
      [CONSTANT] = {0, "is constant, as the numbers of its surface depend on each other; export a "
                       "scene with another surface"},
      [FIXED] = {BEFORE, "is fixed; set it before initialization ends, or reset first"},
      [TUNABLE] = {BEFORE | EVENT | STEP, "is tunable; set it in event mode"},
      [INPUT] = {BEFORE | EVENT | CONTINUOUS | STEP,
                 "is an input; set it before the simulation ends, or reset first"},
      /* importers such as CasADi's set continuous states one by one */
      [EXACT] = {BEFORE | EVENT | CONTINUOUS,
                 "is a start value; set it before initialization ends, or use the inputs"}};
  const int kind = (int)c->model->values[reference].kind;
  int phases = rule[kind].phases;
  if (kind == EXACT && c->now->stepping) phases = BEFORE;
  if (kind == TUNABLE && c->uses_events) phases &= ~STEP;
  if (!(c->now->phase & phases))
    REFUSE("%s = %.9g is refused now: it %s", name_of(c->model, reference), value,
           rule[kind].remedy);
  return check_value(c, reference, value);
}

EXPORT status_t FMI(GetReal)(void *instance, const unsigned vr[], size_t count,
                             double value[] ROOM(n)) {
  BEGIN(GETTABLE);
  if (check_values(c, vr, count, value, ROOM_OF(count, n))) return FAILED;
  status_t worst = OK;
  for (size_t k = 0; k < count; value += size_of(c->model, vr[k]), k++) {
    if (c->now->phase == INSTANTIATED && c->model->values[vr[k]].kind == CALCULATED)
      REFUSE("%s is calculated and has no start value; ask from initialization on",
             name_of(c->model, vr[k]));
    const status_t s = get_values(c, vr[k], (long)size_of(c->model, vr[k]), value);
    worst = s > worst ? s : worst;
  }
  return worst;
}

/* All are set, or none. */
EXPORT status_t FMI(SetReal)(void *instance, const unsigned vr[], size_t count,
                             const double value[] ROOM(n)) {
  BEGIN(SETTABLE);
  if (check_values(c, vr, count, value, ROOM_OF(count, n))) return FAILED;
  const double *next = value;
  EACH_VALUE(r, vr, count) {
    const status_t wrong = check_one(c, r, *next++);
    if (wrong) return wrong;
  }
  EACH_VALUE(r, vr, count) set_value(c, r, *value++);
  return OK;
}

/* Checks and computes these products. Transposed, the seed has the size of the unknowns. */
static status_t products(component_t *c, int transposed, const unsigned unknowns[],
                         size_t n_unknowns, const unsigned knowns[], size_t n_knowns,
                         const double seed[], size_t n_seed, double value[], size_t n) {
  const unsigned *from = transposed ? unknowns : knowns, *to = transposed ? knowns : unknowns;
  const size_t n_from = transposed ? n_unknowns : n_knowns, n_to = n_unknowns + n_knowns - n_from;
  if (check_values(c, from, n_from, seed, n_seed) || check_values(c, to, n_to, value, n))
    return FAILED;
  for (size_t k = 0; k < n_unknowns; k++) {
    const int kind = (int)c->model->values[unknowns[k]].kind;
    if (kind != CALCULATED && kind != EXACT)
      REFUSE("%s is not an unknown; give states or calculated variables",
             name_of(c->model, unknowns[k]));
  }
  for (size_t k = 0; k < n_knowns; k++)
    if (c->model->values[knowns[k]].kind == CALCULATED)
      REFUSE("%s is not a known; give inputs, states or parameters", name_of(c->model, knowns[k]));
  const status_t s = settle(c, c->now->time);
  return s ? s : multiply(c, transposed, unknowns, n_unknowns, knowns, n_knowns, seed, value, n);
}

EXPORT status_t FMI(GetDirectionalDerivative)(void *instance, const unsigned unknowns[],
                                              size_t n_unknowns, const unsigned knowns[],
                                              size_t n_knowns, const double seed[] ROOM(n_seed),
                                              double value[] ROOM(n)) {
  BEGIN(RUNNING);
  return products(c, 0, unknowns, n_unknowns, knowns, n_knowns, seed, ROOM_OF(n_knowns, n_seed),
                  value, ROOM_OF(n_unknowns, n));
}

OF_NOTHING(GetOutputDerivatives, STEPPING_ONLY(STEP | TERMINATED),
           "derivatives are outputs of their own, der(...)", const int orders[],
           double value[] ROOM(n))

/* --- FMU states ------------------------------------------------------------------------------- */

EXPORT status_t FMI(GetFMUState)(void *instance, void **state) {
  BEGIN(ANY);
  NEEDS(state);
  saved_t *s = *state ? saved(c, *state) : new_saved(c->model);
  if (!s) return *state ? FAILED : report(c, FAILED, "no memory for an FMU state");
  memcpy(s, c->fmu_state, c->fmu_state->length);
  *state = s;
  return OK;
}

EXPORT status_t FMI(SetFMUState)(void *instance, void *state) {
  BEGIN(ANY);
  const saved_t *s = saved(c, state);
  if (!s) return FAILED;
  if (s->memory.stepping != c->now->stepping)
    REFUSE("this FMU state belongs to the other interface, %s",
           s->memory.stepping ? "Co-Simulation" : "Model Exchange");
  memcpy(c->fmu_state, s, s->length);
  forget(c);
  if (c->now->phase == EVENT && c->now->stepping && !c->uses_events) c->now->phase = STEP;
  if (c->now->pending && !c->uses_events) pass_edges(c);
  return OK;
}

EXPORT status_t FMI(FreeFMUState)(void *instance, void **state) {
  BEGIN(ANY);
  if (!state || !*state) return OK;
  if (!saved(c, *state)) return FAILED;
  free(*state);
  *state = NULL;
  return OK;
}

EXPORT status_t FMI(SerializedFMUStateSize)(void *instance, void *state, size_t *size) {
  BEGIN(ANY);
  NEEDS(size);
  if (!saved(c, state)) return FAILED;
  *size = c->fmu_state->length;
  return OK;
}

EXPORT status_t FMI(SerializeFMUState)(void *instance, void *state, BYTE bytes[], size_t size) {
  BEGIN(ANY);
  saved_t *s = saved(c, state);
  if (!s) return FAILED;
  if (!bytes || size < s->length) REFUSE("the buffer is missing or too small");
  s->checksum = checksum_of(c->model, s);
  memcpy(bytes, s, s->length);
  return OK;
}

/* The checksum guards against damage, not against forgery. */
EXPORT status_t FMI(DeserializeFMUState)(void *instance, const BYTE bytes[], size_t size,
                                         void **state) {
  BEGIN(ANY);
  NEEDS(state);
  const saved_t *own = c->fmu_state;
  saved_t *s = new_saved(c->model);
  const char *wrong = NULL;
  if (!s)
    wrong = "there is no memory";
  else if (!bytes || size != own->length || memcmp(bytes, own, offsetof(saved_t, checksum)))
    wrong = "it belongs to another model or another version";
  else if (memcpy(s, bytes, size), s->checksum != checksum_of(c->model, s))
    wrong = "its checksum does not match; it has been changed";
  if (wrong) {
    free(s);
    REFUSE("serialized FMU state refused: %s; use the bytes that this FMU wrote, as they are",
           wrong);
  }
  *state = s; /* *state is not read, as it may be uninitialized */
  return OK;
}

/* --- Model Exchange --------------------------------------------------------------------------- */

LEADS_TO(CONTINUOUS, EnterContinuousTimeMode, EXCHANGE_ONLY(EVENT))

EXPORT status_t FMI(CompletedIntegratorStep)(void *instance, BOOLEAN no_return,
                                             BOOLEAN *enter_event_mode, BOOLEAN *terminate) {
  EXCHANGE_ONLY(CONTINUOUS);
  NEEDS(enter_event_mode && terminate);
  /* an input has jumped, which the solver's evaluations have not seen: it must restart */
  *enter_event_mode = c->changed && !c->evaluated, *terminate = 0;
  c->now->jumped |= *enter_event_mode;
  c->changed = c->evaluated = 0;
  return OK;
}

EXPORT status_t FMI(SetTime)(void *instance, double time) {
  EXCHANGE_ONLY(EVENT | CONTINUOUS);
  if (!(fabs(time) < 1e300)) REFUSE("t = %g s is refused; give a finite number", time);
  set_time(c, time);
  return OK;
}

/* Functions that take or give a number for each continuous state */
#define STATE_VECTOR(name, phases, type, action)                                                   \
  EXPORT status_t FMI(name)(void *instance, type x[], size_t count) {                              \
    EXCHANGE_ONLY(phases);                                                                         \
    if (!x || count != (size_t)c->model->n_states)                                                 \
      REFUSE("a pointer is missing, or the count is not %ld", c->model->n_states);                 \
    return action;                                                                                 \
  }
STATE_VECTOR(SetContinuousStates, EVENT | CONTINUOUS, const double, set_states(c, x))
STATE_VECTOR(GetContinuousStates, RUNNING, double, get_states(c, x, 0))
STATE_VECTOR(GetContinuousStateDerivatives, RUNNING, double, get_states(c, x, 1))
STATE_VECTOR(GetNominalsOfContinuousStates, ANY, double,
             (memcpy(x, data_at(c->model, c->model->head->nominals), count * sizeof *x), OK))

EXPORT status_t FMI(GetEventIndicators)(void *instance, double indicator[], size_t count) {
  EXCHANGE_ONLY(RUNNING);
  if (count) REFUSE("there are no event indicators");
  return OK;
}

/* --- events and steps ------------------------------------------------------------------------- */

/* The results of an update of discrete states. `values` is true also where only a window or an
   input has jumped, so that importers restart their solvers. */
static void update(component_t *c, BOOLEAN *terminate, BOOLEAN *values, BOOLEAN *next_defined,
                   double *next_time) {
  pass_edges(c);
  const double next = next_edge(c);
  *terminate = c->now->ended && !c->now->stepping, *values = c->now->jumped;
  *next_defined = next < HUGE_VAL, *next_time = *next_defined ? next : 0.0;
  c->now->jumped = 0;
}

static status_t check_step(component_t *c, double from, double size) {
  const double end = from + size, tolerance = 1e-9 * fmax(1.0, fabs(end));
  if (!(size > 0) || !(fabs(end) < 1e300) ||
      end < c->now->time) /* FMI 2 and 3 alike: h must be greater than 0 */
    REFUSE("a step of %g s from t = %g s is refused; give a positive length; to go back, set an "
           "FMU state",
           size, from);
  if (fabs(from - c->now->time) > tolerance)
    REFUSE("the step begins at t = %.17g s, but the instance stands at t = %.17g s; give that "
           "time, or set an FMU state",
           from, c->now->time);
  if (end > c->now->stop_time + tolerance)
    REFUSE("the step ends at t = %.17g s, after the stop time %.17g s; give a later one, or none",
           end, c->now->stop_time);
  return OK;
}
