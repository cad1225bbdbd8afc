/* A scene as data: what the FMU's file resources/scene.bin holds, or in FMUs of sources
   scene.inc.

   Numbers of 8 bytes; places count them from the beginning. Texts and instructions lie between them
   as bytes. `fmu_export/data.py` writes what stands here, in this order; versions are checked. */
#ifndef CONTACT_MODEL
#define CONTACT_MODEL
#include "engine.h"

#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* An infinite time is one that never comes, and a value that is no number is refused. */
#if defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__
#error "this model needs infinities and NaN: compile without -ffast-math or -Ofast"
#endif

#define DATA_VERSION 20261208

typedef struct {
  int64_t at, count;
} section_t;

typedef struct {
  int64_t version;    /* raised with each change; data is known by it */
  int64_t size;       /* numbers in all */
  int64_t checksum;   /* of what follows the header, 32 bits */
  int64_t registers;  /* that tables have at most */
  int64_t names;      /* texts, one after the other, of all values */
  int64_t starts;     /* double, of all values, */
  int64_t least;      /* and the least ones that they may have */
  int64_t nominals;   /* double, of all states */
  int64_t sensor;     /* sensor_t */
  section_t scene;    /* double: the engine's buffer, at the start and without windows */
  section_t values;   /* value_t: time, gain, the windows' factor, the scene's profile, others */
  section_t contacts; /* contact_t */
  section_t surfaces; /* shape_t */
  section_t tables;   /* written_t */
  section_t windows;  /* window_t */
  section_t corners;  /* double: where legs of any contact begin, ascending */
  section_t orders;   /* int64_t[2], references: the first value stays greater than the second */
  int64_t token;      /* text */
} head_t;

typedef struct {
  int64_t owner; /* its contact, -1: of all */
  int64_t kind;  /* CALCULATED and so on */
  int64_t size;  /* how many it is the first of, as FMI 3 sees it; 0: not the first of an array */
} value_t;

/* groups of a contact's values; results are those from the states on */
enum {
  OF_INPUTS,
  OF_MEASURED,
  OF_STATES,
  OF_RATES,
  OF_COORDINATES,
  OF_SLIP,
  OF_TWIST,
  OF_POSE,
  OF_POINTS,
  OF_SLIP_SPEED,
  OF_CONDITION,
  GROUPS
};

typedef struct {
  int64_t own_legs;           /* 0: its only leg has the scene's profile, which is a parameter */
  int64_t parameters[2];      /* references of the first ones of finger and object */
  int64_t groups[GROUPS + 1]; /* references where they begin, and where the last one ends */
  int64_t columns;   /* int64_t, references of its point and constants; -1: of a leg's profile */
  int64_t system;    /* the table of its equations */
  int64_t frames[2]; /* sizes of finger's and object's among its states: 6, a point and an axis, or
                        3, coordinates and an angle */
  int64_t sensor;    /* where it is measured: the table of a step towards the contact, */
  int64_t unknowns[2]; /* and how many each body has in a pose: 3, a point, 2, coordinates */
} contact_t;

typedef struct {
  int64_t contact, slot;
  int64_t values; /* reference of start, stop and two components */
} window_t;

/* a surface: which of the engine's, or -1; its own tables, -1: none; the rest of surface_t */
typedef struct {
  int64_t builtin, tables[2 * N_MOVED];
  int32_t n_numbers, double_cover, closed, may_be_singular;
  double period_u, period_v;
} shape_t;

/* a table: the first numbers of table_t; where its instructions and literals lie */
typedef struct {
  int32_t numbers[8];
  int64_t prologue, body, literals;
} written_t;

enum { TIME_VALUE, GAIN, SCALE, PROFILE };                                /* references */
enum { CALCULATED, INDEPENDENT, CONSTANT, FIXED, TUNABLE, INPUT, EXACT }; /* what a value is */
enum { DISTURBANCES = 6, MOST_STATES = 6 + 6 + 4 }; /* of a contact: two frames, W_1 and V */

typedef struct {
  head_t *head; /* of the data */
  const value_t *values;
  const contact_t *contacts;
  const window_t *windows;
  const double *scene;
  const surface_t **surfaces;
  surface_t *own;
  table_t *tables; /* of contacts, and of the user's surfaces */
  long n_contacts, n_values, n_states, n_windows;
} model_t;

#endif
