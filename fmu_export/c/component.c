/* Values and steps over the engine's plans: see component.h. */
#include "component.h"

#include <stdarg.h>

#include "model.c"

/* Each element of the variables vr; r: its reference */
#define EACH_VALUE(r, vr, count)                                                                   \
  for (size_t k_ = 0; k_ < (count); k_++)                                                          \
    for (unsigned r = (vr)[k_], end_ = r + size_of(c->model, r); r < end_; r++)

/* The values of contact i from a group on */
static inline double *values_of(const component_t *c, long i, int group) {
  return c->value + at_of(c->model, i, group);
}

#include "profile.c"
#include "starts.c"
#include "equations.c"
#include "state.c"

static status_t report(component_t *c, status_t status, const char *format, ...) {
  char text[640];
  const int n = status == FAILED ? snprintf(text, 64, "%s: ", c->called) : 0;
  va_list arguments;
  va_start(arguments, format);
  vsnprintf(text + n, sizeof text - (size_t)n, format, arguments);
  va_end(arguments);
  if (c->log) log_text(c, status, text);
  return status;
}

/* ---- memory ---- */

static void drop_plan(component_t *c, long i) {
  c->engine->drop(c->live[i].plan);
  c->live[i].plan = NULL;
}

static void free_component(component_t *c) {
  if (!c) return;
  for (long i = 0; c->live && i < c->model->n_contacts; i++) drop_plan(c, i);
  free(c->fmu_state), free(c->live), free(c->scene), free(c->tangents);
  free_model(c->model);
  free(c);
}

/* Drops all that can be computed again, and what was noted of the solver's calls. */
static void forget(component_t *c) {
  c->changed = c->evaluated = 0;
  for (long i = 0; i < c->model->n_contacts; i++) drop_plan(c, i);
  forget_values(c);
}

static void reset(component_t *c, int stepping) {
  const model_t *m = c->model;
  memset(c->now, 0, memory_size(m));
  memcpy(c->value, data_at(m, m->head->starts), (size_t)m->n_values * sizeof(double));
  c->now->stepping = stepping, c->now->phase = INSTANTIATED;
  c->now->stop_time = c->now->limit = HUGE_VAL;
  forget(c);
}

static const char *make_component(component_t *c, const char *resources) {
  const char *wrong;
  if (!(c->model = read_model(resources, &wrong))) return wrong;
  const model_t *m = c->model;
  const size_t registers = (size_t)m->head->registers, values = (size_t)m->n_values;
  c->engine = contact_engine();
  c->fmu_state = new_saved(m);
  c->live = calloc((size_t)m->n_contacts, sizeof *c->live);
  /* behind the scene there is never more than all of the model's data and windows for inputs */
  const size_t scene = (size_t)m->head->scene.count;
  c->scene = malloc((scene + (size_t)m->head->size + 3 * WINDOW_SIZE) * sizeof(double));
  c->tangents = malloc((values + 2 * registers) * sizeof *c->tangents + registers * sizeof(double));
  if (!c->fmu_state || !c->live || !c->scene || !c->tangents) return "no memory";
  c->system_tangents = c->tangents + values, c->surface_tangents = c->system_tangents + registers;
  c->registers = (double *)(c->surface_tangents + registers);
  memcpy(c->scene, m->scene, scene * sizeof *c->scene);
  c->scene[S_CONTACTS] = 1, c->scene[S_PANELS] = MOST_PANELS;
  c->scratch = c->scene + scene;
  c->now = &c->fmu_state->memory;
  c->value = (double *)(c->now + 1), c->segment = (segment_t *)(c->value + m->n_values);
  return NULL;
}

#include "plans.c"
#include "events.c"
#include "results.c"
#include "derivatives.c"

/* ---- what is set ---- */

static status_t check_value(component_t *c, unsigned reference, double value) {
  const double *least = data_at(c->model, c->model->head->least);
  if (!isfinite(value))
    return report(c, DISCARD, "%s = %g is refused; give a finite number",
                  name_of(c->model, reference), value);
  if (value < least[reference])
    return report(c, DISCARD, "%s = %.9g is refused; give %g or more", name_of(c->model, reference),
                  value, least[reference]);
  return OK;
}

static void set_value(component_t *c, unsigned reference, double value) {
  if (c->value[reference] == value) return;
  c->value[reference] = value;
  const long owner = (long)c->model->values[reference].owner;
  if (owner < 0)
    forget_values(c);
  else
    c->live[owner].valid = 0;
  c->now->settled = 0;
  c->changed |= c->now->phase == CONTINUOUS && c->model->values[reference].kind == INPUT;
}

/* ---- Model Exchange ---- */

/* All are set, or none. */
static status_t set_states(component_t *c, const double *state) {
  for (int sets = 0; sets < 2; sets++)
    for (long i = 0, k = 0; i < c->model->n_contacts; i++)
      for (long r = at_of(c->model, i, OF_STATES); r < at_of(c->model, i, OF_RATES); r++, k++)
        if (sets)
          set_value(c, (unsigned)r, state[k]);
        else if (check_value(c, (unsigned)r, state[k]))
          return DISCARD;
  return OK;
}

static status_t get_states(component_t *c, double *state, int rates) {
  if (rates) c->evaluated |= c->changed, c->changed = 0;
  for (long i = 0; i < c->model->n_contacts; i++) {
    const long at = at_of(c->model, i, rates ? OF_RATES : OF_STATES);
    const status_t s = get_values(c, (unsigned)at, states_of(c->model, i), state);
    if (s) return s;
    state += states_of(c->model, i);
  }
  return OK;
}

/* ---- time ---- */

static void set_time(component_t *c, double time) {
  if (c->now->time == time) return;
  c->now->time = c->value[TIME_VALUE] = time;
  if (c->now->stepping) c->now->acts_at = snapped(c, time);
  forget_values(c);
}

#include "steps.c"
