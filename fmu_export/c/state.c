/* FMU states: what an importer holds, which is also the bytes that it may keep. */

#define SAVED_MARK                                                                                 \
  0x53544341544e4f43ULL /* CONTACTS; not 0, as importers look at the first word                    \
                         */
#define STATE_VERSION 7ULL

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

/* The state that a handle stands for, or NULL with a log line */
static saved_t *saved(component_t *c, void *state) {
  saved_t *s = state, *own = c->own;
  if (s && s->mark == own->mark && s->model == own->model) return s;
  report(c, FAILED,
         "this is no FMU state, or another model's; give one that this model handed out and that "
         "has not been freed");
  return NULL;
}

static status_t save(component_t *c, void **state) {
  saved_t *s = *state ? saved(c, *state) : new_saved(c->model);
  if (!s) return *state ? FAILED : report(c, FAILED, "no memory for an FMU state");
  memcpy(s, c->own, state_bytes(c->model));
  *state = s;
  return OK;
}

static void write_bytes(const model_t *m, saved_t *s, void *bytes) {
  s->checksum = checksum_of(m, s);
  memcpy(bytes, s, state_bytes(m));
}

/* Why bytes are no state of this model, or NULL. The checksum guards against damage, not against
   people who make states. */
static const char *read_bytes(const component_t *c, const void *bytes, size_t count, saved_t *s) {
  const saved_t *own = c->own;
  if (!bytes || count != own->length) return "its length is not that of this model's states";
  memcpy(s, bytes, count);
  if (s->version != own->version) return "it was written by another version";
  if (s->mark != own->mark || s->length != own->length || s->model != own->model)
    return "it belongs to another model";
  return s->checksum == checksum_of(c->model, s)
             ? NULL
             : "its checksum does not match; it has been changed";
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
