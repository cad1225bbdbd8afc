/* A scene that is stepped or evaluated: all that fmi2.c and fmi3.c know of it, and nothing of FMI.

   Two ways through one set of values. As a block that steps itself (Co-Simulation) each contact is
   planned by the engine from its last event on, far ahead; a step is nothing but a later time, so
   that nothing depends on how the horizon is cut. A change of an input or of the gain is an event:
   the contact goes on from the engine's moment under what acts now. As a system of equations
   (Model Exchange, and initialization in both) everything is a function of the states, by a table
   of instructions that the engine runs.

   The FMI layer says what status_t is: OK, DISCARD and FAILED.

   Everything is static: fmi2.c and fmi3.c each include all of it, so that no names meet. */
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

/* How a contact's motion began, and what acts on it besides windows: it is planned from that. */
typedef struct {
  double begin, end; /* s; planned so far, or to be planned */
  double gain, acting[DISTURBANCES];
  double trigger;           /* that has last been heard */
  double row[CONTACT_SIZE]; /* of the engine: K_MOMENT, and K_PLACE_1 and on */
} segment_t;

/* Everything that changes, and nothing else: the FMU state is a copy of it. No pointers. In memory
   values and segments follow. */
typedef struct {
  int phase, stepping;
  int settled; /* segments are those of the inputs and the gain */
  int pending; /* time is at an edge of a window or leg, and values are still those before it */
  int jumped;  /* a window has begun or ended, and the importer does not know */
  int ended;   /* the last step asked for goes beyond sigma's end, or an event was there */
  double time, stop_time;
  double acts_at; /* as time, but at an edge: the edge itself, or while pending a hair before it */
  double limit;   /* where sigma turns negative */
} memory_t;

/* An FMU state, and the bytes of one */
typedef struct {
  unsigned long long mark, version, length, model, checksum;
  memory_t memory; /* and what follows it */
} saved_t;

/* What is known of a contact, and made again where it is not */
typedef struct {
  plan_t *plan;   /* of its segment */
  int derived;    /* whether its derivatives are asked for */
  unsigned valid; /* groups that belong to time and inputs */
} live_t;

typedef struct {
  model_t *model;
  const engine_t *engine;
  saved_t *own;       /* the state */
  memory_t *now;      /* in *own */
  double *value;      /* in *now */
  segment_t *segment; /* in *now */
  live_t *live;
  double *scene;         /* the engine's, of one contact at a time; and what lies behind it: */
  double *room;          /* what is added to it, constants of tables, roots */
  double (*grows)[L];    /* derivatives of all values */
  double *registers;     /* of the table that is run */
  double (*tangents)[L]; /* derivatives of those of equations; */
  double (*along)[L];    /* and of others, by which contacts start */
  failure_t failure;
  const char *called; /* the function of FMI that the importer has called */
  void (*log)(void);  /* its logger, of the type its version of FMI says */
  void *environment;  /* the logger's */
  char name[256];
  int uses_events, early_return; /* the importer handles events; and steps that they end early */
  int changed, follows; /* inputs changed in continuous time; the solver has evaluated that since */
} component_t;

#define MOST_PANELS 20000.0 /* of one plan: a second of work, kilometres of path */

/* whether states are given and results follow from them, else plans are */
#define SYSTEM(now) (!(now)->stepping || ((now)->phase & (INSTANTIATED | INITIALIZATION)))

/* What the engine and tables look at may be no number; importers may trap that. */
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

/* The FMI layer's: hands a text to the importer. */
static void log_text(component_t *, status_t, const char *text);

/* Logs and returns the status, in a category of its own. The text may hold anything. */
static status_t report(component_t *, status_t, const char *format, ...)
#if defined(__GNUC__)
    __attribute__((format(printf, 3, 4)))
#endif
    ;
#define REFUSE(...) return report(c, FAILED, __VA_ARGS__)

#endif
