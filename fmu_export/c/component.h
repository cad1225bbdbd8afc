/* A scene as a component that can be stepped or evaluated. fmi2.c and fmi3.c use nothing else of
   it, and it knows nothing of FMI.

   One set of values is computed in two ways. In Co-Simulation the engine plans each contact far
   ahead from its last event; a step only moves the time, so that results do not depend on the
   steps' sizes. A change of an input or of the gain is an event: a new plan starts from the moment
   (engine.h) that the old one has reached. In Model Exchange, and during initialization in both,
   all results are functions of the states, by a table of instructions that the engine runs.

   The FMI layer defines status_t: OK, DISCARD and FAILED; and logger_t. Everything is static:
   fmi2.c and fmi3.c each include all of it, so that names do not clash. What sets up or starts
   something and returns a text returns what is wrong, or NULL. */
#ifndef CONTACT_COMPONENT
#define CONTACT_COMPONENT
#include "model.h"

#include <fenv.h>

enum {
  INSTANTIATED = 1,
  INITIALIZATION = 2,
  EVENT = 4,
  CONTINUOUS = 8,
  STEP = 16,
  TERMINATED = 32
};

enum { U1, V1, DU1, DV1, U2, V2, DU2, DV2, PSI, N_STATES };

/* What a contact is planned from: its state at the last event, and what acts besides windows */
typedef struct {
  double begin, end;                 /* s; planned to the end, or to be planned */
  double gain, acting[DISTURBANCES]; /* acting: inputs */
  double trigger;                    /* its value at the last `settle` */
  double row[CONTACT_SIZE]; /* see engine.h; only K_MOMENT, and K_PLACE_1 and on, are set */
} segment_t;

/* All that an FMU state has to copy, without pointers. Values and segments follow it in memory. */
typedef struct {
  int phase, stepping;
  int settled; /* segments have the present inputs and gain */
  int pending; /* time is at an edge of a window or leg, and values are still those before it */
  int jumped;  /* in Model Exchange: a window has begun or ended, and no update has told so */
  int ended;   /* the last step was to pass the limit, or an event was at the limit */
  double time, stop_time;
  double acts_at; /* values are of this time: `time`, or the edge that it is at, or while pending
                     the greatest number below that edge */
  double limit;   /* where sigma turns negative */
} memory_t;

/* An FMU state; serialized, the same bytes */
typedef struct {
  unsigned long long mark, version, length, model, checksum;
  memory_t memory; /* and what follows it */
} saved_t;

/* What can be computed again from the state, of one contact */
typedef struct {
  plan_t *plan;   /* of its segment, or NULL */
  int derived;    /* whether its derivatives are asked for */
  unsigned valid; /* bits of the groups whose values are up to date */
} live_t;

typedef struct {
  model_t *model;
  const engine_t *engine;
  saved_t *fmu_state;
  memory_t *now; /* in *fmu_state; value and segment follow it there */
  double *value;
  segment_t *segment;
  live_t *live;
  double *scene;                 /* the engine's buffer, of one contact at a time; behind it: */
  double *scratch;               /* for windows and numbers, constants of tables, roots */
  double (*tangents)[L];         /* derivatives of all values in L directions */
  double *registers;             /* of the table that is run */
  double (*system_tangents)[L];  /* of the registers of a contact's equations */
  double (*surface_tangents)[L]; /* of the registers of a surface's tables, for the start */
  failure_t failure;
  const char *called; /* the function of FMI that the importer has called */
  logger_t log;       /* the importer's, or NULL */
  void *environment;  /* the logger's */
  char name[256];
  int uses_events, early_return; /* the importer handles events; and steps that end early */
  int changed, evaluated; /* an input changed in continuous time; then rates were evaluated */
} component_t;

#define MOST_PANELS 20000.0 /* of one plan: a second of work, kilometres of path */

/* whether results are computed from the states, else from plans */
#define FROM_STATES(now) (!(now)->stepping || ((now)->phase & (INSTANTIATED | INITIALIZATION)))

/* The engine may compute with NaN; importers may trap invalid operations. */
#define UNTRAPPED(...)                                                                             \
  do {                                                                                             \
    fenv_t traps;                                                                                  \
    feholdexcept(&traps);                                                                          \
    __VA_ARGS__;                                                                                   \
    fesetenv(&traps);                                                                              \
  } while (0)

static void forget_values(component_t *c) {
  for (long i = 0; i < c->model->n_contacts; i++) c->live[i].valid = 0;
}

static inline int all_finite(const double *x, long n) {
  for (long i = 0; i < n; i++)
    if (!isfinite(x[i])) return 0;
  return 1;
}

/* Hands a text to the importer; defined by the FMI layer. */
static void log_text(component_t *, status_t, const char *text);

/* Logs a text, in the category of the status, and returns the status. */
static status_t report(component_t *, status_t, const char *format, ...)
#if defined(__GNUC__)
    __attribute__((format(printf, 3, 4)))
#endif
    ;
#define REFUSE(...) return report(c, FAILED, __VA_ARGS__)

#endif
