/* The bytes of an FMU state, and what in foreign ones cannot be. */

typedef struct {
  char magic[8];
  unsigned long long version, length, model, checksum;
} header_t;

#define STATE_VERSION 4ULL /* 3 held panels */

static size_t state_bytes(const model_t *m) { return sizeof(header_t) + memory_size(m); }

/* Tells models apart. */
static unsigned long long model_digest(const model_t *m) {
  return digest(token_of(m), strlen(token_of(m)), 14695981039346656037ULL);
}

static header_t header_for(const model_t *m, const memory_t *memory) {
  header_t h = {{'C', 'O', 'N', 'T', 'A', 'C', 'T', 'S'}, STATE_VERSION, state_bytes(m), 0, 0};
  h.model = model_digest(m);
  h.checksum = digest(memory, memory_size(m), h.model);
  return h;
}

static void write_state(const model_t *m, const memory_t *memory, unsigned char *bytes) {
  const header_t h = header_for(m, memory);
  memcpy(bytes, &h, sizeof h);
  memcpy(bytes + sizeof h, memory, memory_size(m));
}

static int is_flag(int x) { return x == 0 || x == 1; }

static const char *check_memory(const model_t *m, const memory_t *now) {
  const double *value = (const double *)(now + 1), *least = section(m, D_LEAST);
  const segment_t *s = (const segment_t *)(value + m->n_values);
  const int phases =
      INSTANTIATED | CONFIGURATION | INITIALIZATION | EVENT | CONTINUOUS | STEP | TERMINATED;
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
    if (!all_finite(&s->gain, 1 + 2 + DISTURBANCES + 1 + ROW))
      return "a motion in it is not finite";
    if (!(s->gain >= 0.0) || !is_flag((int)s->moment) || !(s->frames >= 0 && s->frames < 4))
      return "a motion in it is of no kind that there is";
    if (!(s->begin >= 0 && s->begin <= now->time) || !(s->end < 0 || s->end >= now->acts_at) ||
        !(fabs(s->end) < 1e300))
      return "the times of a motion in it are out of range";
    for (int side = 0; side < 2; side++)
      if ((int)s->frames & (1 << side) && !surface_of(m, i, side)->ambient[A_MOTION])
        return "a motion in it is of no kind that there is";
  }
  return NULL;
}

/* Returns NULL, or what does not fit. Bytes with the right checksum may have been made by anybody:
   every number that chooses, counts or points is held to what it may be, and those that the motion
   is computed from are finite. */
static const char *read_state(const model_t *m, const unsigned char *bytes,
                              unsigned long long count, memory_t *memory) {
  header_t found;
  if (count != state_bytes(m)) return "its length is not that of this model's states";
  memcpy(&found, bytes, sizeof found);
  memcpy(memory, bytes + sizeof found, memory_size(m));
  const header_t right = header_for(m, memory);
  if (memcmp(found.magic, right.magic, sizeof found.magic))
    return "it is not a state of a contact model";
  if (found.version != right.version) return "it was written by another version";
  if (found.length != right.length) return "its header gives another length";
  if (found.model != right.model) return "it belongs to another model";
  if (found.checksum != right.checksum) return "its checksum does not match; it has been changed";
  return check_memory(m, memory);
}
