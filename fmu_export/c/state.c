/* FMU states: what an importer holds, which is also the bytes that it may keep. */

#define SAVED_MARK                                                                                 \
  0x53544341544e4f43ULL /* CONTACTS; not 0, as importers look at the first word                    \
                         */
#define STATE_VERSION 6ULL

static size_t memory_size(const model_t *m) {
  return sizeof(memory_t) + (size_t)m->n_values * sizeof(double) +
         (size_t)m->n_contacts * sizeof(segment_t);
}

static size_t state_bytes(const model_t *m) { return offsetof(saved_t, memory) + memory_size(m); }

static unsigned long long checksum_of(const model_t *m, const saved_t *s) {
  return adler32(&s->memory, memory_size(m));
}

static saved_t *new_saved(const model_t *m) {
  saved_t *s = calloc(1, state_bytes(m));
  if (!s) return NULL;
  s->mark = SAVED_MARK, s->version = STATE_VERSION, s->length = state_bytes(m);
  memcpy(&s->model, token_of(m) + 1, sizeof s->model); /* its first digits */
  return s;
}

static int is_flag(double x) { return x == 0.0 || x == 1.0; }

static const char *check_memory(const model_t *m, const memory_t *now) {
  const double *value = (const double *)(now + 1), *least = section(m, D_LEAST);
  const segment_t *s = (const segment_t *)(value + m->n_values);
  const int phases = INSTANTIATED | INITIALIZATION | EVENT | CONTINUOUS | STEP | TERMINATED;
  const int other = !now->stepping ? STEP : now->uses_events ? CONTINUOUS : CONTINUOUS | EVENT;
  if (now->phase <= 0 || now->phase & (now->phase - 1) || !(now->phase & phases & ~other))
    return "its phase is none that an instance can be in";
  if (!is_flag(now->stepping) || !is_flag(now->uses_events) || !is_flag(now->settled) ||
      !is_flag(now->pending) || !is_flag(now->ended))
    return "a flag in it is neither 0 nor 1";
  if (!(fabs(now->time) < 1e300) || value[TIME_VALUE] != now->time ||
      now->stop_time != now->stop_time || now->limit != now->limit ||
      !(fabs(now->acts_at - now->time) <= 1e-9 * fmax(1.0, fabs(now->time)) || !now->stepping) ||
      !(fabs(now->acts_at) < 1e300))
    return "its times are out of range";
  for (long r = 1; r < m->n_values; r++) {
    const int kind = kind_of(m, (unsigned)r);
    const int given = kind != CALCULATED && (kind != EXACT || SYSTEM(now));
    if (given && !(value[r] >= least[r] && value[r] <= DBL_MAX))
      return "a parameter, an input or a state in it is out of range";
  }
  for (long i = 0; i < m->n_contacts && !SYSTEM(now); i++, s++) {
    const double frames = s->row[K_FRAMES];
    if (!all_finite((const double *)s, sizeof *s / sizeof(double)))
      return "a motion in it is not finite";
    if (!(s->gain >= 0.0) || !is_flag(s->row[K_MOMENT]) || !is_flag(s->measured) ||
        !(frames >= 0 && frames < 4))
      return "a motion in it is of no kind that there is";
    if (!(s->begin >= 0 && s->begin <= now->time) || !(s->end < 0 || s->end >= now->acts_at) ||
        !(fabs(s->end) < 1e300))
      return "the times of a motion in it are out of range";
    for (int side = 0; side < 2; side++)
      if ((int)frames & (1 << side) && !surface_of(m, i, side)->ambient[A_MOTION])
        return "a motion in it is of no kind that there is";
  }
  return NULL;
}

/* The state that a handle stands for, or NULL with a log line */
static saved_t *saved(component_t *c, void *state) {
  saved_t *s = state, *own = c->own;
  if (s && s->mark == own->mark && s->model == own->model) return s;
  report(c, FAILED,
         "this is no FMU state, or another model's; give one that this model handed out and that "
         "has not been freed");
  return NULL;
}

/* What was calculated is no part of a state. */
static status_t save(component_t *c, void **state) {
  const model_t *m = c->model;
  saved_t *s = *state ? saved(c, *state) : new_saved(m);
  if (!s) return *state ? FAILED : report(c, FAILED, "no memory for an FMU state");
  memcpy(s, c->own, state_bytes(m));
  double *value = (double *)(&s->memory + 1);
  for (long r = 0; r < m->n_values; r++) {
    const int kind = kind_of(m, (unsigned)r);
    if (kind == CALCULATED || (kind == EXACT && !SYSTEM(c->now))) value[r] = 0.0;
  }
  *state = s;
  return OK;
}

static void write_bytes(const model_t *m, saved_t *s, void *bytes) {
  s->checksum = checksum_of(m, s);
  memcpy(bytes, s, state_bytes(m));
}

/* What does not fit, or NULL. Bytes with the right checksum may have been made by anybody: every
   number that chooses, counts or points is held to what it may be, and those that the motion is
   computed from are finite. */
static const char *read_bytes(const component_t *c, const void *bytes, size_t count, saved_t *s) {
  const saved_t *own = c->own;
  if (!bytes || count != own->length) return "its length is not that of this model's states";
  memcpy(s, bytes, count);
  if (s->mark != own->mark) return "it is not a state of a contact model";
  if (s->version != own->version) return "it was written by another version";
  if (s->length != own->length) return "its header gives another length";
  if (s->model != own->model) return "it belongs to another model";
  if (s->checksum != checksum_of(c->model, s))
    return "its checksum does not match; it has been changed";
  return check_memory(c->model, &s->memory);
}

static status_t read_state(component_t *c, const void *bytes, size_t count, void **state) {
  saved_t *s = new_saved(c->model);
  const char *wrong = s ? read_bytes(c, bytes, count, s) : "there is no memory";
  if (wrong) {
    free(s);
    return report(
        c, FAILED,
        "serialized FMU state refused: %s; use the bytes that this FMU wrote, as they are", wrong);
  }
  free(*state);
  *state = s;
  return OK;
}
