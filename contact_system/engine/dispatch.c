/* Chooses the variant of the engine for the processor that the library runs on.

   With HAVE_V3 engine.c is compiled for x86-64-v3 (AVX2) too. The environment variable
   CONTACT_SYSTEM_VECTORS=baseline forbids it.

   The processor is asked directly: __builtin_cpu_supports always says no in what ziglang links, and
   draws in that compiler's own sin, exp and the like, which are less exact than libm's. */
#include "engine.h"
#include <stdlib.h>
#include <string.h>

#include "generated/tables.inc"

extern const engine_t engine_baseline;

#ifdef __wasm__
/* What longjmp throws, which ziglang's C library leaves out */
__asm__(".weak __c_longjmp\n.tagtype __c_longjmp i32\n__c_longjmp:\n");
#endif

#ifdef HAVE_V3
#include <cpuid.h>

extern const engine_t engine_v3;

/* whether processor and operating system have x86-64-v3 */
static int has_v3(void) {
  /* v3: FMA, MOVBE, OSXSAVE, AVX, F16C; BMI, AVX2, BMI2; LZCNT */
  const unsigned v3_1 = 1u << 12 | 1u << 22 | 1u << 27 | 1u << 28 | 1u << 29;
  const unsigned v3_7 = 1u << 3 | 1u << 5 | 1u << 8, v3_ext = 1u << 5;
  unsigned a, b, c1, b7, c_ext, d, saved, high;
  if (!__get_cpuid(1, &a, &b, &c1, &d) || (c1 & v3_1) != v3_1) return 0;
  if (!__get_cpuid(0x80000001, &a, &b, &c_ext, &d) || (c_ext & v3_ext) != v3_ext) return 0;
  if (__get_cpuid_max(0, NULL) < 7) return 0;
  __cpuid_count(7, 0, a, b7, c1, d);
  __asm__(".byte 0x0f, 0x01, 0xd0" : "=a"(saved), "=d"(high) : "c"(0)); /* xgetbv */
  return (b7 & v3_7) == v3_7 && (saved & 0x06) == 0x06; /* the system keeps 256 bits */
}
#endif

const engine_t *contact_engine(void) {
#ifdef HAVE_V3
  const char *allowed = getenv("CONTACT_SYSTEM_VECTORS");
  if (has_v3() && !(allowed && strcmp(allowed, "baseline") == 0)) return &engine_v3;
#endif
  return &engine_baseline;
}

const int32_t contact_layout[] = {SCENE_VERSION, S_HEADER, CONTACT_SIZE, MOMENT_SIZE};
