/* Reading a scene's data: see model.h. */

/* The data of the FMU whose resources are here, to be freed; NULL where there is none. In FMUs of
   sources scene.c returns the array in scene.inc, else resource.c reads the file. */
static double *scene_data(const char *resources, size_t *count);

static unsigned adler32(const void *data, size_t count) {
  const unsigned char *byte = data;
  unsigned a = 1, b = 0;
  for (size_t k = 0; k < count; k++) a = (a + byte[k]) % 65521, b = (b + a) % 65521;
  return b << 16 | a;
}

static inline const double *section(const model_t *m, int at) {
  return m->data + (long)m->data[at];
}

/* How many rows a section has */
static inline long count_of(const model_t *m, int at) { return (long)section(m, at)[-1]; }

static inline const double *contact_of(const model_t *m, long i) {
  return section(m, D_CONTACTS) + i * P_SIZE;
}

/* Where a group of a contact's values begins, or for GROUPS where the last one ends: a reference */
static inline long at_of(const model_t *m, long i, int group) {
  return (long)contact_of(m, i)[P_GROUPS + group];
}

/* How many states a contact has: those of two frames, then W_1 and V */
static inline long states_of(const model_t *m, long i) {
  return at_of(m, i, OF_RATES) - at_of(m, i, OF_STATES);
}

static inline long frame_of(const model_t *m, long i, int side) {
  return (long)contact_of(m, i)[P_FRAMES + side];
}

/* The engine's buffer as it was exported; a contact's row there, and a body's */
static inline const double *scene_of(const model_t *m) { return section(m, D_SCENE); }

static inline const double *row_of(const model_t *m, long i) {
  return scene_of(m) + S_HEADER + i * CONTACT_SIZE;
}

static inline const double *body_of(const model_t *m, long i, int side) {
  return side ? scene_of(m) + S_OBJECT : row_of(m, i) + K_FINGER;
}

static inline int makes_up(const model_t *m) { return scene_of(m)[S_MAKES_UP] > 0; }

static inline const table_t *system_of(const model_t *m, long i) {
  return m->tables + (long)contact_of(m, i)[P_SYSTEM];
}

static inline const surface_t *surface_of(const model_t *m, long i, int side) {
  return m->surfaces[(long)body_of(m, i, side)[B_SURFACE]];
}

/* A body's parameters: the reference of the first, and how many */
static inline long parameters_of(const model_t *m, long i, int side) {
  return (long)contact_of(m, i)[P_PARAMETERS + side];
}

static inline size_t n_parameters(const model_t *m, long i, int side) {
  return (size_t)surface_of(m, i, side)->n_numbers - 1; /* besides its sign */
}

static inline double value_row(const model_t *m, unsigned reference, int number) {
  return section(m, D_VALUES)[reference * VALUE_SIZE + (unsigned)number];
}

static inline long owner_of(const model_t *m, unsigned reference) {
  return (long)value_row(m, reference, R_OWNER);
}

static inline int kind_of(const model_t *m, unsigned reference) {
  return (int)value_row(m, reference, R_KIND);
}

static const char *name_of(const model_t *m, unsigned reference) {
  const char *name = (const char *)section(m, D_NAMES);
  while (reference--) name += strlen(name) + 1;
  return name;
}

static inline const char *token_of(const model_t *m) { return (const char *)section(m, D_TOKEN); }

static void read_tables(model_t *m) {
  for (long k = 0; k < count_of(m, D_TABLES); k++) {
    const double *row = section(m, D_TABLES) + k * T_SIZE;
    table_t *t = m->tables + k;
    int32_t *const numbers[] = {&t->n_in,      &t->n_const,   &t->n_out, &t->n_lit,
                                &t->first_lit, &t->first_out, &t->n_regs};
    for (int n = T_NUMBERS; n < T_PROLOGUE; n++) *numbers[n] = (int32_t)row[n];
    t->twin = -1;
    t->prologue = (const code_t *)(m->data + (long)row[T_PROLOGUE]);
    t->body = (const code_t *)(m->data + (long)row[T_BODY]);
    t->literals = m->data + (long)row[T_LITERALS];
  }
}

static void read_surfaces(model_t *m) {
  for (long s = 0; s < count_of(m, D_SURFACES); s++) {
    const double *row = section(m, D_SURFACES) + s * F_SIZE;
    surface_t *own = m->own + s;
    if (row[F_BUILTIN] >= 0) {
      m->surfaces[s] = contact_surface((int)row[F_BUILTIN]);
      continue;
    }
    *own = (surface_t){.name = "",
                       .n_numbers = (int32_t)row[F_N_NUMBERS],
                       .double_cover = (int32_t)row[F_DOUBLE_COVER],
                       .flags = (int32_t)row[F_FLAGS],
                       .period_u = row[F_PERIOD_U],
                       .period_v = row[F_PERIOD_V]};
    for (int k = 0; k < N_AMBIENT + N_CHART; k++) {
      const table_t **to = k < N_AMBIENT ? own->ambient + k : own->chart + k - N_AMBIENT;
      *to = row[F_AMBIENT + k] < 0 ? NULL : m->tables + (long)row[F_AMBIENT + k];
    }
    m->surfaces[s] = own;
  }
}

static void free_model(model_t *m) {
  if (!m) return;
  free(m->data), free(m->surfaces), free(m->own), free(m->tables), free(m);
}

/* Returns NULL and says why where there is no scene that fits. */
static model_t *read_model(const char *resources, const char **wrong) {
  size_t count = 0;
  model_t *m = calloc(1, sizeof *m);
  *wrong = "no memory";
  if (!m) return NULL;
  const double *d = m->data = scene_data(resources, &count);
  *wrong = "resources/scene.bin cannot be read: instantiate with the folder that the FMU was "
           "unpacked to";
  if (!d) goto refused;
  *wrong = "resources/scene.bin is damaged, or of another version; export the FMU again";
  if (count <= D_HEADER || d[D_VERSION] != DATA_VERSION || d[D_SIZE] != (double)count ||
      d[D_CHECKSUM] != (double)adler32(d + D_HEADER, 8 * (count - D_HEADER)))
    goto refused;
  m->n_contacts = count_of(m, D_CONTACTS), m->n_values = count_of(m, D_VALUES);
  m->n_windows = count_of(m, D_WINDOWS);
  const size_t surfaces = (size_t)count_of(m, D_SURFACES);
  m->surfaces = calloc(surfaces, sizeof *m->surfaces), m->own = calloc(surfaces, sizeof *m->own);
  m->tables = calloc((size_t)count_of(m, D_TABLES), sizeof *m->tables);
  *wrong = "no memory";
  if (!m->surfaces || !m->own || !m->tables) goto refused;
  read_tables(m);
  read_surfaces(m);
  for (long i = 0; i < m->n_contacts; i++) m->n_states += states_of(m, i);
  *wrong = NULL;
  return m;
refused:
  free_model(m);
  return NULL;
}
