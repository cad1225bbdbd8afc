/* Reading a scene's data: see model.h. */

/* The data of the FMU whose resources are here, to be freed, or NULL. scene.c copies an array, in
   an FMU that an importer compiles (see data.py); else resource.c reads the file. */
static void *scene_data(const char *resources, size_t *count);

static unsigned adler32(const void *data, size_t count) {
  const unsigned char *byte = data;
  unsigned a = 1, b = 0;
  for (size_t k = 0; k < count; k++) a = (a + byte[k]) % 65521, b = (b + a) % 65521;
  return b << 16 | a;
}

/* What lies at a place of the data */
static inline const void *data_at(const model_t *m, int64_t place) {
  return (const int64_t *)(m->head + 1) + place;
}

/* Where a group of a contact's values begins, or for GROUPS where the last one ends: a reference */
static inline long at_of(const model_t *m, long i, int group) {
  return (long)m->contacts[i].groups[group];
}

/* How many states a contact has: those of two frames, then W_1 and V */
static inline long states_of(const model_t *m, long i) {
  return at_of(m, i, OF_RATES) - at_of(m, i, OF_STATES);
}

static inline size_t frame_of(const model_t *m, long i, int side) {
  return (size_t)m->contacts[i].frames[side];
}

/* A contact's row in the engine's scene as it was exported, and a body's */
static inline const double *row_of(const model_t *m, long i) {
  return m->scene + S_HEADER + i * CONTACT_SIZE;
}

static inline const double *body_of(const model_t *m, long i, int side) {
  return side ? m->scene + S_OBJECT : row_of(m, i) + K_FINGER;
}

static inline int cancels_growth(const model_t *m) { return m->scene[S_CANCELS_GROWTH] > 0; }

static inline const table_t *system_of(const model_t *m, long i) {
  return m->tables + m->contacts[i].system;
}

static inline const surface_t *surface_of(const model_t *m, long i, int side) {
  return m->surfaces[(long)body_of(m, i, side)[B_SURFACE]];
}

/* How many parameters a body has */
static inline size_t n_parameters(const model_t *m, long i, int side) {
  return (size_t)surface_of(m, i, side)->n_numbers - 1; /* besides its sign */
}

/* How many values the variable of a reference has; 0: there is no such variable */
static inline unsigned size_of(const model_t *m, unsigned reference) {
  return reference < (unsigned)m->n_values ? (unsigned)m->values[reference].size : 0;
}

static const char *name_of(const model_t *m, unsigned reference) {
  const char *name = data_at(m, m->head->names);
  while (reference--) name += strlen(name) + 1;
  return name;
}

static const char *token_of(const model_t *m) { return data_at(m, m->head->token); }

static void read_tables(model_t *m) {
  const table_row_t *row = data_at(m, m->head->tables.at);
  for (long k = 0; k < m->head->tables.count; k++, row++) {
    table_t *t = m->tables + k;
    memcpy(t, row->numbers, sizeof row->numbers);
    t->prologue = data_at(m, row->prologue), t->body = data_at(m, row->body);
    t->literals = data_at(m, row->literals);
  }
}

static void read_surfaces(model_t *m) {
  const surface_row_t *row = data_at(m, m->head->surfaces.at);
  for (long s = 0; s < m->head->surfaces.count; s++, row++) {
    surface_t *own = m->user_surfaces + s;
    m->surfaces[s] = row->builtin < 0 ? own : builtin_surfaces + row->builtin;
    *own = (surface_t){.name = "",
                       .n_numbers = row->n_numbers,
                       .double_cover = row->double_cover,
                       .closed_form = row->closed_form,
                       .may_be_singular = row->may_be_singular,
                       .period_u = row->period_u,
                       .period_v = row->period_v};
    for (int k = 0; k < 2 * N_TABLES; k++) {
      const int64_t table = row->tables[k];
      own->tables[k / N_TABLES][k % N_TABLES] = table < 0 ? NULL : m->tables + table;
    }
  }
}

static void free_model(model_t *m) {
  if (!m) return;
  free(m->head), free(m->surfaces), free(m->user_surfaces), free(m->tables), free(m);
}

/* Returns NULL, and in *wrong why, if there is no scene of this version. */
static model_t *read_model(const char *resources, const char **wrong) {
  size_t count = 0;
  model_t *m = calloc(1, sizeof *m);
  *wrong = "no memory";
  if (!m) return NULL;
  const head_t *h = m->head = scene_data(resources, &count);
  *wrong = "resources/scene.bin cannot be read: instantiate with the folder that the FMU was "
           "unpacked to";
  if (!h) goto refused;
  *wrong = "resources/scene.bin is damaged, or of another version; export the FMU again";
  if (8 * count <= sizeof *h || h->version != DATA_VERSION ||
      h->checksum != (int64_t)adler32(&h->registers, 8 * count - offsetof(head_t, registers)))
    goto refused;
  m->values = data_at(m, h->values.at), m->n_values = (long)h->values.count;
  m->contacts = data_at(m, h->contacts.at), m->n_contacts = (long)h->contacts.count;
  m->windows = data_at(m, h->windows.at), m->n_windows = (long)h->windows.count;
  m->scene = data_at(m, h->scene.at);
  const size_t surfaces = (size_t)h->surfaces.count;
  m->surfaces = calloc(surfaces, sizeof *m->surfaces);
  m->user_surfaces = calloc(surfaces, sizeof *m->user_surfaces);
  m->tables = calloc((size_t)h->tables.count, sizeof *m->tables);
  *wrong = "no memory";
  if (!m->surfaces || !m->user_surfaces || !m->tables) goto refused;
  read_tables(m);
  read_surfaces(m);
  for (long i = 0; i < m->n_contacts; i++) m->n_states += states_of(m, i);
  *wrong = NULL;
  return m;
refused:
  free_model(m);
  return NULL;
}
