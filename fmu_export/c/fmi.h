/* What fmi2.c and fmi3.c share: instances, call order, access to values, FMU states. */
#ifndef CONTACT_FMI
#define CONTACT_FMI
#include "component.c"
/* */
#include "state.c"
/* */
#ifdef SCENE_INSIDE
#include "scene.c"
#else
#include "resource.c"
#endif

#if defined(_WIN32)
#define FMI_EXPORT __declspec(dllexport)
#else
#define FMI_EXPORT __attribute__((visibility("default")))
#endif

#define CATEGORIES 4

typedef struct {
  component_t component;
  void (*log)(void); /* the importer's logger, of the type its version of FMI says */
  void *environment;
  int uses_events, early_return, logging[CATEGORIES];
  char name[256];
} instance_t;

typedef struct {
  unsigned long long mark;  /* not the first word that a model's digest is: importers look at it */
  unsigned long long model; /* whose it is: those of others are of other sizes */
  memory_t memory;          /* and what follows it */
} saved_t;
#define SAVED_MARK 0x636f6e7461637473ULL

/* where values can be got */
#define RUNNING (INITIALIZATION | EVENT | CONTINUOUS | STEP | TERMINATED)
#define ANY (INSTANTIATED | CONFIGURATION | RUNNING)
#define ME_RUNNING (INITIALIZATION | EVENT | CONTINUOUS | TERMINATED)

/* position of a category in LogCategories, or -1 */
static inline int category_index(const char *category) {
  static const char *const known[CATEGORIES] = {"logStatusWarning", "logStatusDiscard",
                                                "logStatusError", "logEvents"};
  for (int k = 0; k < CATEGORIES; k++)
    if (category && !strcmp(category, known[k])) return k;
  return -1;
}

/* Whether the importer is told. Errors it always is, as FMI 2.0.5 expects (section 2.1.3): FMI
   3.0.2 silences them with loggingOn = false, but its successor takes that back, and the
   Reference FMUs never did. */
static inline int is_told(const instance_t *instance, status_t status, const char *category) {
  const int k = category_index(category);
  return instance->log && (status == FAILED || (k >= 0 && instance->logging[k]));
}

static inline status_t allowed(component_t *c, const char *function, int phases) {
  static const char *const name[] = {"instantiated",         "initialization mode", "event mode",
                                     "continuous-time mode", "step mode",           "terminated",
                                     "configuration mode"};
  const int phase = c->now->phase, never = c->now->stepping ? CONTINUOUS : STEP;
  const int over = phase & TERMINATED;
  const char *own = "", *remedy = over ? "; reset, or set an FMU state" : "";
  char others[192] = "";
  if (phase & phases) return OK;
  for (int k = 0; k < (int)(sizeof name / sizeof *name); k++) {
    if (phase >> k & 1) own = name[k];
    if ((phases & ~never) >> k & 1) strcat(strcat(others, *others ? ", " : ""), name[k]);
  }
  return report(c, FAILED, "logStatusError", "%s is not allowed in the state '%s', only in: %s%s",
                function, own, *others ? others : "the other interface", remedy);
}

#define BEGIN(function, phases)                                                                    \
  if (!instance) return (STATUS)FAILED;                                                            \
  component_t *c = &((instance_t *)instance)->component;                                           \
  if (allowed(c, function, phases)) return (STATUS)FAILED

#define NO_SUCH "there is no variable with value reference %u; see modelDescription.xml"
#define REFUSE(...) return (STATUS)report(c, FAILED, "logStatusError", __VA_ARGS__)
/* Functions of one interface only, of Model Exchange or of Co-Simulation */
#define SYSTEM_ONLY(function, phases)                                                              \
  BEGIN(function, phases);                                                                         \
  if (c->now->stepping) REFUSE(function ": the instance was made for Co-Simulation")
#define STEPPING_ONLY(function, phases)                                                            \
  BEGIN(function, phases);                                                                         \
  if (!c->now->stepping) REFUSE(function ": the instance was made for Model Exchange")
#define OF_SIZE(function, pointer, count, right)                                                   \
  if (!(pointer) || (count) != (size_t)(right))                                                    \
  REFUSE(function ": a pointer is missing, or the count is not %ld", (long)(right))

/* Some categories, or without any all of them. */
static inline status_t set_logging(instance_t *own, const char *function, int on, size_t count,
                                   const char *const categories[]) {
  for (size_t k = 0; k < count; k++)
    if (!categories || category_index(categories[k]) < 0)
      return report(&own->component, FAILED, "logStatusError",
                    "%s: unknown category '%.80s'; use those of modelDescription.xml", function,
                    categories && categories[k] ? categories[k] : "");
  for (int k = 0; k < CATEGORIES; k++) own->logging[k] = count ? own->logging[k] : on;
  for (size_t k = 0; k < count; k++) own->logging[category_index(categories[k])] = on;
  return OK;
}

static inline int settable(const component_t *c, unsigned reference) {
  const memory_t *now = c->now;
  const int before = INSTANTIATED | CONFIGURATION | INITIALIZATION;
  const int free = before | EVENT | (now->uses_events ? 0 : STEP);
  switch (kind_of(c->model, reference)) {
  case FIXED:
    return now->phase & before;
  /* Importers such as CasADi's set continuous states one by one. */
  case EXACT:
    return now->phase & (before | (now->stepping ? 0 : EVENT | CONTINUOUS));
  case TUNABLE:
    return now->phase & free;
  case INPUT:
    return now->phase & (before | EVENT | CONTINUOUS | STEP);
  default:
    return 0;
  }
}

static inline status_t check_one(component_t *c, unsigned reference, double value) {
  static const char *const remedy[] = {
      [CALCULATED] = "is calculated; disturb the motion by the inputs, or where coordinates are to "
                     "be start values, export with states=\"chart\"",
      [INDEPENDENT] = "is time; it is set by steps, or by SetTime",
      [FIXED] = "is fixed; set it before initialization ends, or reset first",
      [TUNABLE] = "is tunable; set it in event mode",
      [INPUT] = "is an input; set it before the simulation ends, or reset first",
      [EXACT] = "is a start value; set it before initialization ends, or use the inputs"};
  if (!settable(c, reference))
    return report(c, FAILED, "logStatusError", "%s = %.9g is refused now: it %s",
                  c->model->names[reference], value, remedy[kind_of(c->model, reference)]);
  return check_value(c, reference, value);
}

/* The windows that act while the importer initializes. */
static inline void enter_initialization(component_t *c, double time) {
  set_time(c, time);
  enter_windows(c);
  c->now->phase = INITIALIZATION;
}

/* Values are those after the event from here on, and no update changes them any more: importers
   pass them on between the two (FMI 3.0.2, 2.3.5). */
static inline void enter_event_mode(component_t *c) {
  enter_windows(c);
  c->now->phase = EVENT;
}

static inline saved_t *new_saved(const component_t *c) {
  saved_t *s = calloc(1, sizeof *s - sizeof s->memory + memory_size(c->model));
  if (s) s->mark = SAVED_MARK, s->model = model_digest(c->model);
  return s;
}

static inline status_t save(component_t *c, void **state) {
  saved_t *s = *state ? *state : new_saved(c);
  if (!s) return report(c, FAILED, "logStatusError", "no memory for an FMU state");
  memcpy(&s->memory, c->now, memory_size(c->model));
  /* what was calculated is no part of it */
  double *value = (double *)(&s->memory + 1);
  for (long r = 0; r < c->model->n_values; r++) {
    const int kind = kind_of(c->model, (unsigned)r);
    if (kind == CALCULATED || (kind == EXACT && !SYSTEM(c->now))) value[r] = 0.0;
  }
  *state = s;
  return OK;
}

static inline saved_t *saved(component_t *c, void *state) {
  saved_t *s = state;
  if (s && s->mark == SAVED_MARK && s->model == model_digest(c->model)) return s;
  report(c, FAILED, "logStatusError",
         "this is no FMU state, or another model's; give one that this model handed out and that "
         "has not been freed");
  return NULL;
}

static inline status_t restore_saved(component_t *c, void *state) {
  const saved_t *s = saved(c, state);
  if (!s) return FAILED;
  if (s->memory.stepping != c->now->stepping)
    return report(c, FAILED, "logStatusError", "this FMU state belongs to the other interface, %s",
                  s->memory.stepping ? "Co-Simulation" : "Model Exchange");
  memcpy(c->now, &s->memory, memory_size(c->model));
  forget(c);
  c->now->uses_events = ((const instance_t *)c->host)->uses_events;
  if (c->now->phase == EVENT && c->now->stepping && !c->now->uses_events) c->now->phase = STEP;
  if (c->now->pending && !c->now->uses_events) enter_windows(c);
  return OK;
}

static inline status_t read_bytes(component_t *c, const unsigned char *bytes, size_t count,
                                  void **state) {
  saved_t *s = new_saved(c);
  const char *wrong = !s       ? "out of memory"
                      : !bytes ? "a pointer is missing"
                               : read_state(c->model, bytes, count, &s->memory);
  if (wrong) {
    free(s);
    return report(c, FAILED, "logStatusError",
                  "serialized FMU state refused: %s; use the bytes "
                  "that this FMU wrote, as they are",
                  wrong);
  }
  if (*state) free(*state);
  *state = s;
  return OK;
}

/* FMI leaves the sign of the start open; a scene's profile and windows count from t = 0. */
static inline status_t check_times(component_t *c, double start, int stop_defined, double stop) {
  if (start >= 0 && start < 1e300 && (!stop_defined || stop >= start)) return OK;
  return report(c, FAILED, "logStatusError",
                "start %g s and stop %g s are refused; give "
                "0 <= start <= stop, the profile counts from t = 0",
                start, stop_defined ? stop : HUGE_VAL);
}

static inline status_t check_step(component_t *c, double from, double size) {
  const double end = from + size, room = 1e-9 * fmax(1.0, fabs(end));
  if (!(size > 0) || !(fabs(end) < 1e300)) /* FMI 2 and 3 alike: h must be greater than 0 */
    return report(c, FAILED, "logStatusError",
                  "a step of %g s from t = %g s is refused; give a "
                  "positive length; to go back, set an FMU state",
                  size, from);
  if (fabs(from - c->now->time) > room)
    return report(c, FAILED, "logStatusError",
                  "the step begins at t = %.17g s, but the instance "
                  "stands at t = %.17g s; give that time, or set an FMU state",
                  from, c->now->time);
  if (end > c->now->stop_time + room)
    return report(c, FAILED, "logStatusError",
                  "the step ends at t = %.17g s, after the stop time "
                  "%.17g s; give a later one, or none",
                  end, c->now->stop_time);
  return OK;
}

#endif
