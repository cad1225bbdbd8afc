/* State bytes that somebody made on purpose: their checksum is right, some of their numbers are
   not. The layout is that of state.c and component.h: a header of 40 bytes, six flags, times. */
#include <stdint.h>
#include <string.h>

enum { HEADER = 40, FLAGS = 6, TIME = HEADER + 4 * FLAGS, FIRST = TIME + 4 * 8 };

double forge(unsigned char *bytes, unsigned (*below)(unsigned), double (*number)(void));

/* Overwrites a few numbers of good bytes; `below` draws, `number` is any real number. Returns the
   time that the state says. */
double forge(unsigned char *bytes, unsigned (*below)(unsigned), double (*number)(void)) {
  static const int odd[] = {-1, 0, 1, 2, 3, 4, 8, 16, 64, 512, 0x7fffffff, -0x7fffffff - 1};
  uint64_t length, checksum;
  uint32_t a = 1, b = 0;
  double time;
  memcpy(&length, bytes + 16, sizeof length);
  for (unsigned count = 1 + below(3); count; count--) {
    const int any = below(2) ? odd[below(sizeof odd / sizeof *odd)] : (int)below(100) - 50;
    const double x = below(3) ? number() : any;
    switch (below(4)) {
      case 0: memcpy(bytes + HEADER + 4 * below(FLAGS), &any, sizeof any); break;
      case 1: memcpy(bytes + TIME + 8 * below(4), &x, sizeof x); break;
      default: memcpy(bytes + FIRST + 8 * below((unsigned)(length - FIRST) / 8), &x, sizeof x);
    }
    memcpy(&time, bytes + TIME, sizeof time);
    if (below(4) == 0) memcpy(bytes + FIRST, &time, sizeof time); /* so that more are taken */
  }
  for (uint64_t k = HEADER; k < length; k++) a = (a + bytes[k]) % 65521, b = (b + a) % 65521;
  checksum = b << 16 | a; /* Adler's */
  memcpy(bytes + 32, &checksum, sizeof checksum);
  memcpy(&time, bytes + TIME, sizeof time);
  return time;
}
