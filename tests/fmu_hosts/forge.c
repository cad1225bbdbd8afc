/* State bytes that somebody made on purpose: their checksum is right, some of their numbers are
   not. Compiled with the sources inside the FMU: layout and checksum are those of component.h. */
#include "component.h"

double forge(unsigned char *bytes, unsigned (*below)(unsigned), double (*number)(void));

/* Overwrites a few numbers of good bytes; `below` draws, `number` is any real number. Returns the
   time that the state says. */
double forge(unsigned char *bytes, unsigned (*below)(unsigned), double (*number)(void)) {
  static const int odd[] = {-1, 0, 1, 2, 3, 4, 8, 16, 64, 512, 0x7fffffff, -0x7fffffff - 1};
  memory_t m;
  memcpy(&m, bytes + sizeof(header_t), sizeof m);
  for (unsigned count = 1 + below(3); count; count--) {
    contact_t *k = &m.contact[below(N_CONTACTS)];
    int *const flag[] = {&m.phase, &m.stepping, &m.uses_events, &m.settled, &m.pending, &m.ended,
                         &k->form, &k->power};
    long *const length[] = {&m.n_knots, &k->n_sigma, &k->n_exponent};
    double *const time[] = {&m.time, &m.stop_time, &m.limit, &m.slope_begin, &k->begin, &k->end,
                            &k->from, &k->to, &k->next, &k->greatest, &k->eta};
    const int any = below(2) ? odd[below(sizeof odd / sizeof *odd)] : (int)below(100) - 50;
    switch (below(6)) {
      case 0: *flag[below(sizeof flag / sizeof *flag)] = any; break;
      case 1: *length[below(sizeof length / sizeof *length)] = any; break;
      case 2: *time[below(sizeof time / sizeof *time)] = number(); break;
      case 3: m.value[below(N_VALUES)] = number(); break;
      case 4: m.valid[below(N_CONTACTS)] = (unsigned)any; break;
      default: { /* anywhere: an int or a double */
        unsigned char *at = (unsigned char *)&m + 8 * below(sizeof m / 8);
        const double x = number();
        if (below(2)) memcpy(at, &x, sizeof x);
        else memcpy(at, &any, sizeof any);
      }
    }
    if (below(4) == 0) m.value[0] = m.time; /* so that more of them are taken */
  }
  write_state(&m, bytes);
  return m.time;
}
