/* fuzz SEQUENCES BLOBS SEED TOKEN N_VALUES REFERENCE...

   Makes random sequences of calls, legal or not, with random arguments, of both interfaces, and
   reads damaged state bytes. Built with sanitizers; besides errors that those find it stops when
   - a status is none of OK, Warning, Discard and Error, or is not OK without a log line, or a line
     has an undeclared category;
   - values returned with status OK are not finite;
   - after a reset an instance, whatever was done to it before, gives other values than a fresh one;
   - damaged bytes are accepted as a state or change the instance, or good ones are refused;
   - one call takes a minute of processor time.
   fuzz2.h and fuzz3.h have the calls of each version. Prints the number of calls, how many of them
   returned OK, and the longest time of a call with its name. */
#include "fmu.h"

#include <math.h>
#include <signal.h>
#include <sys/time.h>
#include <time.h>

/* --- random arguments ------------------------------------------------------------------------- */

static unsigned long long seed;

static unsigned below(unsigned n) { /* xorshift64 */
  seed ^= seed << 13, seed ^= seed >> 7, seed ^= seed << 17;
  return (unsigned)((seed >> 11) % n);
}

static int one_in(unsigned n) { return below(n) == 0; }

static double number(void) {
  static const double odd[] = {NAN, INFINITY, -INFINITY, 1e300, -1e300, 1e-310, -1.0, 30.0, 0.0};
  return one_in(4) ? odd[below(sizeof odd / sizeof *odd)] : below(2000) / 1000.0;
}

/* --- what is known of the model and of the present call --------------------------------------- */

static model_t model;
static unsigned greatest;  /* reference */
static size_t n_states;    /* continuous */
static double time_now;    /* the instance's time, as far as the importer knows */
static int lines, logging; /* log lines of this call; whether all categories are on */
static int never_early;    /* a step of this instance never returns early */
static const char *called;
static unsigned reference[8];
static double value[MOST_VALUES];

static void fail(const char *what) {
  fflush(stdout);
  fprintf(stderr, "%s: %s\n", called, what);
  abort();
}

static void too_long(int signal) {
  (void)signal;
  fail("takes more than a minute");
}

/* It counts processor time, so that a call may take longer on a busy machine. */
static void start_timer(void) {
  const struct itimerval minute = {.it_value = {60, 0}};
  setitimer(ITIMER_PROF, &minute, NULL);
}

static void on_log_line(int status, const char *category, const char *text) {
  static const char *const declared[] = {"logStatusDiscard", "logStatusError"};
  int known = 0;
  for (int k = 0; k < 2; k++) known |= !strcmp(category, declared[k]);
  if (!known) fail("a log line in a category that is not declared");
  if (status < 0 || status > 3 || !*text) fail("a log line without a status or a text");
  lines++;
}

static int finite_values(size_t n) {
  for (size_t k = 0; k < n; k++)
    if (!isfinite(value[k])) return 0;
  return 1;
}

/* Chooses up to four references, a few of which do not exist; returns their number. */
static size_t pick_references(void) {
  for (int k = 0; k < 4; k++)
    reference[k] = one_in(50)  ? below(4000000000u)
                   : one_in(4) ? below(greatest + 3)
                               : model.reference[below((unsigned)model.count)];
  return below(5);
}

static void fill_values(void) {
  for (int k = 0; k < 64; k++) value[k] = number();
}

static void fill_states(void) {
  for (size_t k = 0; k < n_states; k++)
    value[k] = one_in(60) ? number() : one_in(30) ? 0.0 : below(1000) / 500.0;
}

typedef struct {
  const char *name;
  unsigned weight;
  int (*call)(fmu_t);
} call_t;

#define KEPT 2
static unsigned char *bytes; /* a serialized state, in a block of exactly its length */
static size_t n_bytes;

static void keep_bytes(size_t n) {
  free(bytes);
  bytes = malloc(n_bytes = n);
  memset(bytes, 0, n);
}

/* Functions of both versions, whose names differ in spelling. */
#if FMI_VERSION == 2
#define F(two, three) fmi2##two
typedef fmi2Byte byte_t;
static void disable_callback(void) {}
#else
#define F(two, three) fmi3##three
typedef fmi3Byte byte_t;
static fmu_t inside; /* the instance that calls back */
static void disable_callback(void) { inside = NULL; }
#endif

static F(FMUstate, FMUState) state[KEPT];

static void free_states(fmu_t fmu) {
  for (int k = 0; k < KEPT; k++) F(FreeFMUstate, FreeFMUState)(fmu, &state[k]);
  disable_callback();
}

static int write_bytes(fmu_t fmu) {
  F(FMUstate, FMUState) own = NULL;
  size_t size = 0;
  int status = F(GetFMUstate, GetFMUState)(fmu, &own);
  if (status) return status;
  status = F(SerializedFMUstateSize, SerializedFMUStateSize)(fmu, own, &size);
  keep_bytes(size);
  if (!status) status = F(SerializeFMUstate, SerializeFMUState)(fmu, own, (byte_t *)bytes, size);
  F(FreeFMUstate, FreeFMUState)(fmu, &own);
  return status;
}

static int parse(fmu_t fmu, const unsigned char *given, size_t n, F(FMUstate, FMUState) * to) {
  return F(DeSerializeFMUstate, DeserializeFMUState)(fmu, (const byte_t *)given, n, to);
}

static int read_bytes(fmu_t fmu, const unsigned char *given, size_t n) {
  F(FMUstate, FMUState) *to = &state[below(KEPT)], made = NULL;
  const int status = parse(fmu, given, n, &made);
  if (status && made) fail("refused bytes make a state");
  if (!status) F(FreeFMUstate, FreeFMUState)(fmu, to), *to = made;
  return status;
}

static int set_debug_logging(fmu_t fmu) {
  static const F(String, String) names[] = {"logStatusError", "nothing", "logStatusDiscard", "%s%n"};
  logging = 0;
  return F(SetDebugLogging, SetDebugLogging)(fmu, one_in(2), below(3),
                                             one_in(9) ? NULL : names + below(3));
}

static int terminate(fmu_t fmu) {
  return one_in(4) ? (int)F(Terminate, Terminate)(fmu) : get(fmu, NULL, 0, NULL, 0);
}

static int reset_any(fmu_t fmu) {
  time_now = 0.0;
  return reset(fmu);
}

static int get_state(fmu_t fmu) { return F(GetFMUstate, GetFMUState)(fmu, &state[below(KEPT)]); }
static int free_state(fmu_t fmu) { return F(FreeFMUstate, FreeFMUState)(fmu, &state[below(KEPT)]); }

static int deserialize(fmu_t fmu) {
  if (!n_bytes) return parse(fmu, NULL, below(100), &state[0]);
  return read_bytes(fmu, bytes, one_in(4) ? below((unsigned)n_bytes) : n_bytes);
}

static int exit_initialization(fmu_t fmu) {
  return F(ExitInitializationMode, ExitInitializationMode)(fmu);
}
static int enter_event(fmu_t fmu) { return F(EnterEventMode, EnterEventMode)(fmu); }
static int enter_continuous(fmu_t fmu) {
  return F(EnterContinuousTimeMode, EnterContinuousTimeMode)(fmu);
}
static int set_time(fmu_t fmu) { return F(SetTime, SetTime)(fmu, number()); }

static int completed_step(fmu_t fmu) {
  F(Boolean, Boolean) a, b;
  return F(CompletedIntegratorStep, CompletedIntegratorStep)(fmu, one_in(2), one_in(50) ? NULL : &a,
                                                             &b);
}

static size_t states_count(void) { return one_in(15) ? below((unsigned)n_states) : n_states; }

static int set_states(fmu_t fmu) {
  fill_states();
  const size_t n = states_count();
  const int status = F(SetContinuousStates, SetContinuousStates)(fmu, value, n);
  if (!status && !finite_values(n)) fail("a state that is not finite was taken");
  return status;
}

static int get_derivatives(fmu_t fmu) {
  const size_t n = states_count();
  const int status = F(GetDerivatives, GetContinuousStateDerivatives)(fmu, value, n);
  if (!status && !finite_values(n)) fail("a derivative that is not finite, with status OK");
  return status;
}

#if FMI_VERSION == 2
#include "fuzz2.h"
#else
#include "fuzz3.h"
#endif

/* --- sequences -------------------------------------------------------------------------------- */

static long calls_made, accepted; /* accepted: those that returned OK */
static double slowest;
static const char *slowest_name = "-";

static double seconds(void) {
  struct timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void check_call(fmu_t fmu, const call_t *c) {
  called = c->name, lines = 0;
  start_timer();
  const double began = seconds();
  const int status = c->call(fmu);
  const double lasted = seconds() - began;
  if (lasted > slowest) slowest = lasted, slowest_name = c->name;
  if (status < 0 || status > 3) fail("a status that is none of OK, Warning, Discard, Error");
  if (status && fmu && logging && !lines) fail("refused without a log line");
  if (!fmu && !status) fail("OK without an instance");
  calls_made++, accepted += !status;
}

static const call_t *pick_call(void) {
  unsigned total = 0;
  for (const call_t *c = calls; c->name; c++) total += c->weight;
  unsigned left = below(total);
  const call_t *c = calls;
  while (left >= c->weight) left -= c++->weight;
  return c;
}

/* Makes a few steps of a started instance and reads its values. */
static void step_and_read(fmu_t fmu, double *found) {
  static const double size[] = {0.01, 0.2, 0.0007, 0.4};
  double t = 0.0;
  for (int k = 0; k < 4; t += size[k++])
    if (advance(fmu, t, size[k])) fail("a plain step failed");
  if (get(fmu, model.reference, model.count, found, model.n_values)) fail("no values");
}

static void compare_after_reset(fmu_t fmu, const double *expected) {
  static double found[MOST_VALUES];
  called = "after a reset";
  if (reset(fmu)) fail("no reset");
  if (begin(fmu)) fail("no start");
  step_and_read(fmu, found);
  if (memcmp(found, expected, model.n_values * sizeof *found))
    fail("other numbers than a fresh instance");
}

static void run_sequence(const double *expected) {
  const int stepping = !one_in(3), length = 5 + (int)below(40);
  fmu_t fmu = create_any(stepping);
  if (!fmu) fail("no instance");
  time_now = 0.0, logging = 1;
  if (!one_in(4)) start_any(fmu, stepping);
  for (int k = 0; k < length; k++) check_call(one_in(400) ? NULL : fmu, pick_call());
  free_states(fmu);
  if (stepping && never_early) compare_after_reset(fmu, expected);
  release(fmu);
}

/* --- state bytes ------------------------------------------------------------------------------ */

/* Damages a copy of `bytes` in one of several ways; returns its length. */
static size_t damage(unsigned char *copy) {
  size_t n = n_bytes;
  const size_t at = below((unsigned)n), span = 1 + below(64);
  memcpy(copy, bytes, n);
  switch (below(7)) {
    case 0: /* single bits */
      for (unsigned k = 1 + below(8); k; k--)
        copy[below((unsigned)n)] ^= (unsigned char)(1u << below(8));
      break;
    case 1: /* a bit of the header */ copy[below(40)] ^= (unsigned char)(1u << below(8)); break;
    case 2: /* too short */ n = below((unsigned)n); break;
    case 3: /* too long */
      n += 1 + below(32);
      memset(copy + n_bytes, (int)below(256), n - n_bytes);
      break;
    case 4: /* a stretch of noise */
      for (size_t k = at; k < n && k < at + span; k++) copy[k] = (unsigned char)below(256);
      break;
    case 5: /* a stretch of zeros, or of ones */
      for (size_t k = at; k < n && k < at + 8 * span; k++) copy[k] = one_in(2) ? 0 : 255;
      break;
    default: /* one part over another */
      memmove(copy + below((unsigned)(n - span)), copy + below((unsigned)(n - span)), span);
  }
  return n;
}

static void run_blob(fmu_t fmu) {
  unsigned char *given = malloc(n_bytes + 64);
  const size_t n = damage(given);
  unsigned char *exact = malloc(n ? n : 1); /* AddressSanitizer finds reads beyond its end */
  memcpy(exact, given, n);
  const int same = n == n_bytes && !memcmp(given, bytes, n);
  lines = 0, called = "reading damaged state bytes";
  start_timer();
  const int status = read_bytes(fmu, exact, n);
  if (same != !status) fail(same ? "good bytes refused" : "damaged bytes taken for a state");
  if (status && !lines) fail("refused without a log line");
  free(given), free(exact);
}

static void run_blobs(const model_t *m, long count) {
  unsigned char *before;
  fmu_t fmu = create(m->token, 1);
  called = "state bytes";
  for (long k = 0; k < count; k++) {
    if (k % 500 == 0) { /* the state of another moment */
      if ((k && reset(fmu)) || begin(fmu)) fail("no start");
      if (advance(fmu, 0.0, 0.02 * (1 + below(39)))) fail("no step");
      if (write_bytes(fmu)) fail("the state is not given");
    }
    run_blob(fmu);
    if (k % 50) continue;
    before = memcpy(malloc(n_bytes), bytes, n_bytes);
    if (write_bytes(fmu) || memcmp(before, bytes, n_bytes)) fail("the instance has changed");
    free(before);
  }
  free_states(fmu);
  release(fmu);
}

int main(int count, char **argument) {
  static double expected[MOST_VALUES];
  if (count < 6) stop("usage: fuzz SEQUENCES BLOBS SEED TOKEN N_VALUES REFERENCE...");
  signal(SIGPROF, too_long);
  model = model_of(count - 4, argument + 4);
  seed = strtoull(argument[3], NULL, 10) * 2654435761u + 88172645463325252u;
  for (size_t k = 0; k < model.count; k++)
    if (model.reference[k] > greatest) greatest = model.reference[k];
  called = "at the start";
  fmu_t fresh = create(model.token, 1);
  if (!fresh || begin(fresh)) fail("the FMU does not start");
  find_sizes(fresh);
  step_and_read(fresh, expected);
  release(fresh);
  for (long k = strtol(argument[1], NULL, 10); k > 0; k--) run_sequence(expected);
  run_blobs(&model, strtol(argument[2], NULL, 10));
  free(bytes);
  printf("%ld %ld %.4f %s\n", calls_made, accepted, slowest, slowest_name);
  return 0;
}
