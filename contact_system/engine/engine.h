/* The engine plans contacts one at a time, and evaluates the plans.

   It knows no surface by name: surfaces and equations are tables of instructions, which
   `contact_system/theory` makes from symbols. Only geodesics of spheres and developable surfaces
   (closed_form.c, steer.c) and branches of charts (branches.c) are written in C. A scene is one
   buffer of numbers, whose layout begins at SCENE_VERSION. Users of the engine (the binding in
   Python, tests, FMUs) need this header alone. */
#ifndef CONTACT_SYSTEM_ENGINE
#define CONTACT_SYSTEM_ENGINE
#include <stddef.h>
#include <stdint.h>

/* An infinite time is one that never comes, and a value that is no number is refused. */
#if defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__
#error "the engine needs infinities and NaN: compile without -ffast-math or -Ofast"
#endif

enum { L = 16 }; /* lanes, computed together: the Gauss points of a panel, or 16 times */

/* ---- tables: straight-line programs on registers of L lanes ---- */

typedef struct {
  uint16_t op, to, a, b;
} code_t;

/* Registers: [inputs][constants][literals][results of the prologue][outputs][temporaries]. The
   prologue computes what depends on constants alone. twin: the body's index in compiled C, or -1 */
typedef struct {
  int32_t n_in, n_const, n_out, n_lit, first_lit, first_out, n_regs, twin;
  const code_t *prologue, *body;
  const double *literals;
} table_t;

/* The tables by which a body's contact point moves: see theory/development.py. The state is u v
   theta in the chart, x p in space; M_ tables are in both, C_ in the chart alone, A_ in space. */
enum { IN_CHART, IN_SPACE };
enum { M_MOTION, M_COORDINATES, M_VECTOR, M_SHAPE, C_FRAME, C_POINT, C_LAME, N_TABLES };
enum { A_SECOND = C_FRAME, A_RESTORE, A_START };
/* tables that the engine runs only for its callers, by `run` and `geodesics` */
enum { GEOMETRY, INVERSE, GEODESIC, N_OTHER };
/* the tables of a contact, the same for all surfaces: theory/equations.py, `contact_functions` */
enum { T_START, T_POSE, T_TWIST, T_TURNED, T_ACCELERATION, T_PUSHED, N_CONTACT_TABLES };

enum { NO_CLOSED_FORM, GREAT_CIRCLES, DEVELOPABLE };

typedef struct {
  const char *name;
  int32_t n_numbers, double_cover, closed_form;
  int32_t may_be_singular;   /* a user's chart, whose singular points are unknown */
  double period_u, period_v; /* 0: not periodic */
  const table_t *tables[2][N_TABLES], *other[N_OTHER];
} surface_t;

/* ---- the scene's buffer of doubles; where something stands is an offset from its start ---- */

enum { SCENE_VERSION = 8 };

/* a body: index of its surface; where its numbers stand; its size and its typical least radius of
   curvature, m; how many sizes a panel may span */
enum { B_SURFACE, B_NUMBERS, B_SIZE, B_LEAST_RADIUS, B_PANEL_LIMIT, BODY_SIZE };
/* the header; contacts follow it, of CONTACT_SIZE numbers each */
enum {
  S_CONTACTS,   /* how many */
  S_TOLERANCE,  /* error of contact points, in sizes of the body */
  S_PANELS,     /* how many all contacts may take together */
  S_BEGIN,      /* s */
  S_END,        /* s */
  S_GAIN,       /* lam = gain sigma^power, plus max(0, sigma'/sigma) if S_CANCELS_GROWTH is 1 */
  S_GAIN_POWER, /* an integer, at least 0 */
  S_CANCELS_GROWTH,
  S_OBJECT, /* the object, BODY_SIZE numbers */
  S_HEADER = S_OBJECT + BODY_SIZE
};
/* a disturbance window, and what it adds, in chart components, to the acceleration of the finger
   (slot 0) or object (1), or to the object's rates (2) */
enum { W_SLOT, W_START, W_STOP, W_VALUE, WINDOW_SIZE = W_VALUE + 2 };
/* a leg, which lasts until the next one begins; a contact has at least one */
enum {
  G_START,        /* s */
  G_PROFILE,      /* where the coefficients of sigma stand, lowest power first, t from G_START */
  G_PROFILE_SIZE, /* how many */
  G_TURN,         /* cosine and sine of the angle by which the path turns where the leg begins */
  LEG_SIZE = G_TURN + 2
};
/* a contact */
enum {
  K_FINGER,                        /* BODY_SIZE numbers */
  K_MOMENT = K_FINGER + BODY_SIZE, /* 0: starts as a scene says; 1: restarts from a moment */
  K_FOLLOWS, /* 1: rolling is imposed, and the finger's curve is developed too */
  K_WINDOWS, /* where its windows stand, and how many */
  K_WINDOWS_SIZE,
  K_LEGS, /* where its legs stand, and how many */
  K_LEGS_SIZE,
  K_PLACE_1, /* u v theta of the finger */
  K_PLACE_2 = K_PLACE_1 + 3,
  K_ANGLE = K_PLACE_2 + 3, /* psi where both thetas are zero */
  K_W1,                    /* path velocity in the finger's parallel frame */
  K_Y = K_W1 + 2,          /* the object's path velocity; in a moment, V */
  K_FRAME_1 = K_Y + 2,     /* x p; zeros: computed from u v theta */
  K_FRAME_2 = K_FRAME_1 + 6,
  CONTACT_SIZE = K_FRAME_2 + 6,
  /* a moment: what a contact restarts from at some time, its row from K_PLACE_1 on */
  MOMENT_SIZE = CONTACT_SIZE - K_PLACE_1
};

/* ---- results ---- */

/* of each body, CARRIED: theta, W_1 or W_2 - V; FRAMES: x p q, curvature form K_pp K_pq K_qq */
enum { STATES, POINTS, SLIP, SLIP_SPEED, TWIST, POSE, ACCELERATION, CARRIED, FRAMES, N_OUTPUTS };

/* how geodesics of a surface are followed, many at once */
typedef struct {
  const surface_t *surface;
  const table_t *rates; /* the table GEODESIC, which is made for users' surfaces when needed */
  const double *numbers;
  double size, first, longest; /* the body's size, the first step and the longest one, m */
} geodesic_t;

/* why something failed */
enum {
  NO_FAILURE,
  NO_MEMORY,
  STUCK,
  TOO_MANY_PANELS,
  TOO_LONG,
  SINGULAR_CHART,
  SINGULAR_TIME,
  OUTSIDE
};

typedef struct {
  int64_t code, contact, side, panels, by_length;
  int64_t at_rest;                /* an acceleration acts where the path almost rests */
  int64_t tried, most, costliest; /* panels tried: in all, the most by one contact; that contact */
  double t, end, value, u, v;     /* value: sigma; if TOO_LONG, sizes of path, more than `end` */
} failure_t;

/* how the motion of one body was found on one interval, and why so; a finger that nothing
   accelerates has no slip of its own; offset: whether a rate offset acts */
enum { CIRCLE, LINE, PANELS };
enum { NO_SLIP, NEGLIGIBLE, SLIPS, PUSHED };
typedef struct {
  double start, stop;
  int64_t side, kind, in_space, by_length, panels, reason, offset;
} fact_t;

typedef struct plan plan_t;

/* a table's prologue or body, and the caller's registers of one double each */
typedef struct {
  const code_t *code;
  double *registers;
} program_t;

/* limits of Newton's method in sense.c. It ends after a step of at most `small`, m, or after
   most_steps; if the last step exceeds `settled`, m, no contact was found. Bodies conform if their
   |relative curvature| is at most `conformal`. */
typedef struct {
  double small, most_steps, settled, conformal;
} sensor_t;

/* one body of a contact that is steered to a goal */
typedef struct {
  const geodesic_t *geodesic; /* NULL: a sphere about the origin or a plane, */
  double normal_curvature;    /* of this normal curvature, 1/m */
  double start[9], place[3];  /* x p q, the contact frame; u v theta */
  double goal[3];             /* the contact point, if it is `wanted` */
  double within[4]; /* centre and radius of a ball that the path must not leave; radius 0: none */
  int64_t wanted;
} steered_t;

/* start and goal of a contact that is steered: see steer.c */
typedef struct {
  steered_t body[2];        /* finger and object */
  double psi;               /* at the start */
  double w_angle, w_length; /* the path velocity's angle, from which directions count, and length */
  double unit;              /* the most by which a step changes a leg's length, along s */
  double rotation[9], origin[3]; /* the finger's pose at the goal */
  double size;               /* unit of the errors of places and origin; that of angles is 1 rad */
  double longest;            /* length of a leg that is allowed, along s; 0: any */
  double tolerance, reached; /* of the geodesics; error at which the goal is met, in sizes */
  int64_t has_rotation, is_pose; /* whether the goal has a rotation, and an origin too */
  int64_t parts;                 /* of each leg, at whose ends `within` is checked */
  int64_t steps;                 /* of geodesics, 16 at once, counted over all searches */
} steer_t;

typedef struct {
  const char *variant;
  plan_t *(*plan)(const double *scene, int64_t size, const surface_t *const *surfaces,
                  failure_t *failure);
  void (*drop)(plan_t *plan);
  /* finds the branches of charts: before `evaluate`, if `out` asks for results in contact frames */
  int (*anchor)(plan_t *plan, double *const *out, failure_t *failure);
  /* out[output][contact][row][time], NULL where not asked for */
  int (*evaluate)(const plan_t *plan, int64_t n, const double *t, double *const *out,
                  failure_t *failure);
  int (*moments)(plan_t *plan, double t, double *out, failure_t *failure);
  int64_t (*facts)(const plan_t *plan, int64_t contact, int64_t room, fact_t *out);
  /* a table at n points, in[n_in][n] and out[n_out][n]; constants[n_const] */
  int (*run)(const table_t *table, int64_t n, const double *in, const double *constants,
             double *out);
  /* prepares a table's registers, in which its constants are set: puts its literals there, and runs
     its prologue */
  void (*load)(const table_t *table, double *registers);
  /* runs a program once */
  void (*step)(const program_t *program);
  /* the same, with tangents: derivatives of all registers in L directions, those of the inputs and
     constants given */
  void (*step_tangents)(const program_t *program, double (*tangents)[L]);
  /* n geodesics from start[6 or 3][n], x p or u v theta, along p over length[n], errors below
     tolerance[n] of the size: x p q J J' M M' where they end, end[13][n], NaN for those that cannot
     be followed; and unless it is NULL, x J at m equal parts, path[m][4][n], to some digits */
  int (*geodesics)(const geodesic_t *geodesic, int64_t n, const double *start, const double *length,
                   const double *tolerance, double *end, int64_t m, double *path);
  /* `anchor` and `evaluate` at one time. The working memory stays with the plan, which one thread
     at a time may use. */
  int (*evaluate_at)(plan_t *plan, double t, double *const *out, failure_t *failure);
  /* paths of n legs to a goal: see steer.c */
  int (*steer)(steer_t *aim, int64_t n, int64_t count, double (*z)[L], double *off,
               double *squares);
  /* of a polynomial: see polynomial.h */
  int64_t (*sign_changes)(const double *c, int64_t n, int64_t order, double a, double b,
                          double *found);
  /* finds where bodies touch, by a loaded table whose first n inputs are the unknowns: see sense.c
   */
  void (*sense)(const table_t *table, double *registers, int64_t n, const sensor_t *limits);
  /* distances t at which n rays, unit vectors [3][n], leave a body: see rays.c. level: a table of
     x, d -> the level function and its slope; numbers: the sign of the side, then the rays'
     centre; size: how far to look first */
  int (*rays)(const table_t *level, const double *numbers, double size, int64_t n,
              const double *ray, double *t);
  /* moves u v u' v' theta from principal values to the branch on which a reference u v theta is */
  void (*wind)(const surface_t *surface, const double *reference, double *place);
} engine_t;

#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif
EXPORT const engine_t *contact_engine(void);
EXPORT extern const surface_t builtin_surfaces[];
EXPORT extern const int32_t n_builtin_surfaces;
EXPORT extern const table_t contact_tables[];
EXPORT extern const int32_t contact_layout[4]; /* what the binding reads: see dispatch.c */

#endif
