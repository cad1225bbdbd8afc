/* States of a run whose stack held other bytes before: the FMU takes its own bytes back, and they
   are the same. Prints, a line a run: states refused, bytes that differ from those of the first. */
#include "fmu.h"

#if FMI_VERSION == 2
#define STATE fmi2FMUstate
#define GET fmi2GetFMUstate
#define SIZE fmi2SerializedFMUstateSize
#define WRITE(fmu, state, bytes, size) fmi2SerializeFMUstate(fmu, state, (fmi2Byte *)bytes, size)
#define READ(fmu, bytes, size, state) fmi2DeSerializeFMUstate(fmu, (fmi2Byte *)bytes, size, state)
#else
#define STATE fmi3FMUState
#define GET fmi3GetFMUState
#define SIZE fmi3SerializedFMUStateSize
#define WRITE fmi3SerializeFMUState
#define READ fmi3DeserializeFMUState
#endif

#define STEPS 8
#define MOST_BYTES (1 << 20)

static void heard(int status, const char *category, const char *text) {
  (void)status, (void)category, (void)text;
}

/* Leaves a byte all over the stack that the next call will use. */
static void paint(int byte) {
  volatile unsigned char stack[1 << 15];
  for (size_t k = 0; k < sizeof stack; k++) stack[k] = (unsigned char)byte;
}

int main(int count, char **argument) {
  static unsigned char bytes[MOST_BYTES], first[STEPS][MOST_BYTES];
  static const int colour[] = {0x00, 0xff, 0x3f};
  void (*volatile painted)(int) = paint; /* not inlined */
  const model_t model = model_of(count - 1, argument + 1);
  for (int run = 0; run < 3; run++) {
    fmu_t fmu = create(model.token);
    size_t size = 0, refused = 0, different = 0;
    if (!fmu || begin(fmu)) stop("no instance");
    for (int k = 0; k < STEPS; k++) {
      STATE state = NULL, back = NULL;
      painted(colour[run]);
      if (advance(fmu, k * 0.1, 0.1)) stop("no step");
      if (GET(fmu, &state) || SIZE(fmu, state, &size) || size > MOST_BYTES) stop("no state");
      if (WRITE(fmu, state, bytes, size)) stop("no bytes");
      refused += READ(fmu, bytes, size, &back) != 0;
      if (!run) memcpy(first[k], bytes, size);
      for (size_t j = 0; j < size; j++) different += bytes[j] != first[k][j];
    }
    printf("%lu %lu\n", (unsigned long)refused, (unsigned long)different);
    release(fmu);
  }
  return 0;
}
