/* A scene as data: what the FMU's file resources/scene.bin holds, or in FMUs of sources
   scene.inc.

   Doubles, places as offsets from its beginning in doubles; texts and instructions lie between them
   as bytes. `fmu_export/data.py` writes it, in this order; versions are checked. */
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

#define DATA_VERSION 20261202.0
enum {
  D_VERSION,   /* raised with each change; data is known by it */
  D_SIZE,      /* doubles in all */
  D_CHECKSUM,  /* of what follows the header, 32 bits */
  D_SCALE,     /* reference of the factor of the scene's windows */
  D_REGISTERS, /* that tables have at most */
  D_NAMES,     /* texts, one after the other, of all values */
  D_STARTS,    /* numbers, of all values */
  D_NOMINALS,  /* of all states */
  D_SENSOR,    /* SENSOR_SIZE numbers */
  D_SCENE,     /* the engine's buffer, at the start and without windows, behind its size */
  D_VALUES,    /* from here on rows, before which stands how many; the first values are time, gain,
                  and the coefficients of the scene's profile */
  D_CONTACTS,
  D_SURFACES,
  D_TABLES,
  D_WINDOWS,
  D_CORNERS, /* where legs of any contact begin, ascending */
  D_ORDERS,  /* pairs of references: the first value stays greater than the second */
  D_TOKEN,   /* text */
  D_HEADER
};
/* a value: its contact, -1 of all; what it is; how many it is one of, as FMI 3 sees it, 0 behind
   the first of an array; its least value */
enum { R_OWNER, R_KIND, R_SIZE, R_LEAST, VALUE_SIZE };
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
  OF_CONDITION,
  GROUPS
};

/* a contact; the frames among its states are 6 numbers, a point and an axis, or 3, coordinates and
   an angle */
enum {
  P_OWN_LEGS,   /* 0: its only leg has the scene's profile, which is a parameter */
  P_PARAMETERS, /* references of the first ones of finger and object */
  P_GROUPS = P_PARAMETERS + 2,
  P_COLUMNS = P_GROUPS + GROUPS + 1, /* references of its point and constants; -1: of a leg's
                                        profile */
  P_SYSTEM,                          /* the table of its equations */
  P_FRAMES,                          /* sizes of finger's and object's */
  P_SENSOR = P_FRAMES + 2, /* where it is measured: the table of a step towards the contact, */
  P_UNKNOWNS,              /* and how many each body has in a pose: 3, a point, 2, coordinates */
  P_SIZE = P_UNKNOWNS + 2
};
/* what contact_sensor.py finds a contact by: steps so short end it, or so many; steps so short are
   rounding; bodies with so little relative curvature conform */
enum { N_SMALL, N_MOST_STEPS, N_SETTLED, N_CONFORMAL, SENSOR_SIZE };
/* a window: its contact, its slot, reference of start, stop and two values */
enum { V_CONTACT, V_SLOT, V_VALUES, V_SIZE };
/* a surface: which of the engine's, or -1 and what it is; its tables, -1: none */
enum {
  F_BUILTIN,
  F_N_NUMBERS,
  F_DOUBLE_COVER,
  F_FLAGS,
  F_PERIOD_U,
  F_PERIOD_V,
  F_AMBIENT,
  F_CHART = F_AMBIENT + N_AMBIENT,
  F_SIZE = F_CHART + N_CHART
};
/* a table: the numbers of table_t in their order; then places */
enum { T_NUMBERS, T_PROLOGUE = 7, T_BODY, T_LITERALS, T_SIZE };

enum { TIME_VALUE, GAIN, PROFILE };                                       /* references */
enum { CALCULATED, INDEPENDENT, CONSTANT, FIXED, TUNABLE, INPUT, EXACT }; /* what a value is */
enum { DISTURBANCES = 6, MOST_STATES = 6 + 6 + 4 }; /* of a contact: two frames, W_1 and V */

typedef struct {
  double *data;
  const surface_t **surfaces;
  surface_t *own;
  table_t *tables; /* of contacts, and of the user's surfaces */
  long n_contacts, n_values, n_states, n_windows;
} model_t;

#endif
