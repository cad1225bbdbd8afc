/* FMU states: what an importer holds, which is also the bytes that it may keep. */

#define SAVED_MARK 0x53544341544e4f43ULL /* CONTACTS; importers take 0 for no state */
#define STATE_VERSION 12ULL

static size_t memory_size(const model_t *m) {
  return sizeof(memory_t) + (size_t)m->n_values * sizeof(double) +
         (size_t)m->n_contacts * sizeof(segment_t);
}

static unsigned long long checksum_of(const model_t *m, const saved_t *s) {
  return adler32(&s->memory, memory_size(m));
}

static saved_t *new_saved(const model_t *m) {
  const size_t length = offsetof(saved_t, memory) + memory_size(m);
  saved_t *s = calloc(1, length);
  if (!s) return NULL;
  s->mark = SAVED_MARK, s->version = STATE_VERSION, s->length = length;
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
  memcpy(s, c->own, c->own->length);
  *state = s;
  return OK;
}

/* A state from its bytes. The checksum guards against damage, not against forgery. */
static status_t read_state(component_t *c, const void *bytes, size_t count, void **state) {
  const saved_t *own = c->own;
  saved_t *s = new_saved(c->model);
  const char *wrong = NULL;
  if (!s)
    wrong = "there is no memory";
  else if (!bytes || count != own->length || memcmp(bytes, own, offsetof(saved_t, checksum)))
    wrong = "it belongs to another model or another version";
  else if (memcpy(s, bytes, count), s->checksum != checksum_of(c->model, s))
    wrong = "its checksum does not match; it has been changed";
  if (wrong) {
    free(s);
    REFUSE("serialized FMU state refused: %s; use the bytes that this FMU wrote, as they are",
           wrong);
  }
  *state = s; /* what was there before is nothing to read: it may be uninitialized */
  return OK;
}
