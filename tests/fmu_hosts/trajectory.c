/* trajectory STEP COUNT TOKEN N_VALUES REFERENCE...
   Steps an FMU and prints the values at every communication point, one line each. With glibc it
   traps floating-point exceptions, as importers may: division by zero, invalid, overflow. */
#define _GNU_SOURCE
#include "fmu.h"

#include <fenv.h>

static void on_log_line(int status, const char *category, const char *text) {
  fprintf(stderr, "%d %s: %s\n", status, category, text);
}

int main(int count, char **argument) {
  static double value[MOST_VALUES];
  if (count < 5) stop("usage: trajectory STEP COUNT TOKEN N_VALUES REFERENCE...");
  const double size = strtod(argument[1], NULL);
  const long steps = strtol(argument[2], NULL, 10);
  const model_t m = model_of(count - 3, argument + 3);
#ifdef __GLIBC__
  feenableexcept(FE_DIVBYZERO | FE_INVALID | FE_OVERFLOW);
#endif
  fmu_t fmu = create(m.token, 1);
  if (!fmu || begin(fmu)) stop("the FMU does not start");
  for (long k = 0; k <= steps; k++) {
    if (k && advance(fmu, (double)(k - 1) * size, size)) stop("a step failed");
    if (get(fmu, m.reference, m.count, value, m.n_values)) stop("values cannot be read");
    for (size_t j = 0; j < m.n_values; j++) printf("%.17g ", value[j]);
    printf("\n");
  }
  const unsigned none = 4294967295u; /* as a signed long of 32 bits it would be -1 */
  if (!get(fmu, &none, 1, value, 1)) stop("a reference without a variable has a value");
  if (reset(fmu)) stop("no reset");
  release(fmu);
  /* solvers may evaluate at times after sigma has turned negative: refused or not, no trap */
  if (!(fmu = create(m.token, 0)) || begin(fmu) || set_continuous_time(fmu, 1e6))
    stop("no Model Exchange");
  get(fmu, m.reference, m.count, value, m.n_values);
  release(fmu);
  return 0;
}
