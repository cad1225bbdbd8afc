/* A scene that is stepped or evaluated: all that fmi2.c and fmi3.c know of it, and nothing of FMI.

   Two ways through one set of variables. As a block that steps itself (Co-Simulation) each contact
   is moved in frame coordinates, panel by panel of Gauss collocation (panels.c); the Chebyshev
   series of a panel is kept, so that a step inside a panel is an evaluation and nothing
   depends on how the horizon is cut into steps. As a system of equations (Model Exchange, and
   initialization in both) everything is a function of the eleven states of each contact.

   model.h and model.c are generated for one scene: sizes, kernels, tables. */
#ifndef CONTACT_COMPONENT
#define CONTACT_COMPONENT
#include <float.h>
#include <math.h>
#include <string.h>

#include "model.h"

/* omp simd is for compilers that are told of it (-fopenmp-simd) */
#if defined(__GNUC__)
#pragma GCC diagnostic ignored "-Wunknown-pragmas"
#endif
#if !defined(__GNUC__) && !defined(__clang__)
#define __attribute__(words) /* hints for the optimizer */
#endif

/* An infinite time is one that never comes, and a value that is no number is refused. */
#if defined(_M_FP_FAST) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__)
#error "this model needs infinities and NaN: compile without -ffast-math, -Ofast or /fp:fast"
#endif

/* Only FMI's functions are seen outside: names like `step` would meet others in one process. */
#if defined(__GNUC__)
#pragma GCC visibility push(hidden)
#endif

/* The BLOCK_SIZE numbers of a contact begin AT_INPUT, AT_STATE, AT_RATE, AT_SLIP, AT_TWIST, AT_POSE
   and AT_POINTS: model.h. In a state, and in its rates, u v of a body begin at BODY * body. */
enum { BODY = 5, FRAME_ANGLE = 2, VELOCITY = 3, ANGLE = 10 };

typedef enum { OK, WARNING, DISCARD, FAILED } status_t; /* numbered as in FMI 2 and 3 */

enum { PATH, TIME, GUARANTEED };                                /* gain laws */
enum { CALCULATED, INDEPENDENT, FIXED, TUNABLE, INPUT, EXACT }; /* what a value is; see `kinds` */

/* --- what model.c says of the scene ----------------------------------------------------------- */

typedef const double *const *arguments_t;
typedef void (*kernel_t)(arguments_t, double *); /* a[i] points to the numbers of argument i */

enum { L = 16, TERMS = L + 1 }; /* Gauss points of a panel, terms of its series */

/* one contact's motion in one pair of forms: its states are the frames of finger and object, and
   where n_stiff is 2, W_1 and V after them */
typedef struct {
  long n_states, n_stiff;
  double reach; /* sizes by which states change in a panel at most */
  /* at the nodes: states, sigma, decay and local time -> rates */
  void (*rates)(double (*x)[L], const double *constants, double (*f)[L]);
  kernel_t restore; /* states, constants -> states back on their surfaces; NULL: as they are */
} motion_t;

enum { IN_CHART = 3, IN_SPACE = 6 }; /* numbers of a frame: u v theta, or x p */

/* forms of finger and object */
typedef struct {
  long size[2];
  const motion_t *motion;
  kernel_t coordinates[2]; /* frame, c, numbers -> u v u' v' theta */
  kernel_t slip;           /* frame of the object, theta2, sigma V, offset, numbers of the object */
  kernel_t outputs;        /* time, frames, W1 V, disturbance, law, numbers of both: AT_TWIST.. */
} form_t;

enum { DRIVEN, PUSHED_FINGER, PUSHED_OBJECT, N_FORMS }; /* nothing, the finger alone, the object */

typedef struct {
  int double_cover;          /* (-u, pi - v) is the same point as (u, v) */
  double period_u, period_v; /* 0: none */
} winding_t;

typedef struct {
  form_t form[N_FORMS];
  kernel_t start;          /* states, numbers of both -> frames, W1, V in the forms of DRIVEN */
  kernel_t spatial[2];     /* u v theta, numbers -> x p; NULL where no form changes */
  kernel_t lame[2];        /* u v theta, numbers -> h_u h_v, and what restricts charts */
  kernel_t regularity;     /* states, numbers of both -> least Lame coefficients, signed */
  kernel_t velocity;       /* turns of the frames, W1 V -> path velocities of finger and object */
  kernel_t drive;          /* sigma, W1 V -> velocities of both contact points along their frames */
  kernel_t rates, results; /* time, states, disturbance, law, numbers: AT_RATE.., AT_SLIP.. */
  kernel_t forward, reverse; /* the same and seeds: products with their Jacobian */
  long n_numbers[2];
  winding_t winding[2]; /* of the coordinates */
  int charted;          /* whether a body is moved in a user's chart, which may have poles */
} contact_kind_t;

typedef struct {
  const contact_kind_t *kind;
  long block, finger; /* where its values begin; the numbers of its finger */
  double size[2];     /* length scales of finger and object, m */
} place_t;

typedef struct {
  long contact;
  double start, stop, value[6];
} window_t;

/* of numbers of a surface the one is greater than the other, or is the other: stays as it is */
typedef struct {
  unsigned greater, less;
} order_t;

extern const place_t places[N_CONTACTS];
extern const order_t orders[]; /* the last is {0, 0} */
extern const window_t windows[N_WINDOWS + 1];
extern const double start_values[N_VALUES], least[N_VALUES], nominals[SYSTEM_STATES * N_CONTACTS];
extern const unsigned char kinds[N_VALUES], sizes[N_VALUES];
extern const char *const model_token, *const names[N_VALUES]; /* of every value, as in FMI 2 */

/* --- one instance ----------------------------------------------------------------------------- */

#define MAX_SIGMA (N_PROFILE + 1)
#define MAX_EXPONENT (2 * N_PROFILE + 1)
#define MAX_KNOTS (2 * N_PROFILE + 2)

/* A contact's motion from `begin` on, while nothing that acts on it changes. */
typedef struct {
  int form, power;
  double begin, end;                    /* s; `end`: the next edge that concerns this contact */
  double disturbance[6], slope[6], eta; /* what acts: input and windows, input rates, gain */
  double sigma[MAX_SIGMA], exponent[MAX_EXPONENT];
  long n_sigma, n_exponent;
  double w1[2], v[2]; /* at begin */
  double constants[MAX_CONSTANTS], scale[MAX_STATES], greatest;
  double from, to, next; /* current panel, local time; length to try next */
  double first[MAX_STATES], last[MAX_STATES], series[MAX_STATES * TERMS];
  /* u v theta of both bodies at the quarters of the panel */
  double anchor[2][5][3];
  double turn[2]; /* from the frames moved here to those of the states */
  double theta;   /* of the object, where the results stand */
} contact_t;

typedef enum {
  INSTANTIATED = 1,
  INITIALIZATION = 2,
  EVENT = 4,
  CONTINUOUS = 8,
  STEP = 16,
  TERMINATED = 32,
  BROKEN = 64,
  CONFIGURATION = 128,
  INTERMEDIATE = 256
} phase_t;

/* Everything that changes, and nothing else: the FMU state is a copy of it. No pointers. */
typedef struct {
  int phase, stepping, uses_events, settled;
  int pending; /* an edge is reached, its windows are not yet taken over */
  double time, stop_time;
  double limit;            /* where sigma turns negative */
  int ended;               /* the last step asked for goes beyond that, or an event was there */
  double knots[MAX_KNOTS]; /* where sigma grows, from knots[2 k] to knots[2 k + 1] */
  long n_knots;
  double value[N_VALUES];
  double input_slope[N_CONTACTS][6], slope_begin, window[N_CONTACTS][6];
  unsigned valid[N_CONTACTS]; /* groups of results that belong to time and inputs */
  contact_t contact[N_CONTACTS];
} memory_t;

/* A contact at one time: its frames where they stand in y, W1 and V, and what acts. */
typedef struct {
  double y[MAX_STATES], w1v[4], sigma, disturbance[6];
  const double *frame[2];
} moment_t;

typedef struct component {
  memory_t now;
  contact_t before[N_CONTACTS]; /* as a step found them, should it fail */
  moment_t moment[N_CONTACTS];  /* at the present time, where memory_t.valid says so */
  int warned[N_CONTACTS][2];    /* the path is near a pole, and the log says so */
  double trial[MAX_STATES * TERMS], seed[N_VALUES], grown[N_VALUES];
  void (*report)(struct component *, status_t, const char *category, const char *text);
  void *host; /* of the FMI layer */
} component_t;

/* whether states are given and results follow from them, else frames are */
#define SYSTEM(now)                                                                                \
  (!(now)->stepping || ((now)->phase & (INSTANTIATED | CONFIGURATION | INITIALIZATION)))

static inline const double *law(const memory_t *now) { return now->value + GAIN; }

/* --- sigma and the gain ----------------------------------------------------------------------- */

/* polynomials in local time, lowest power first; the decay of slip gets (sigma(0)/sigma)^power */
typedef struct {
  long n_sigma, n_exponent, power;
  const double *sigma, *exponent;
} drive_t;

static inline double horner(const double *c, long n, double x) {
  double y = c[n - 1];
  for (long k = n - 2; k >= 0; k--) y = y * x + c[k];
  return y;
}

/* dy/dx of the same */
static inline double slope(const double *c, long n, double x) {
  double y = 0.0;
  for (long k = n - 1; k >= 1; k--) y = y * x + k * c[k];
  return y;
}

/* lam at a local time */
static inline double gain_at(const drive_t *d, double tau) {
  double lam = slope(d->exponent, d->n_exponent, tau);
  if (d->power) lam += slope(d->sigma, d->n_sigma, tau) / horner(d->sigma, d->n_sigma, tau);
  return lam;
}

/* exp(-(L(tau) - L(0))) where sigma is given. Less than exp(-100) is nothing, and libm takes long
   over an underflow. */
static inline double decay_at(const drive_t *d, double tau, double sigma) {
  const double lost = horner(d->exponent, d->n_exponent, tau);
  const double decay = lost < 100 ? exp(-lost) : 0.0;
  return d->power && tau > 0 ? decay * (d->sigma[0] / sigma) : decay;
}

/* the sum of the sizes of a polynomial's terms, which its rounding errors are a fraction of */
static inline double magnitude(const double *c, long n, double t) {
  double size = 0.0;
  for (long j = n - 1; j >= 0; j--) size = size * fabs(t) + fabs(c[j]);
  return size;
}

/* Times this near are one time: steps of 0.1 s do not add up to 1 s. The edge may be infinite; a
   tolerance of its size would be too, and inf - inf ends programs that trap invalid operations. */
static inline int reached(double time, double edge) {
  return edge - time <= 8 * DBL_EPSILON * fmax(1.0, fabs(time));
}

static inline int all_finite(const double *x, long n) {
  double sum = 0.0;
  for (long i = 0; i < n; i++) sum += 0.0 * x[i];
  return sum == 0.0;
}

/* --- panels ----------------------------------------------------------------------------------- */

typedef struct {
  const motion_t *motion;
  const drive_t *drive;
  const double *constants, *scale; /* errors are measured in 1/scale */
  double length, slip; /* local time at the end; greatest |V|, where it is 0 there is no decay */
} method_t;

/* where an integration stands: the next panel from tau, of length h at most; a series of `span` to
   start from, or NULL: it ends at tau (the last panel) or begins there (a refused one) */
typedef struct {
  double tau, h, span;
  const double *before;
  int begins;
} step_t;

/* One panel from s->tau: its series, and the state at its end, back on the surfaces. Returns 1;
   0: refused, s->h is what to try next; -1: no solution. */
int panel(const method_t *, step_t *, const double *start, double *series, double *end);
/* Puts a state back on its surfaces; returns the greatest change, in 1/scale. */
double restore(const motion_t *, const double *constants, const double *scale, double *state);

/* Logs and returns the status; the text may hold anything. */
status_t report(component_t *, status_t, const char *category, const char *format, ...)
#if defined(__GNUC__)
    __attribute__((format(printf, 4, 5)))
#endif
    ;

void reset(component_t *, int stepping);
status_t check_value(component_t *, unsigned reference, double value);
void set_value(component_t *, unsigned reference, double value); /* checked before */
status_t get_values(component_t *, unsigned reference, long count, double *value);
status_t set_slope(component_t *, unsigned reference, double slope);

status_t start(component_t *); /* end of initialization */
status_t step(component_t *, double target, int stop_at_windows, int *edge);
void study_profile(memory_t *); /* where sigma grows and ends */
/* Whether a system of equations is asked about times after sigma's end. A solver may look there
   from within its last step, until an event has told the importer that this is the end. */
int past_end(const memory_t *);
double next_window(const memory_t *); /* where one begins or ends; HUGE_VAL: nowhere */
double next_edge(const memory_t *);   /* the same, of the gain's pieces and sigma too */
void enter_windows(component_t *);    /* take over what the windows say at this time */

void set_time(component_t *, double time);
status_t set_states(component_t *, const double *state);
status_t get_states(component_t *, double *state);
status_t get_rates(component_t *, double *rate);

/* grown = J seed (or J^T seed), over references; the caller fills seed, which starts as zeros, and
   checks what it takes of grown */
void forward(component_t *);
void reverse(component_t *);
status_t check_grown(component_t *, unsigned reference, long count);

/* State bytes: header, then memory_t. */
typedef struct {
  char magic[8];
  unsigned long long version, length, model, checksum;
} header_t;
#define STATE_BYTES (sizeof(header_t) + sizeof(memory_t))

unsigned long long model_digest(void); /* tells models apart */
void write_state(const memory_t *, unsigned char *bytes);
/* Returns NULL, or what does not fit. Bytes with the right checksum may have been made by anybody:
   every number that chooses, counts or points is held to what it may be, and those that the motion
   is computed from are finite. */
const char *read_state(const unsigned char *bytes, unsigned long long count, memory_t *);

#if defined(__GNUC__)
#pragma GCC visibility pop
#endif
#endif
