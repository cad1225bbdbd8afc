/* trajectory STEP COUNT TOKEN N_VALUES REFERENCE...
   Steps an FMU and prints the values at every communication point, one line each. Where the C
   library can, it traps operations that have no number as their result, as importers may. */
#define _GNU_SOURCE
#include "fmu.h"

#include <fenv.h>

static void heard(int status, const char *category, const char *text) {
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
  const unsigned none = 4294967295u; /* negative where long has 32 bits */
  if (!get(fmu, &none, 1, value, 1)) stop("there is a value without a variable");
  if (reset(fmu)) stop("no reset");
  release(fmu);
  /* a solver may look where sigma is long negative, and is refused at most */
  if (!(fmu = create(m.token, 0)) || begin(fmu) || look_at(fmu, 1e6)) stop("no Model Exchange");
  get(fmu, m.reference, m.count, value, m.n_values);
  release(fmu);
  return 0;
}
