/* endurance time    STEP COUNT REPEATS   TOKEN N_VALUES REFERENCE...
   endurance memory  STEP COUNT REPEATS   TOKEN N_VALUES REFERENCE...
   endurance threads STEP COUNT INSTANCES TOKEN N_VALUES REFERENCE...

   time: prints, REPEATS times, microseconds a step, and a step with the values read.
   memory: COUNT steps and a reset, REPEATS times; prints the number of calls of the allocator in
     steps, and by how many bytes the heap in use and the process grow after the third time.
   threads: INSTANCES instances on two threads; prints how many of them end with other bits than one
     instance alone. */
#define _GNU_SOURCE
#include "fmu.h"

#include <malloc.h>
#include <pthread.h>
#include <time.h>
#include <unistd.h>

static void on_log_line(int status, const char *category, const char *text) {
  fprintf(stderr, "%d %s: %s\n", status, category, text);
}

/* --- the allocator, counted ------------------------------------------------------------------- */

extern void *__libc_malloc(size_t), *__libc_calloc(size_t, size_t), *__libc_realloc(void *, size_t);
extern void __libc_free(void *);
static volatile long allocations;

void *malloc(size_t n) {
  allocations++;
  return __libc_malloc(n);
}
void *calloc(size_t n, size_t size) {
  allocations++;
  return __libc_calloc(n, size);
}
void *realloc(void *p, size_t n) {
  allocations++;
  return __libc_realloc(p, n);
}
void free(void *p) {
  allocations++;
  __libc_free(p);
}

/* --- running ---------------------------------------------------------------------------------- */

typedef struct {
  double step;
  long count, repeats;
  model_t model;
} job_t;

static void run(fmu_t fmu, const job_t *job, int reading, double *value) {
  for (long k = 0; k < job->count; k++) {
    if (advance(fmu, (double)k * job->step, job->step)) stop("a step failed");
    if (reading && get(fmu, job->model.reference, job->model.count, value, job->model.n_values))
      stop("values cannot be read");
  }
}

static fmu_t started(const job_t *job) {
  fmu_t fmu = create(job->model.token, 1);
  if (!fmu || begin(fmu)) stop("the FMU does not start");
  return fmu;
}

static void restart(fmu_t fmu) {
  if (reset(fmu) || begin(fmu)) stop("no reset");
}

static double now(void) {
  struct timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void measure_time(const job_t *job) {
  static double value[MOST_VALUES];
  fmu_t fmu = started(job);
  run(fmu, job, 1, value);
  for (long k = 0; k < job->repeats; k++)
    for (int reading = 0; reading < 2; reading++) {
      restart(fmu);
      const double began = now();
      run(fmu, job, reading, value);
      printf("%.4f%c", 1e6 * (now() - began) / (double)job->count, reading ? '\n' : ' ');
    }
  release(fmu);
}

static long resident(void) {
  long pages = 0;
  FILE *file = fopen("/proc/self/statm", "r");
  if (!file || fscanf(file, "%*s %ld", &pages) != 1) stop("no /proc/self/statm");
  fclose(file);
  return pages * sysconf(_SC_PAGESIZE);
}

static void measure_memory(const job_t *job) {
  static double value[MOST_VALUES];
  long inside = 0, heap = 0, process = 0;
  fmu_t fmu = started(job);
  for (long k = 0; k < job->repeats; k++) {
    restart(fmu);
    const long before = allocations;
    run(fmu, job, 1, value);
    inside += allocations - before;
    if (k == 2) resident(), process = resident(), heap = (long)mallinfo2().uordblks;
  }
  heap = (long)mallinfo2().uordblks - heap;
  process = resident() - process;
  printf("%ld %ld %ld\n", inside, heap, process);
  release(fmu);
}

/* --- threads ---------------------------------------------------------------------------------- */

typedef struct {
  const job_t *job;
  fmu_t *fmu;
  long count;
} crew_t;

/* Steps a crew's instances: each of them once, then each of them a second time, and so on. */
static void *step_all(void *given) {
  const crew_t *crew = given;
  const job_t *job = crew->job;
  for (long k = 0; k < job->count; k++)
    for (long i = 0; i < crew->count; i++)
      if (advance(crew->fmu[i], (double)k * job->step, job->step)) stop("a step failed");
  return NULL;
}

static void compare_threads(const job_t *job) {
  static double alone[MOST_VALUES], value[MOST_VALUES];
  static fmu_t many[1024];
  const long half = job->repeats / 2;
  const model_t *m = &job->model;
  pthread_t thread[2];
  if (job->repeats > 1024) stop("too many instances");
  fmu_t one = started(job);
  run(one, job, 1, alone);
  for (long i = 0; i < job->repeats; i++) many[i] = started(job);
  const crew_t crew[2] = {{job, many, half}, {job, many + half, job->repeats - half}};
  for (int k = 0; k < 2; k++) pthread_create(&thread[k], NULL, step_all, (void *)&crew[k]);
  for (int k = 0; k < 2; k++) pthread_join(thread[k], NULL);
  long different = 0;
  for (long i = 0; i < job->repeats; i++) {
    if (get(many[i], m->reference, m->count, value, m->n_values)) stop("values cannot be read");
    different += memcmp(value, alone, m->n_values * sizeof *value) != 0;
    release(many[i]);
  }
  release(one);
  printf("%ld\n", different);
}

int main(int count, char **argument) {
  if (count < 7) stop("usage: see the head of endurance.c");
  const job_t job = {strtod(argument[2], NULL), strtol(argument[3], NULL, 10),
                     strtol(argument[4], NULL, 10), model_of(count - 5, argument + 5)};
  if (!strcmp(argument[1], "time")) measure_time(&job);
  else if (!strcmp(argument[1], "memory")) measure_memory(&job);
  else if (!strcmp(argument[1], "threads")) compare_threads(&job);
  else stop("the first argument is time, memory or threads");
  return 0;
}
