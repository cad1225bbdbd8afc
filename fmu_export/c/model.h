/* A scene as data: the file resources/scene.bin of an FMU, or scene.inc if an importer compiles it.

   It consists of a header, and of numbers of 8 bytes with texts and instructions as bytes between
   them; a place is an index of these numbers. `fmu_export/data.py` writes what is declared here, in
   this order; its version is checked. */
#ifndef CONTACT_MODEL
#define CONTACT_MODEL
#include "engine.h"

#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define DATA_VERSION 20261210

typedef struct {
  int64_t at, count;
} section_t;

typedef struct {
  int64_t version;    /* DATA_VERSION, raised with each change of this layout */
  int64_t checksum;   /* of all that follows, 32 bits */
  int64_t registers;  /* the most that a table has */
  int64_t names;      /* texts, one after the other, of all values */
  int64_t starts;     /* double, of all values */
  int64_t least;      /* double, of all values: the least that may be set */
  int64_t nominals;   /* double, of all states */
  int64_t sensor;     /* sensor_t */
  section_t scene;    /* double: the engine's buffer, at the start and without windows */
  section_t values;   /* value_t: time, gain, the windows' factor, the scene's profile, others */
  section_t contacts; /* contact_t */
  section_t surfaces; /* surface_row_t */
  section_t tables;   /* table_row_t */
  section_t windows;  /* window_t */
  section_t corners;  /* double: where legs of any contact begin, ascending */
  section_t orders;   /* int64_t[2], references: the first value stays greater than the second */
  int64_t token;      /* text */
  int64_t size;       /* how many numbers follow */
} head_t;

typedef struct {
  int64_t owner; /* its contact, -1: of all */
  int64_t kind;  /* CALCULATED and so on */
  int64_t size;  /* of the variable of which it is the first element; 0: of none */
} value_t;

/* groups of a contact's values; from the states on they are results */
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
  int64_t parameters[2];      /* references of the first one of finger and object */
  int64_t groups[GROUPS + 1]; /* references where groups begin, and where the last one ends */
  int64_t columns; /* int64_t, references of the equations' inputs and constants; -1: a leg's own */
  int64_t system;  /* the table of its equations */
  int64_t frames[2]; /* how many states are the finger's and the object's frame: 6, point and axis,
                        or 3, coordinates and angle */
  int64_t sensor;    /* if it is measured: the table of a step of Newton's method, see events.c */
  int64_t unknowns[2]; /* of the method, for each body: 3, a point; 2, coordinates; or 0 */
} contact_t;

typedef struct {
  int64_t contact, slot;
  int64_t values; /* reference of the first of start, stop and two components */
} window_t;

/* a surface: its number in the engine, or -1; its tables, -1: none; the rest of surface_t */
typedef struct {
  int64_t builtin, tables[2 * N_TABLES];
  int32_t n_numbers, double_cover, closed_form, may_be_singular;
  double period_u, period_v;
} surface_row_t;

/* a table: the first numbers of table_t; places of its instructions and literals */
typedef struct {
  int32_t numbers[8];
  int64_t prologue, body, literals;
} table_row_t;

enum { TIME_VALUE, GAIN, SCALE, PROFILE };                                /* references */
enum { CALCULATED, INDEPENDENT, CONSTANT, FIXED, TUNABLE, INPUT, EXACT }; /* kinds of values */
enum { DISTURBANCES = 6, MOST_STATES = 6 + 6 + 4 }; /* of a contact: two frames, W_1 and V */

typedef struct {
  head_t *head; /* of the data */
  const value_t *values;
  const contact_t *contacts;
  const window_t *windows;
  const double *scene;
  const surface_t **surfaces;
  surface_t *user_surfaces;
  table_t *tables; /* of contacts, and of the user's surfaces */
  long n_contacts, n_values, n_states, n_windows;
} model_t;

#endif
