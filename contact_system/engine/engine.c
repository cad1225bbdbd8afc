/* The engine (see engine.h) as one unit, compiled once for each VARIANT: a processor's vectors. */
#include "engine.h"

#include <setjmp.h>
#include <stdlib.h>

#include "vmath.h"
#include "twofold.h"
#include "polynomial.h"

enum { STAGES = 12 };
#include "generated/dop853.inc"
#include "generated/gauss.inc"
#include "generated/operations.inc"

#include "interpret.c"
#include "work.h"
#include "series.c"
#include "schedule.c"
#include "rates.c"
#include "motion.c"
#include "closed_form.c"
#include "branches.c"
#include "singular.c"
#include "output.c"
#include "moments.c"
#include "segments.c"
#include "geodesic.c"
#include "steer.c"
#include "rays.c"
#include "sense.c"

/* ---- the functions of engine_t ---- */

static void drop(plan_t *plan) {
  if (!plan) return;
  if (plan->work) end_work(plan->work), free(plan->work);
  for (block_t *b = plan->memory, *next; b; b = next) next = b->next, free(b);
  free(plan);
}

static plan_t *make_plan(const double *scene, int64_t size, const surface_t *const *surfaces,
                         failure_t *failure) {
  work_t w;
  begin_work(&w, calloc(1, sizeof(plan_t)), failure);
  if (!w.plan) {
    failure->code = NO_MEMORY;
    return NULL;
  }
  if (setjmp(w.jump)) {
    end_work(&w);
    drop(w.plan);
    return NULL;
  }
  plan_t *plan = w.plan;
  plan->scene = keep(&w, size, sizeof *scene);
  memcpy(plan->scene, scene, (size_t)size * sizeof *scene);
  plan->surfaces = surfaces;
  plan->n_contacts = (int64_t)scene[S_CONTACTS];
  plan->contacts = keep(&w, plan->n_contacts, sizeof(contact_t));
  for (int64_t i = 0; i < plan->n_contacts; i++) plan_contact(&w, i);
  end_work(&w);
  return plan;
}

/* The working memory of a call: the plan's, if `evaluate_at` has made it keep one, so that an FMU's
   steps allocate nothing; else the caller's own */
static work_t *enter(const plan_t *plan, work_t *own, failure_t *failure) {
  begin_work(own, (plan_t *)plan, failure);
  if (!plan->work) return own;
  plan->work->plan = own->plan, plan->work->failure = failure;
  return plan->work;
}

static int leave(work_t *w) {
  if (w != w->plan->work) end_work(w);
  return (int)w->failure->code;
}

static int anchor(plan_t *plan, double *const *out, failure_t *failure) {
  if (!(needs_of(out) & IN_FRAMES)) return NO_FAILURE;
  work_t own, *const w = enter(plan, &own, failure);
  if (setjmp(w->jump) == 0)
    for (contact_t *c = plan->contacts; c < plan->contacts + plan->n_contacts; c++)
      for (int s = 0; s < 2; s++) anchor_side(w, c, s, c->n_tracks[s]);
  return leave(w);
}

static int evaluate(const plan_t *plan, int64_t n, const double *t, double *const *out,
                    failure_t *failure) {
  work_t own, *const w = enter(plan, &own, failure);
  const double begin = plan->scene[S_BEGIN], end = plan->scene[S_END];
  for (int64_t i = 0; i < n; i++)
    if (!(t[i] >= begin && t[i] <= end)) failure->code = OUTSIDE;
  if (failure->code) return leave(w);
  if (setjmp(w->jump) == 0)
    for (int64_t i = 0; i < plan->n_contacts; i++) {
      double *to[N_OUTPUTS];
      for (int k = 0; k < N_OUTPUTS; k++) to[k] = out[k] ? out[k] + i * RESULTS[k].rows * n : NULL;
      evaluate_contact(w, plan->contacts + i, n, t, to);
    }
  return leave(w);
}

static int evaluate_at(plan_t *plan, double t, double *const *out, failure_t *failure) {
  if (!plan->work) plan->work = calloc(1, sizeof *plan->work);
  if (!plan->work) return (int)(failure->code = NO_MEMORY);
  if (anchor(plan, out, failure)) return (int)failure->code;
  return evaluate(plan, 1, &t, out, failure);
}

static int moments(plan_t *plan, double t, double *out, failure_t *failure) {
  work_t own, *const w = enter(plan, &own, failure);
  if (setjmp(w->jump) == 0)
    for (int64_t i = 0; i < plan->n_contacts; i++)
      moment_of(w, plan->contacts + i, t, out + i * MOMENT_SIZE);
  return leave(w);
}

static int64_t facts(const plan_t *plan, int64_t contact, int64_t room, fact_t *out) {
  const contact_t *c = plan->contacts + contact;
  int64_t n = 0;
  for (int s = 0; s < 2; s++)
    for (int64_t i = 0; i < c->n_tracks[s]; i++, n++) {
      const track_t *k = c->tracks[s] + i;
      if (n < room)
        out[n] = (fact_t){k->drive->start, k->stop,     s,         k->kind,       k->in_space,
                          k->by_length,    k->panels.n, k->reason, any(k->offset)};
    }
  return n;
}

static int run_table(const table_t *table, int64_t n, const double *in, const double *constants,
                     double *out) {
  unit_t u = {0};
  if (n > 0 && !load(&u, table, constants)) return NO_MEMORY;
  for (int64_t i = 0; i < n; i += L) {
    const int count = (int)(n - i < L ? n - i : L);
    for (int j = 0; j < table->n_in; j++) gather(u.r[j], in + j * n + i, count);
    lanes_t found = run(&u);
    for (int j = 0; j < table->n_out; j++)
      memcpy(out + j * n + i, found[j], (size_t)count * sizeof *out);
  }
  free(u.r);
  return NO_FAILURE;
}

#define NAME_(variant) engine_##variant
#define NAME(variant) NAME_(variant)
#define TEXT_(variant) #variant
#define TEXT(variant) TEXT_(variant)

const engine_t NAME(VARIANT) = {.variant = TEXT(VARIANT),
                                .plan = make_plan,
                                .drop = drop,
                                .anchor = anchor,
                                .evaluate = evaluate,
                                .moments = moments,
                                .facts = facts,
                                .run = run_table,
                                .load = load_registers,
                                .step = step,
                                .step_tangents = step_tangents,
                                .geodesics = geodesics,
                                .evaluate_at = evaluate_at,
                                .steer = steer,
                                .sign_changes = sign_changes,
                                .sense = sense,
                                .rays = rays,
                                .wind = wind};
