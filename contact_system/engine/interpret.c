/* Running tables of instructions on lanes. */

typedef double (*lanes_t)[L];
typedef void (*twin_t)(double (*restrict r)[L]);
#define INLINE static inline __attribute__((always_inline))

#include "generated/twins.inc"

/* The chain rule: tangents of a result, from its partial derivatives and the operands' tangents. A
   tangent of 0 adds nothing, even where the derivative is infinite. */
static void carry_tangents(double (*d)[L], const code_t *k, const double *partial, int n) {
  const uint16_t from[2] = {k->a, k->b};
  double sum[L] = {0};
  for (int j = 0; j < n; j++)
    for (int i = 0; i < L; i++)
      if (d[from[j]][i] != 0.0) sum[i] += partial[j] * d[from[j]][i];
  memcpy(d[k->to], sum, sizeof sum);
}

/* Runs a program on registers of `width` doubles: L, or 1, which gives the same bits. d: tangents,
   derivatives of the registers in L directions, which are carried along if width is 1; or NULL.

   Without `omp simd` gcc unrolls 16 lanes completely and then packs them poorly; clang vectorises
   no loop that is reached by a computed goto, hence the switch. */
INLINE void execute(const code_t *restrict k, double *restrict r, const int width, double (*d)[L]) {
#define REGISTER(of) r[of * width + i]
#define A REGISTER(k->a) /* the operands, as operations.inc writes them */
#define B REGISTER(k->b)
#define SIMPLE(name, value)                                                                        \
  case OP_##name: {                                                                                \
    SIMD for (int i = 0; i < width; i++) REGISTER(k->to) = (value);                                \
    break;                                                                                         \
  }
#define CALL(name, value)                                                                          \
  case OP_##name:                                                                                  \
    for (int i = 0; i < width; i++) REGISTER(k->to) = (value);                                     \
    break;
#define SINCOS(name, which)                                                                        \
  case OP_##name: {                                                                                \
    double s[L], c[L];                                                                             \
    sincos_of(r + k->a * width, s, c, width);                                                      \
    memcpy(r + k->to * width, which, (size_t)width * sizeof *r);                                   \
    break;                                                                                         \
  }
#define PARTIALS(name, ...)                                                                        \
  case OP_##name: {                                                                                \
    const double partial[] = {__VA_ARGS__};                                                        \
    carry_tangents(d, k, partial, (int)(sizeof partial / sizeof *partial));                        \
    break;                                                                                         \
  }
  for (; k->op != OP_END; k++) {
    if (d) {
      const int i = 0;
      switch (k->op) { DERIVATIVES(PARTIALS) }
    }
    switch (k->op) { OPERATIONS(SIMPLE, CALL, SINCOS) }
  }
#undef A
#undef B
}

static void load_registers(const table_t *table, double *r) {
  if (table->n_lit) memcpy(r + table->first_lit, table->literals, (size_t)table->n_lit * sizeof *r);
  execute(table->prologue, r, 1, NULL);
}

static void interpret(const code_t *k, lanes_t r) { execute(k, r[0], L, NULL); }
static void step(const program_t *p) { execute(p->code, p->registers, 1, NULL); }
static void step_tangents(const program_t *p, double (*d)[L]) {
  execute(p->code, p->registers, 1, d);
}

/* A table in registers of its own, with its constants set and its prologue run: only the inputs
   change from run to run. */
typedef struct {
  const table_t *table;
  const double *constants;
  lanes_t r;
  int64_t room;
} unit_t;

/* numbers side by side in a register: the vector extension of GCC and Clang */
#if defined(__AVX__)
enum { WIDE = 4 };
#else
enum { WIDE = 2 };
#endif
typedef double wide_t __attribute__((vector_size(8 * WIDE), aligned(8), may_alias));
#define UNROLLED(i, n) _Pragma("GCC unroll 16") for (int i = 0; i < (n); i++)
enum { PARTS = L / WIDE };

/* gcc would make `rep stos` of a loop and `rep movs` of memcpy(), slow for so few numbers. */
static inline void fill_lanes(double *lanes, double value) {
  const wide_t same = value - (wide_t){0};
  UNROLLED(p, PARTS) *(wide_t *)(lanes + p * WIDE) = same;
}

static inline void copy_lanes(double *to, const double *from) {
  UNROLLED(p, PARTS) *(wide_t *)(to + p * WIDE) = *(const wide_t *)(from + p * WIDE);
}

/* `count` numbers in the first lanes, and the last one in all others */
static inline void gather(double *lanes, const double *from, int count) {
  for (int i = 0; i < L; i++) lanes[i] = from[i < count ? i : count - 1];
}

static inline void copy_rows(lanes_t to, const double (*from)[L], int n) {
  for (int k = 0; k < n; k++) copy_lanes(to[k], from[k]);
}

/* Loads a table, whose inputs are then u->r[0] and on. Returns 0 if there is no memory. */
static int load(unit_t *u, const table_t *table, const double *constants) {
  if (u->table == table && u->constants == constants) return 1;
  if (u->room < table->n_regs) {
    free(u->r);
    u->table = NULL, u->room = 0;
    u->r = malloc((size_t)table->n_regs * sizeof *u->r);
    if (!u->r) return 0;
    u->room = table->n_regs;
  }
  for (int j = 0; j < table->n_const; j++) fill_lanes(u->r[table->n_in + j], constants[j]);
  for (int j = 0; j < table->n_lit; j++) fill_lanes(u->r[table->first_lit + j], table->literals[j]);
  interpret(table->prologue, u->r);
  u->table = table, u->constants = constants;
  return 1;
}

/* Runs a loaded table; returns the rows of its outputs. */
static inline lanes_t run(const unit_t *u) {
  if (u->table->twin >= 0)
    twins[u->table->twin](u->r);
  else
    interpret(u->table->body, u->r);
  return u->r + u->table->first_out;
}
