/* The few calls that the programs here make, in FMI 2 (FMI_VERSION 2) and FMI 3. */
#ifndef FMU_HOST
#define FMU_HOST
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define MOST_VALUES 4096

/* Called with every log line; `text` is formatted. Each program defines it. */
static void on_log_line(int status, const char *category, const char *text);

/* The FMU's resources folder, by the variable FMU_FOLDER; FMI 2 wants a URI ("file://" before). */
static const char *resources(const char *before) {
  static char text[4096];
  const char *folder = getenv("FMU_FOLDER");
  snprintf(text, sizeof text, "%s%s/resources", before, folder ? folder : "");
  return text;
}

#if FMI_VERSION == 2
#include "fmi2Functions.h"
typedef fmi2Component fmu_t;

static void log_line(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status,
                     fmi2String category, fmi2String format, ...) {
  char text[2048];
  va_list arguments;
  (void)environment, (void)name;
  va_start(arguments, format);
  vsnprintf(text, sizeof text, format, arguments);
  va_end(arguments);
  on_log_line(status, category, text);
}

static const fmi2CallbackFunctions callbacks = {log_line, calloc, free, NULL, NULL};

static fmu_t create(const char *token, int stepping) {
  return fmi2Instantiate("one", stepping ? fmi2CoSimulation : fmi2ModelExchange, token,
                         resources("file://"), &callbacks, fmi2False, fmi2True);
}

static int begin(fmu_t fmu) {
  return fmi2SetupExperiment(fmu, fmi2False, 0.0, 0.0, fmi2False, 0.0) ||
         fmi2EnterInitializationMode(fmu) || fmi2ExitInitializationMode(fmu);
}

static int advance(fmu_t fmu, double time, double size) {
  return fmi2DoStep(fmu, time, size, fmi2True);
}

static int set_continuous_time(fmu_t fmu, double time) {
  return fmi2EnterContinuousTimeMode(fmu) || fmi2SetTime(fmu, time);
}

static int get(fmu_t fmu, const unsigned *reference, size_t count, double *value, size_t n) {
  (void)n;
  return fmi2GetReal(fmu, reference, count, value);
}

static int reset(fmu_t fmu) { return fmi2Reset(fmu); }
static void release(fmu_t fmu) { fmi2FreeInstance(fmu); }
#else
#include "fmi3Functions.h"
typedef fmi3Instance fmu_t;

static void log_line(fmi3InstanceEnvironment environment, fmi3Status status, fmi3String category,
                     fmi3String text) {
  (void)environment;
  on_log_line(status, category, text);
}

static fmu_t create(const char *token, int stepping) {
  if (!stepping)
    return fmi3InstantiateModelExchange("one", token, resources(""), fmi3False, fmi3True, NULL,
                                        log_line);
  return fmi3InstantiateCoSimulation("one", token, resources(""), fmi3False, fmi3True, fmi3False,
                                     fmi3False, NULL, 0, NULL, log_line, NULL);
}

static int begin(fmu_t fmu) {
  return fmi3EnterInitializationMode(fmu, fmi3False, 0.0, 0.0, fmi3False, 0.0) ||
         fmi3ExitInitializationMode(fmu);
}

static int advance(fmu_t fmu, double time, double size) {
  fmi3Boolean event, terminate, early;
  double reached;
  return fmi3DoStep(fmu, time, size, fmi3True, &event, &terminate, &early, &reached) || event ||
         terminate || early;
}

static int set_continuous_time(fmu_t fmu, double time) {
  return fmi3EnterContinuousTimeMode(fmu) || fmi3SetTime(fmu, time);
}

static int get(fmu_t fmu, const unsigned *reference, size_t count, double *value, size_t n) {
  return fmi3GetFloat64(fmu, reference, count, value, n);
}

static int reset(fmu_t fmu) { return fmi3Reset(fmu); }
static void release(fmu_t fmu) { fmi3FreeInstance(fmu); }
#endif

static void stop(const char *what) {
  fflush(stdout);
  fprintf(stderr, "%s\n", what);
  exit(1);
}

/* The last arguments of every program: TOKEN N_VALUES REFERENCE...; the variables of all references
   together have N_VALUES values. */
typedef struct {
  const char *token;
  size_t n_values, count;
  unsigned reference[MOST_VALUES];
} model_t;

static model_t model_of(int count, char **argument) {
  static model_t m;
  if (count < 2 || count - 2 > MOST_VALUES) stop("usage: ... TOKEN N_VALUES REFERENCE...");
  m.token = argument[0], m.n_values = strtoul(argument[1], NULL, 10);
  m.count = (size_t)count - 2;
  for (size_t k = 0; k < m.count; k++)
    m.reference[k] = (unsigned)strtoul(argument[2 + k], NULL, 10);
  if (m.n_values > MOST_VALUES) stop("too many values");
  return m;
}

#endif
