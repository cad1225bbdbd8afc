/* Chooses the variant of the engine for the processor that the library runs on.

   engine.c is compiled once for each level of x86-64; HAVE_V3 and HAVE_V4 say which were. The
   environment variable CONTACT_SYSTEM_VECTORS=baseline|v3|v4 allows none wider than that one.

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

#if defined HAVE_V3 || defined HAVE_V4
#include <cpuid.h>

extern const engine_t engine_v3, engine_v4;

/* the level of x86-64 that processor and operating system have: 1, 3 or 4 */
static int level(void) {
  /* v3: FMA, MOVBE, OSXSAVE, AVX, F16C; BMI, AVX2, BMI2; LZCNT */
  const unsigned v3_1 = 1u << 12 | 1u << 22 | 1u << 27 | 1u << 28 | 1u << 29;
  const unsigned v3_7 = 1u << 3 | 1u << 5 | 1u << 8, v3_ext = 1u << 5;
  /* v4: AVX-512 F, DQ, CD, BW, VL */
  const unsigned v4_7 = 1u << 16 | 1u << 17 | 1u << 28 | 1u << 30 | 1u << 31;
  unsigned a, b, c1, b7, c_ext, d, saved, high;
  if (!__get_cpuid(1, &a, &b, &c1, &d) || (c1 & v3_1) != v3_1) return 1;
  if (!__get_cpuid(0x80000001, &a, &b, &c_ext, &d) || (c_ext & v3_ext) != v3_ext) return 1;
  if (__get_cpuid_max(0, NULL) < 7) return 1;
  __cpuid_count(7, 0, a, b7, c1, d);
  __asm__(".byte 0x0f, 0x01, 0xd0" : "=a"(saved), "=d"(high) : "c"(0)); /* xgetbv */
  if ((b7 & v3_7) != v3_7 || (saved & 0x06) != 0x06) /* the system keeps 256 bits */
    return 1;
  return (b7 & v4_7) == v4_7 && (saved & 0xe6) == 0xe6 ? 4 : 3;
}
#endif

const engine_t *contact_engine(void) {
#if defined HAVE_V3 || defined HAVE_V4
  const char *named = getenv("CONTACT_SYSTEM_VECTORS");
  const char *widest = named && *named ? named : "v4"; /* "baseline" < "v3" < "v4" */
  const int has = level();
#ifdef HAVE_V4
  if (has >= 4 && strcmp(widest, "v4") >= 0) return &engine_v4;
#endif
#ifdef HAVE_V3
  if (has >= 3 && strcmp(widest, "v3") >= 0) return &engine_v3;
#endif
#endif
  return &engine_baseline;
}

const surface_t *contact_surface(int index) {
  return index < n_builtin_surfaces ? builtin_surfaces + index : NULL;
}

const table_t *contact_table(int index) { return contact_tables + index; }

const int32_t contact_layout[] = {SCENE_VERSION, S_HEADER,     BODY_SIZE,  WINDOW_SIZE,
                                  LEG_SIZE,      CONTACT_SIZE, MOMENT_SIZE};
