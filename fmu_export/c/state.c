/* FMU states, which an importer holds; serialized, they are the same bytes. */

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

/* The FMU state of an importer's handle; NULL, with a log line, if it is none of this model */
static saved_t *saved(component_t *c, void *state) {
  saved_t *s = state, *own = c->fmu_state;
  if (s && s->mark == own->mark && s->model == own->model) return s;
  report(c, FAILED,
         "this is no FMU state, or another model's; give one that this model handed out and that "
         "has not been freed");
  return NULL;
}
