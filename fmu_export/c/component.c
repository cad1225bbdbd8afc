#include <stdarg.h>
#include <stdio.h>

#include "winding.h"

#define MOST_PANELS 20000L /* in one step: a second of work, kilometres of path */

/* groups of results, bits of memory_t.valid */
enum { STATE = 1, RATES = 2, SLIP = 4, OUTPUTS = 8, RESULTS = 16, MOMENT = 32 };

status_t report(component_t *c, status_t status, const char *category, const char *format, ...) {
  char text[512];
  va_list arguments;
  va_start(arguments, format);
  vsnprintf(text, sizeof text, format, arguments);
  va_end(arguments);
  c->report(c, status, category, text);
  return status;
}

/* the first that is not finite; n where all are */
static long not_finite(const double *x, long n) {
  long i = 0;
  while (i < n && fabs(x[i]) <= DBL_MAX) i++;
  return i;
}

/* --- a contact's motion ----------------------------------------------------------------------- */

static const form_t *form_of(const memory_t *now, long i) {
  return &places[i].kind->form[now->contact[i].form];
}

static drive_t drive_of(const contact_t *k) {
  return (drive_t){k->n_sigma, k->n_exponent, k->power, k->sigma, k->exponent};
}

static void chebyshev_at(double xi, double basis[TERMS]) {
  basis[0] = 1.0, basis[1] = xi;
  for (long k = 1; k < L; k++) basis[k + 1] = 2.0 * xi * basis[k] - basis[k - 1];
}

/* Local times inside the current panel, its ends included. */
static void moment(const memory_t *now, long i, double tau, moment_t *m) {
  const contact_t *k = &now->contact[i];
  const form_t *form = form_of(now, i);
  const long n = form->motion->n_states, stiff = form->motion->n_stiff;
  if (tau <= 0.0) {
    memcpy(m->y, k->first, sizeof m->y);
  } else if (tau >= k->to) {
    memcpy(m->y, k->last, sizeof m->y);
  } else {
    double basis[TERMS];
    chebyshev_at(2.0 * (tau - k->from) / (k->to - k->from) - 1.0, basis);
    for (long s = 0; s < n; s++) { /* four sums at a time: one alone waits for itself */
      const double *c = k->series + s * TERMS;
      double a = c[L] * basis[L], b = 0.0, d = 0.0, e = 0.0;
      for (long j = 0; j < L; j += 4) {
        a += c[j] * basis[j], b += c[j + 1] * basis[j + 1];
        d += c[j + 2] * basis[j + 2], e += c[j + 3] * basis[j + 3];
      }
      m->y[s] = (a + b) + (d + e);
    }
  }
  m->sigma = horner(k->sigma, k->n_sigma, tau);
  m->frame[0] = m->y, m->frame[1] = m->y + form->size[0] + stiff;
  if (stiff) {
    memcpy(m->w1v, m->y + form->size[0], 2 * sizeof(double));
    memcpy(m->w1v + 2, m->y + n - 2, 2 * sizeof(double));
  } else {
    double decay = 1.0;
    const drive_t d = drive_of(k);
    if (tau > 0.0 && k->greatest > 0.0) decay = decay_at(&d, tau, m->sigma);
    for (int j = 0; j < 2; j++) m->w1v[j] = k->w1[j], m->w1v[2 + j] = k->v[j] * decay;
  }
  for (int j = 0; j < 6; j++) m->disturbance[j] = k->disturbance[j] + k->slope[j] * tau;
}

static const double *numbers(const memory_t *now, long i, int body) {
  return now->value + (body ? OBJECT : places[i].finger);
}

/* u v u' v' theta of one body. Returns whether they are principal values, of one moved in space. */
static int own_coordinates(const memory_t *now, long i, int body, const moment_t *m,
                           double out[COORDINATES]) {
  const form_t *form = form_of(now, i);
  double c[4];
  places[i].kind->drive((const double *const[]){&m->sigma, m->w1v}, c);
  form->coordinates[body](
      (const double *const[]){m->frame[body], c + 2 * body, numbers(now, i, body)}, out);
  return form->size[body] == IN_SPACE;
}

static int place_on(const path_t *p, double tau, double *value) {
  moment_t m;
  moment(p->now, p->i, tau, &m);
  own_coordinates(p->now, p->i, p->body, &m, value);
  return !all_finite(value, COORDINATES);
}

/* The anchor before a local time; whether the next one is nearer */
static long before(const contact_t *k, double tau, int *later) {
  const double at = k->to > k->from ? 4.0 * (tau - k->from) / (k->to - k->from) : 0.0;
  const long left = at < 0.0 ? 0 : at < 3.0 ? (long)at : 3;
  *later = at - left > 0.5;
  return left;
}

/* The coordinates at a local time, on the branch that the path has come to */
static void coordinates(const memory_t *now, long i, int body, const moment_t *m, double tau,
                        double out[COORDINATES]) {
  if (!own_coordinates(now, i, body, m, out) || !all_finite(out, COORDINATES)) return;
  const contact_t *k = &now->contact[i];
  int later;
  const long left = before(k, tau, &later);
  const double (*anchor)[3] = (const double (*)[3])k->anchor[body] + left;
  const double first = k->from + 0.25 * left * (k->to - k->from);
  wind_between(&(path_t){now, i, body}, anchor[0], anchor[1], first, later, tau, out);
}

/* u v theta of coordinates */
static void take_place(double place[3], const double out[COORDINATES]) {
  place[0] = out[U], place[1] = out[V], place[2] = out[THETA];
}

/* Follow the coordinates through a new panel, or fill all anchors with one place (to = 0). */
static void lay_anchors(memory_t *now, long i) {
  contact_t *k = &now->contact[i];
  double from[2][3], out[COORDINATES], last[2] = {k->from, k->from};
  moment_t m;
  for (int body = 0; body < 2; body++) memcpy(from[body], k->anchor[body][4], sizeof from[body]);
  for (int q = 0; q < 5; q++) {
    const double tau = k->from + 0.25 * q * (k->to - k->from);
    moment(now, i, tau, &m);
    for (int body = 0; body < 2; body++) {
      if (own_coordinates(now, i, body, &m, out) && all_finite(out, COORDINATES)) {
        wind_along(&(path_t){now, i, body}, last[body], side_of(from[body][0], from[body][1]),
                   from[body], tau, out);
        take_place(from[body], out), last[body] = tau;
      }
      memcpy(k->anchor[body][q], from[body], sizeof from[body]);
    }
  }
}

static double largest(const double *x, long n) {
  double most = 0.0;
  for (long j = 0; j < n; j++) most = fmax(most, fabs(x[j]));
  return most;
}

/* 1 / (size of each state): positions by the body's size, angles and directions by 1 */
static void set_scale(const memory_t *now, long i, int body, const double *frame, double *scale) {
  const double size = places[i].size[body];
  double lame[3];
  if (form_of(now, i)->size[body] == IN_SPACE) {
    for (int j = 0; j < IN_SPACE; j++) scale[j] = j < 3 ? 1.0 / size : 1.0;
    return;
  }
  places[i].kind->lame[body]((const double *const[]){frame, numbers(now, i, body)}, lame);
  scale[0] = fmax(lame[0] / size, 1e-2), scale[1] = fmax(lame[1] / size, 1e-2), scale[2] = 1.0;
}

/* A first panel along which the contact moves a third of the smaller body. */
static double first_panel(const memory_t *now, long i) {
  const contact_t *k = &now->contact[i];
  const double path = 0.3 * fmin(places[i].size[0], places[i].size[1]);
  double h = fmin(k->end - k->begin, 1e3 * HORIZON);
  for (int j = 0; j < 200; j++, h *= 0.5) {
    double half = horner(k->sigma, k->n_sigma, 0.5 * h), all = horner(k->sigma, k->n_sigma, h);
    if (h * fmax(k->sigma[0], fmax(half, all)) <= path) break;
  }
  return h;
}

/* 1 / (the slip that can come about), so that slip is right to tolerance */
static double slip_scale(const memory_t *now, long i) {
  const contact_t *k = &now->contact[i];
  const drive_t d = drive_of(k);
  const double h = k->next, *size = places[i].size;
  double push = 0.0, speed = fmin(k->sigma[0], horner(k->sigma, k->n_sigma, h));
  for (int j = 0; j < 4; j++)
    push = fmax(push, (fabs(k->disturbance[j]) + fabs(k->slope[j]) * h) * size[j / 2]);
  double slowest = 1.0 / fmax(fmin(gain_at(&d, 0.0), gain_at(&d, h)), 1e-9);
  double grown = push > 0 ? push / fmax(speed, 1e-30) * fmin(k->end - k->begin, slowest) : 0.0;
  double expected = fmax(largest(k->v, 2), grown);
  return 1.0 / fmin(1.0, fmax(expected, 1e-3));
}

/* Whether sigma grows under the guaranteed law from this time on. */
static int makes_up_for_growth(const memory_t *now, double t) {
  for (long j = 0; j < now->n_knots; j += 2)
    if (reached(t, now->knots[j]) && !reached(t, now->knots[j + 1])) return 1;
  return 0;
}

/* whether sigma is zero but for rounding */
static int rests(const memory_t *now) {
  const double *sigma = law(now) + 1, t = now->time;
  return horner(sigma, N_PROFILE, t) <= 1e-15 * magnitude(sigma, N_PROFILE, t);
}

/* Whether the path leaves a rest under the guaranteed law, which no slip does. */
static int leaves_slip_behind(const memory_t *now) {
  return rests(now) && makes_up_for_growth(now, now->time);
}

/* sigma and decay in the local time that begins at k->begin, as theory/gain.py has them */
static void set_drive(const memory_t *now, contact_t *k) {
  const double *global = law(now) + 1, t = k->begin;
  for (long j = 0; j < N_PROFILE; j++) k->sigma[j] = global[j];
  for (long j = 0; j < N_PROFILE; j++) /* Taylor shift by synthetic division */
    for (long l = N_PROFILE - 2; l >= j; l--) k->sigma[l] += t * k->sigma[l + 1];
  if (fabs(k->sigma[0]) <= 1e-15 * magnitude(global, N_PROFILE, t)) k->sigma[0] = 0.0;
  k->n_sigma = N_PROFILE, k->n_exponent = 2;
  k->exponent[0] = 0.0, k->exponent[1] = k->eta;
  if (GAIN_LAW == PATH) {
    k->n_exponent = 2 * N_PROFILE;
    memset(k->exponent, 0, sizeof k->exponent);
    for (long a = 0; a < N_PROFILE; a++)
      for (long b = 0; b < N_PROFILE; b++)
        k->exponent[a + b + 1] += k->eta * k->sigma[a] * k->sigma[b] / (double)(a + b + 1);
  }
  k->power = makes_up_for_growth(now, t);
}

static double own_end(const memory_t *now, long i) {
  double end = now->limit;
  for (long w = 0; w < N_WINDOWS; w++) {
    if (windows[w].contact != i) continue;
    if (!reached(now->time, windows[w].start)) end = fmin(end, windows[w].start);
    if (!reached(now->time, windows[w].stop)) end = fmin(end, windows[w].stop);
  }
  for (long j = 0; j < now->n_knots; j++)
    if (!reached(now->time, now->knots[j])) end = fmin(end, now->knots[j]);
  return end;
}

/* Input, extrapolated from where its slope was given, and windows. */
static double acting(const memory_t *now, long i, int j) {
  return now->value[places[i].block + j] + now->window[i][j] +
         now->input_slope[i][j] * (now->time - now->slope_begin);
}

static int acting_form(const contact_t *k) {
  if (largest(k->disturbance + 2, 4) > 0 || largest(k->slope + 2, 4) > 0) return PUSHED_OBJECT;
  if (largest(k->disturbance, 2) > 0 || largest(k->slope, 2) > 0) return PUSHED_FINGER;
  return DRIVEN;
}

/* One body's frame in the form that a new segment needs. */
static void change_form(const memory_t *now, long i, int body, const double *frame, long from,
                        long to, const double *place, double *out) {
  if (from == to)
    memcpy(out, frame, (size_t)to * sizeof(double));
  else if (to == IN_CHART)
    memcpy(out, place, IN_CHART * sizeof(double));
  else
    places[i].kind->spatial[body]((const double *const[]){place, numbers(now, i, body)}, out);
}

/* Begin a segment of contact i now, where the one before has come to (y, w1v). */
static void begin_segment(memory_t *now, long i, const moment_t *m, double place[2][3]) {
  contact_t *k = &now->contact[i];
  const form_t *old = form_of(now, i);
  k->begin = now->time, k->end = own_end(now, i), k->eta = law(now)[0];
  for (int j = 0; j < 6; j++) {
    k->disturbance[j] = acting(now, i, j);
    k->slope[j] = now->input_slope[i][j];
  }
  k->form = acting_form(k);
  set_drive(now, k);
  /* what a form does not use is 0, so that a state's bytes follow from the motion alone */
  memset(k->constants, 0, sizeof k->constants), memset(k->scale, 0, sizeof k->scale);
  memset(k->first, 0, sizeof k->first), memset(k->series, 0, sizeof k->series);
  memcpy(k->w1, m->w1v, sizeof k->w1), memcpy(k->v, m->w1v + 2, sizeof k->v);
  if (leaves_slip_behind(now)) k->v[0] = k->v[1] = 0.0;
  k->greatest = hypot(k->v[0], k->v[1]);
  const form_t *form = form_of(now, i);
  const motion_t *motion = form->motion;
  const long stiff = motion->n_stiff, object = form->size[0] + stiff;
  for (int body = 0; body < 2; body++)
    change_form(now, i, body, m->frame[body], old->size[body], form->size[body], place[body],
                k->first + (body ? object : 0));
  double *c = k->constants;
  memcpy(c, numbers(now, i, 0), (size_t)places[i].kind->n_numbers[0] * sizeof(double));
  c += places[i].kind->n_numbers[0];
  memcpy(c, numbers(now, i, 1), (size_t)places[i].kind->n_numbers[1] * sizeof(double));
  c += places[i].kind->n_numbers[1];
  k->next = first_panel(now, i);
  set_scale(now, i, 0, k->first, k->scale);
  set_scale(now, i, 1, k->first + object, k->scale + object);
  if (stiff) {
    memcpy(c, k->disturbance, sizeof k->disturbance), memcpy(c + 6, k->slope, sizeof k->slope);
    double slip = slip_scale(now, i);
    for (int j = 0; j < 2; j++) {
      k->first[form->size[0] + j] = k->w1[j], k->scale[form->size[0] + j] = 1.0;
      k->first[motion->n_states - 2 + j] = k->v[j], k->scale[motion->n_states - 2 + j] = slip;
    }
  } else {
    memcpy(c, k->w1, sizeof k->w1), memcpy(c + 2, k->v, sizeof k->v);
  }
  restore(motion, k->constants, k->scale, k->first);
  memcpy(k->last, k->first, sizeof k->last);
  k->from = k->to = 0.0;
  for (int body = 0; body < 2; body++)
    for (int q = 0; q < 5; q++) memcpy(k->anchor[body][q], place[body], sizeof place[body]);
}

static void restart(memory_t *now, long i) {
  contact_t *k = &now->contact[i];
  double place[2][3], out[COORDINATES], tau = now->time - k->begin;
  int later;
  moment_t m;
  moment(now, i, tau, &m);
  for (int body = 0; body < 2; body++) {
    coordinates(now, i, body, &m, tau, out);
    const long left = before(k, tau, &later);
    memcpy(place[body], k->anchor[body][left + later], sizeof place[body]);
    if (all_finite(out, COORDINATES)) take_place(place[body], out);
  }
  begin_segment(now, i, &m, place);
}

/* Contacts whose inputs, windows or gain are no longer those of their segment begin another. */
static void settle(component_t *c) {
  memory_t *now = &c->now;
  if (now->settled) return;
  for (long i = 0; i < N_CONTACTS; i++) {
    contact_t *k = &now->contact[i];
    int same = k->eta == law(now)[0] && !reached(now->time, k->end);
    for (int j = 0; j < 6; j++)
      same &= k->disturbance[j] == acting(now, i, j) && k->slope[j] == 0.0 &&
              now->input_slope[i][j] == 0.0;
    if (!same) restart(now, i);
  }
  memset(now->valid, 0, sizeof now->valid);
  now->settled = 1;
}

#define AT_REST                                                                                    \
  "sigma is zero, and an acceleration cannot act on a path that rests; accelerate "                \
  "while sigma > 0, or disturb the object's rates"

/* Whether a contact is accelerated where its path comes to rest. */
static int pushed_at_rest(const contact_t *k) {
  const double sigma = horner(k->sigma, k->n_sigma, k->to);
  const int pushed = largest(k->disturbance, 4) > 0 || largest(k->slope, 4) > 0;
  return pushed && sigma <= ALMOST_RESTS * largest(k->sigma, k->n_sigma);
}

/* What stands in the way where a panel cannot be made. */
static const char *obstacle(const contact_t *k) {
  if (pushed_at_rest(k)) return AT_REST;
  return "the path reaches a singular point of its chart or its surface, or moves too fast for "
         "double precision; set smaller inputs, end before or start elsewhere";
}

/* Twist, pose and contact points of contact i at some moment */
static void outputs_at(const memory_t *now, long i, const moment_t *m, double *out) {
  form_of(now, i)->outputs((const double *const[]){&now->time, m->frame[0], m->frame[1], m->w1v,
                                                   m->disturbance, law(now), numbers(now, i, 0),
                                                   numbers(now, i, 1)},
                           out);
}

/* Rotation of contact i's pose at a local time */
static void rotation_at(const memory_t *now, long i, double tau, double rotation[9]) {
  double out[BLOCK_SIZE - AT_TWIST];
  moment_t m;
  moment(now, i, tau, &m);
  outputs_at(now, i, &m, out);
  memcpy(rotation, out + AT_POSE - AT_TWIST, 9 * sizeof *rotation);
}

/* Whether a contact frame turns over within a new panel, as it does where a path goes straight
   through a pole of its chart: the equations are smooth there. From a sixteenth of a panel to the
   next, bodies turn by less than a right angle. was: the rotation before the panel begins. */
static int turns_over(const memory_t *now, long i, const double *was) {
  const contact_t *k = &now->contact[i];
  double rotation[2][9];
  memcpy(rotation[0], was, sizeof rotation[0]);
  for (int q = 1; q <= 16; q++) {
    double trace = 0.0, *here = rotation[q % 2], *last = rotation[1 - q % 2];
    rotation_at(now, i, k->from + q / 16.0 * (k->to - k->from), here);
    for (int j = 0; j < 9; j++) trace += here[j] * last[j];
    if (!(trace > 1.0)) return 1;
  }
  return 0;
}

/* Integrate contact i panel by panel until its series reaches a local time. */
static status_t advance(component_t *c, long i, double tau) {
  memory_t *now = &c->now;
  contact_t *k = &now->contact[i];
  const motion_t *motion = form_of(now, i)->motion;
  const long n = motion->n_states;
  const drive_t d = drive_of(k);
  const double end = fmin(k->end - k->begin, 1e6 * HORIZON);
  const method_t m = {motion, &d, k->constants, k->scale, end, motion->n_stiff ? 1.0 : k->greatest};
  const int charted = places[i].kind->charted;
  double after[MAX_STATES], was[9];
  contact_t last;
  step_t s = {.tau = k->to, .h = k->next, .span = k->to - k->from};
  s.before = k->to > 0.0 ? k->series : NULL;
  for (long tries = 0; k->to < tau; tries++) {
    const int too_many = tries > MOST_PANELS;
    if (too_many && !pushed_at_rest(k))
      return report(c, FAILED, "logStatusError",
                    "contact %ld: a step of %.9g s to t = %.9g s is too long, it would take more "
                    "than %ld pieces of motion (they reach t = %.9g s); make shorter steps",
                    i + 1, k->begin + tau - now->time, k->begin + tau, MOST_PANELS,
                    k->begin + k->to);
    int made = too_many || !(k->next > 1e-13 * (end < tau ? end : tau))
                   ? -1
                   : panel(&m, &s, k->last, c->trial, after);
    if (made < 0)
      return report(c, FAILED, "logStatusError",
                    "contact %ld: the motion cannot be continued past t = %.9g s: %s", i + 1,
                    k->begin + k->to, obstacle(k));
    k->next = s.h;
    if (!made) continue;
    if (charted) { /* not where the panel begins: a pole may be there */
      rotation_at(now, i, k->to - (k->to - k->from) / 16.0, was);
      last = *k;
    }
    memcpy(k->series, c->trial, (size_t)(n * TERMS) * sizeof(double));
    memcpy(k->last, after, (size_t)n * sizeof(double));
    k->from = k->to, k->to = s.tau, s.before = k->series;
    if (charted && turns_over(now, i, was)) { /* the motion goes on up to there */
      last.next = 0.5 * (k->to - k->from), *k = last;
      s = (step_t){.tau = k->to, .h = k->next, .span = k->to - k->from};
      s.before = k->to > 0.0 ? k->series : NULL;
      continue;
    }
    lay_anchors(now, i);
  }
  return OK;
}

/* All contacts to one time, or none: after a failure the values are those of the time before. */
static status_t advance_all(component_t *c, double time) {
  contact_t *own = c->now.contact;
  int moves[N_CONTACTS] = {0};
  for (long i = 0; i < N_CONTACTS; i++) {
    const double tau = time - own[i].begin;
    if (own[i].to >= tau) continue;
    memcpy(&c->before[i], &own[i], sizeof own[i]), moves[i] = 1;
    if (!advance(c, i, tau)) continue;
    for (long j = 0; j <= i; j++)
      if (moves[j]) memcpy(&own[j], &c->before[j], sizeof own[j]);
    c->now.phase = BROKEN;
    return FAILED;
  }
  return OK;
}

/* --- results ---------------------------------------------------------------------------------- */

/* time, states, disturbance, law, numbers of finger and object: what the system's kernels take */
static void system_arguments(const memory_t *now, long i, double disturbance[6],
                             const double *a[6]) {
  const double *value = now->value + places[i].block;
  for (int j = 0; j < 6; j++) disturbance[j] = value[j] + now->window[i][j];
  a[0] = now->value, a[1] = value + AT_STATE, a[2] = disturbance, a[3] = law(now);
  a[4] = numbers(now, i, 0), a[5] = numbers(now, i, 1);
}

/* Contact i at the present time. */
static const moment_t *present(component_t *c, long i) {
  memory_t *now = &c->now;
  if (!(now->valid[i] & MOMENT)) moment(now, i, now->time - now->contact[i].begin, &c->moment[i]);
  now->valid[i] |= MOMENT;
  return &c->moment[i];
}

static void find_states(component_t *c, long i) {
  memory_t *now = &c->now;
  contact_t *k = &now->contact[i];
  double *value = now->value + places[i].block, out[2][COORDINATES], theta[2];
  const double tau = now->time - k->begin;
  const moment_t *m = present(c, i);
  for (int body = 0; body < 2; body++) {
    double *state = value + AT_STATE + BODY * body, *rate = value + AT_RATE + BODY * body;
    coordinates(now, i, body, m, tau, out[body]);
    for (int j = 0; j < 2; j++) {
      state[j] = out[body][j];
      rate[j] = out[body][2 + j] + (body ? m->disturbance[4 + j] : 0.0);
    }
    theta[body] = out[body][4];
    state[FRAME_ANGLE] = theta[body] + k->turn[body];
  }
  double a[4];
  places[i].kind->velocity((const double *const[]){k->turn, m->w1v}, a);
  memcpy(value + AT_STATE + VELOCITY, a, 2 * sizeof *a);
  memcpy(value + AT_STATE + BODY + VELOCITY, a + 2, 2 * sizeof *a);
  value[AT_STATE + ANGLE] = -(theta[0] + theta[1]);
  k->theta = theta[1];
}

/* The other rates exist where the chart does; those of coordinates come with them. */
static void find_other_rates(memory_t *now, long i) {
  double disturbance[6], rate[SYSTEM_STATES], *value = now->value + places[i].block + AT_RATE;
  const double *a[6];
  system_arguments(now, i, disturbance, a);
  places[i].kind->rates(a, rate);
  for (long j = 0; j < SYSTEM_STATES; j++)
    if (j % BODY > 1 || j == ANGLE) value[j] = rate[j];
}

static void find_slip(component_t *c, long i) {
  memory_t *now = &c->now;
  const moment_t *m = present(c, i);
  const double v[2] = {m->sigma * m->w1v[2], m->sigma * m->w1v[3]};
  form_of(now, i)->slip((const double *const[]){m->frame[1], &now->contact[i].theta, v,
                                                m->disturbance + 4, numbers(now, i, 1)},
                        now->value + places[i].block + AT_SLIP);
}

static unsigned group_of(const memory_t *now, long offset) {
  if (offset < (SYSTEM(now) ? AT_RATE : AT_STATE)) return 0;
  if (SYSTEM(now)) return offset < AT_SLIP ? RATES : RESULTS;
  if (offset < AT_SLIP) {
    const long j = offset - AT_RATE;
    return j < 0 || (j % BODY < 2 && j != ANGLE) ? STATE : RATES;
  }
  return offset < AT_TWIST ? SLIP : OUTPUTS;
}

/* Least Lame coefficient of the chart of one body of contact i at its states, over the body's size:
   0 at a pole or an umbilic, less where the chart's frame points inward. */
static double regularity(const memory_t *now, long i, int body) {
  const double *const a[] = {now->value + places[i].block + AT_STATE, numbers(now, i, 0),
                             numbers(now, i, 1)};
  double found[2];
  places[i].kind->regularity(a, found);
  return found[body] / places[i].size[body];
}

#define NEAR 1e-3 /* of the body's size; at 1e-6 fmpy's CVode takes more than its 500 steps */

/* Whether contact i has frames at its states; a log line where a solver gets into trouble. */
static int has_frames(component_t *c, long i) {
  int all = 1;
  for (int body = 0; body < 2; body++) {
    const double left = regularity(&c->now, i, body);
    if (!c->now.stepping && left < NEAR && !c->warned[i][body])
      report(c, OK, "logStatusWarning",
             "contact[%ld].%s: at t = %.9g s the path is within %.2g of "
             "the body's size of a singular point of its chart (a pole or an umbilic), where a "
             "solver takes tiny steps or stops; start elsewhere, or run the Co-Simulation, which "
             "passes such points",
             i + 1, body ? "object" : "finger", c->now.time, fabs(left));
    c->warned[i][body] = left < NEAR;
    all &= left > 0;
  }
  return all;
}

/* Whether the system's equations mean anything for contact i: beyond a pole they would give
   numbers of a frame that points inward. */
static int is_defined(component_t *c, long i) { return !past_end(&c->now) && has_frames(c, i); }

/* Says why there is no value. */
static status_t refuse(component_t *c, const char *what) {
  const memory_t *now = &c->now;
  if (past_end(now))
    return report(c, DISCARD, "logStatusDiscard",
                  "%s has no value at t = %.17g s: sigma is "
                  "negative from t = %.9g s on; end there, or change the profile",
                  what, now->time, now->limit);
  int framed = 1;
  for (long i = 0; i < 2L * N_CONTACTS; i++) framed &= regularity(now, i / 2, (int)(i % 2)) > 0;
  if (rests(now) && framed)
    return report(c, DISCARD, "logStatusDiscard", "%s has no value at t = %.17g s: " AT_REST, what,
                  now->time);
  const char *where =
      SYSTEM(now) ? "or beyond a singular point of a chart (a pole or an umbilic); start "
                    "elsewhere, or run the Co-Simulation, which passes such points"
                  : "a singular point of a chart (a pole or an umbilic); ask a moment later";
  return report(c, DISCARD, "logStatusDiscard", "%s has no value at t = %.17g s, at %s", what,
                now->time, where);
}

static void find(component_t *c, long i, unsigned group) {
  memory_t *now = &c->now;
  double disturbance[6], *value = now->value + places[i].block;
  const double *a[6];
  if (!group || (now->valid[i] & group)) return;
  if (SYSTEM(now)) {
    system_arguments(now, i, disturbance, a);
    const long first = group == RATES ? AT_RATE : AT_SLIP;
    const long end = group == RATES ? AT_SLIP : BLOCK_SIZE;
    (group == RATES ? places[i].kind->rates : places[i].kind->results)(a, value + first);
    if (!is_defined(c, i))
      for (long j = first; j < end; j++) value[j] = NAN;
  } else {
    if (group == RATES || group == SLIP) find(c, i, STATE);
    if (group == STATE)
      find_states(c, i);
    else if (group == RATES)
      find_other_rates(now, i);
    else if (group == SLIP)
      find_slip(c, i);
    else
      outputs_at(now, i, present(c, i), value + AT_TWIST);
  }
  now->valid[i] |= group;
}

/* The first of these values that there is not; count where there are all */
static long without_value(const memory_t *now, unsigned reference, const double *value,
                          long count) {
  long i = 0;
  for (; i < count; i++) {
    if (fabs(value[i]) <= INFINITE) continue;
    if (!(fabs(value[i]) <= DBL_MAX) || (kinds[reference + i] == CALCULATED && rests(now))) break;
  }
  return i;
}

status_t get_values(component_t *c, unsigned reference, long count, double *value) {
  memory_t *now = &c->now;
  const long offset = (long)reference - places[0].block;
  if (offset >= 0) {
    const long i = offset / BLOCK_SIZE;
    if (!SYSTEM(now)) settle(c);
    find(c, i, group_of(now, offset % BLOCK_SIZE));
  }
  memcpy(value, now->value + reference, (size_t)count * sizeof *value);
  const long wrong = without_value(now, reference, value, count);
  return wrong == count ? OK : refuse(c, names[reference + wrong]);
}

status_t check_value(component_t *c, unsigned reference, double value) {
  if (!(fabs(value) <= DBL_MAX))
    return report(c, DISCARD, "logStatusDiscard", "%s = %g is refused; give a finite number",
                  names[reference], value);
  if (value < least[reference])
    return report(c, DISCARD, "logStatusDiscard", "%s = %.9g is refused; give %g or more",
                  names[reference], value, least[reference]);
  return OK;
}

void set_value(component_t *c, unsigned reference, double value) {
  memory_t *now = &c->now;
  if (now->value[reference] == value) return;
  now->value[reference] = value;
  memset(now->valid, 0, sizeof now->valid);
  now->settled = 0;
}

status_t set_slope(component_t *c, unsigned reference, double slope) {
  const long offset = (long)reference - places[0].block;
  if (!(fabs(slope) <= DBL_MAX))
    return report(c, DISCARD, "logStatusDiscard",
                  "%s: the derivative %g is refused; give a finite "
                  "number",
                  names[reference], slope);
  c->now.input_slope[offset / BLOCK_SIZE][offset % BLOCK_SIZE] = slope;
  c->now.slope_begin = c->now.time;
  c->now.settled = 0;
  return OK;
}

/* --- time ------------------------------------------------------------------------------------- */

void reset(component_t *c, int stepping) {
  memset(&c->now, 0, sizeof c->now);
  memcpy(c->now.value, start_values, sizeof c->now.value);
  c->now.stepping = stepping, c->now.phase = INSTANTIATED;
  c->now.stop_time = c->now.limit = HUGE_VAL;
}

void set_time(component_t *c, double time) {
  if (c->now.time == time && c->now.value[0] == time) return;
  c->now.time = c->now.value[0] = time;
  memset(c->now.valid, 0, sizeof c->now.valid);
}

/* Put contact i where its states say. Returns what is wrong, or NULL. */
static const char *place_contact(memory_t *now, long i) {
  const contact_kind_t *kind = places[i].kind;
  double *state = now->value + places[i].block + AT_STATE;
  const double *const a[] = {state, numbers(now, i, 0), numbers(now, i, 1)};
  double first[MAX_STATES + 4], velocity[4], turn[2];
  double place[2][3] = {{state[0], state[1], -state[ANGLE]}, {state[BODY], state[BODY + 1], 0.0}};
  for (int body = 0; body < 2; body++)
    if (!(regularity(now, i, body) > 1e-12))
      return body ? "the object has no outward contact frame at (u, v)"
                  : "the finger has no outward contact frame at (u, v)";
  moment_t m;
  kind->start(a, first);
  const long n = kind->form[DRIVEN].size[0] + kind->form[DRIVEN].size[1];
  if (!all_finite(first, n + 4)) return "the start is not finite";
  memcpy(m.w1v, first + n, sizeof m.w1v);
  for (int body = 0; body < 2; body++)
    turn[body] = state[BODY * body + FRAME_ANGLE] - place[body][2];
  if (!now->stepping) {
    if (leaves_slip_behind(now)) {
      m.w1v[2] = m.w1v[3] = 0.0;
      kind->velocity((const double *const[]){turn, m.w1v}, velocity);
      memcpy(state + BODY + VELOCITY, velocity + 2, 2 * sizeof *velocity);
    }
    return NULL;
  }
  m.frame[0] = first, m.frame[1] = first + kind->form[DRIVEN].size[0];
  now->contact[i].form = DRIVEN;
  memcpy(now->contact[i].turn, turn, sizeof turn);
  begin_segment(now, i, &m, place);
  return NULL;
}

status_t start(component_t *c) {
  memory_t *now = &c->now;
  study_profile(now);
  if (now->limit <= now->time)
    return report(c, FAILED, "logStatusError",
                  "sigma is negative from t = %.9g s on; change the profile", now->time);
  for (const order_t *o = orders; o->greater; o++)
    if (o->less == o->greater && now->value[o->less] != start_values[o->less])
      return report(c, FAILED, "logStatusError",
                    "%s = %.9g is refused: the parameters of this "
                    "surface depend on each other and cannot be set individually; export a scene "
                    "with another surface",
                    names[o->less], now->value[o->less]);
    else if (o->less != o->greater && !(now->value[o->greater] > now->value[o->less]))
      return report(c, FAILED, "logStatusError",
                    "%s = %.9g is refused: it must be greater than "
                    "%s = %.9g, or the surface is of another kind; export a scene that has it",
                    names[o->greater], now->value[o->greater], names[o->less], now->value[o->less]);
  enter_windows(c);
  for (long i = 0; i < N_CONTACTS; i++) {
    const char *wrong = place_contact(now, i);
    if (wrong)
      return report(c, FAILED, "logStatusError",
                    "contact %ld cannot start: %s; change its "
                    "coordinates or the parameters of the surface",
                    i + 1, wrong);
  }
  now->settled = 1;
  return OK;
}

/* A slope lasts for one step; the input stays where it has come to. */
static void end_slopes(component_t *c, double duration) {
  for (long i = 0; i < N_CONTACTS; i++)
    for (int j = 0; j < 6; j++)
      if (c->now.input_slope[i][j] != 0.0) {
        c->now.value[places[i].block + j] += duration * c->now.input_slope[i][j];
        c->now.input_slope[i][j] = 0.0, c->now.settled = 0;
      }
}

status_t step(component_t *c, double target, int stop_at_windows, int *edge) {
  memory_t *now = &c->now;
  const double began = now->time;
  *edge = 0;
  now->ended = target > now->limit && !reached(now->limit, target);
  if (now->ended)
    return report(c, DISCARD, "logStatusDiscard",
                  "no step to t = %.9g s: sigma is negative from "
                  "t = %.9g s on; end there, or change the profile",
                  target, now->limit);
  if (now->pending) enter_windows(c);
  settle(c);
  while (!*edge && now->time < target) {
    const double next = next_edge(now), window = next_window(now);
    *edge = reached(target, next);
    const double goal = *edge ? next : fmin(target, now->limit);
    if (advance_all(c, goal)) return FAILED;
    set_time(c, goal);
    if (!*edge) break;
    now->pending = 1;
    if (stop_at_windows && reached(next, window)) break; /* a gain's pieces are no events */
    enter_windows(c);
    settle(c);
    *edge = 0;
  }
  end_slopes(c, now->time - began);
  return OK;
}

/* --- as a system of equations ----------------------------------------------------------------- */

static unsigned state_reference(long k) {
  return (unsigned)(places[k / SYSTEM_STATES].block + AT_STATE + k % SYSTEM_STATES);
}

status_t set_states(component_t *c, const double *state) {
  const long n = (long)SYSTEM_STATES * N_CONTACTS, wrong = not_finite(state, n);
  if (wrong < n)
    return report(c, DISCARD, "logStatusDiscard",
                  "%s = %g is refused; give finite continuous "
                  "states",
                  names[state_reference(wrong)], state[wrong]);
  for (long i = 0; i < N_CONTACTS; i++)
    memcpy(c->now.value + places[i].block + AT_STATE, state + SYSTEM_STATES * i,
           SYSTEM_STATES * sizeof *state);
  memset(c->now.valid, 0, sizeof c->now.valid);
  return OK;
}

static status_t get_all(component_t *c, long at, double *out) {
  for (long i = 0; i < N_CONTACTS; i++) {
    status_t s =
        get_values(c, (unsigned)(places[i].block + at), SYSTEM_STATES, out + SYSTEM_STATES * i);
    if (s) return s;
  }
  return OK;
}

status_t get_states(component_t *c, double *state) { return get_all(c, AT_STATE, state); }

status_t get_rates(component_t *c, double *rate) { return get_all(c, AT_RATE, rate); }

/* What kernels of derivatives take: the system's arguments, and where their seeds lie. Returns
   whether there are derivatives. */
static int prepare(component_t *c, long i, double disturbance[6], const double *a[12]) {
  const double *seed = c->seed + places[i].block;
  if (!SYSTEM(&c->now)) {
    settle(c);
    find(c, i, STATE);
  }
  system_arguments(&c->now, i, disturbance, a);
  a[6] = c->seed, a[7] = seed + AT_STATE, a[8] = seed + AT_INPUT, a[9] = c->seed + GAIN;
  a[10] = c->seed + places[i].finger, a[11] = c->seed + OBJECT;
  return !SYSTEM(&c->now) || is_defined(c, i);
}

static int all_zero(const double *x, long n) {
  long i = 0;
  while (i < n && x[i] == 0.0) i++;
  return i == n;
}

static void no_numbers(double *x, long n) {
  for (long j = 0; j < n; j++) x[j] = NAN;
}

status_t check_grown(component_t *c, unsigned reference, long count) {
  const long wrong = without_value(&c->now, reference, c->grown + reference, count);
  return wrong == count ? OK : refuse(c, names[reference + wrong]);
}

void forward(component_t *c) {
  double disturbance[6];
  const double *a[12];
  memcpy(c->grown, c->seed, sizeof c->grown);
  for (long i = 0; i < N_CONTACTS; i++) {
    double *grown = c->grown + places[i].block + AT_RATE;
    if (prepare(c, i, disturbance, a))
      places[i].kind->forward(a, grown);
    else
      no_numbers(grown, BLOCK_SIZE - AT_RATE);
  }
}

void reverse(component_t *c) {
  double disturbance[6], product[1 + SYSTEM_STATES + 6 + 1 + N_PROFILE + 2 * MAX_NUMBERS];
  const double *a[12];
  memcpy(c->grown, c->seed, sizeof c->grown);
  for (long i = 0; i < N_CONTACTS; i++) {
    const contact_kind_t *kind = places[i].kind;
    const long block = places[i].block, *n = kind->n_numbers;
    const long first[] = {0, block + AT_STATE, block, GAIN, places[i].finger, OBJECT};
    const long count[] = {1, SYSTEM_STATES, 6, 1 + N_PROFILE, n[0], n[1]};
    if (all_zero(c->seed + block + AT_RATE, BLOCK_SIZE - AT_RATE)) continue;
    const int found = prepare(c, i, disturbance, a);
    a[6] = c->seed + block + AT_RATE;
    if (found)
      kind->reverse(a, product);
    else
      no_numbers(product, sizeof product / sizeof *product);
    const double *from = product;
    for (int k = 0; k < 6; from += count[k++])
      for (long j = 0; j < count[k]; j++) c->grown[first[k] + j] += from[j];
  }
}
