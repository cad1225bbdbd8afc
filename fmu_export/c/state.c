/* The bytes of an FMU state, and what in foreign ones cannot be. */
#include "component.h"

#define STATE_VERSION 3ULL /* 2 held frames of nine numbers */

/* FNV-1a, 64 bit */
static unsigned long long digest(const void *data, size_t count, unsigned long long hash) {
  const unsigned char *byte = data;
  for (size_t k = 0; k < count; k++) hash = (hash ^ byte[k]) * 1099511628211ULL;
  return hash;
}

unsigned long long model_digest(void) {
  return digest(model_token, strlen(model_token), 14695981039346656037ULL);
}

static header_t header_for(const memory_t *memory) {
  header_t h = {{'C', 'O', 'N', 'T', 'A', 'C', 'T', 'S'}, STATE_VERSION, STATE_BYTES, 0, 0};
  h.model = model_digest();
  h.checksum = digest(memory, sizeof *memory, h.model);
  return h;
}

void write_state(const memory_t *memory, unsigned char *bytes) {
  const header_t h = header_for(memory);
  memcpy(bytes, &h, sizeof h);
  memcpy(bytes + sizeof h, memory, sizeof *memory);
}

static int is_flag(int x) { return x == 0 || x == 1; }

static const char *check_memory(const memory_t *now) {
  const int phases = INSTANTIATED | CONFIGURATION | INITIALIZATION | EVENT | CONTINUOUS | STEP |
                     TERMINATED | BROKEN;
  const int other = !now->stepping     ? STEP | BROKEN
                    : now->uses_events ? CONTINUOUS
                                       : CONTINUOUS | EVENT;
  if (now->phase <= 0 || now->phase & (now->phase - 1) || !(now->phase & phases & ~other))
    return "its phase is none that an instance can be in";
  if (!is_flag(now->stepping) || !is_flag(now->uses_events) || !is_flag(now->settled) ||
      !is_flag(now->pending) || !is_flag(now->ended))
    return "a flag in it is neither 0 nor 1";
  if (!(fabs(now->time) < 1e300) || now->value[0] != now->time ||
      now->stop_time != now->stop_time || now->limit != now->limit)
    return "its times are out of range";
  if (now->n_knots < 0 || now->n_knots > MAX_KNOTS || now->n_knots % 2)
    return "the number of pieces of its gain is out of range";
  for (unsigned r = 1; r < N_VALUES; r++) {
    const int computed = kinds[r] == CALCULATED || (kinds[r] == EXACT && !SYSTEM(now));
    if (!computed && !(now->value[r] >= least[r] && now->value[r] <= DBL_MAX))
      return "a parameter, an input or a state in it is out of range";
  }
  if (!all_finite(now->knots, MAX_KNOTS) || !all_finite(&now->slope_begin, 1) ||
      !all_finite(now->input_slope[0], 6 * N_CONTACTS) ||
      !all_finite(now->window[0], 6 * N_CONTACTS))
    return "what acts on its contacts is not finite";
  return NULL;
}

static const char *check_contact(const memory_t *now, long i) {
  const contact_t *k = &now->contact[i];
  const long n_exponent = GAIN_LAW == PATH ? 2 * N_PROFILE : 2;
  if (SYSTEM(now)) return NULL; /* nothing has moved yet, or the importer moves it */
  if (k->form < 0 || k->form >= N_FORMS) return "the form of a contact's motion is out of range";
  if (!is_flag(k->power) || k->n_sigma != N_PROFILE || k->n_exponent != n_exponent)
    return "the profile of a contact is out of range";
  if (!(fabs(k->begin) < 1e300) || !(k->begin <= now->time) || k->end != k->end ||
      !(0 <= k->from && k->from <= k->to))
    return "the times of a contact are out of range";
  const struct {
    const double *first;
    long count;
  } parts[] = {{k->disturbance, 6},
               {k->slope, 6},
               {&k->eta, 1},
               {k->sigma, MAX_SIGMA},
               {k->exponent, MAX_EXPONENT},
               {k->w1, 2},
               {k->v, 2},
               {k->constants, MAX_CONSTANTS},
               {k->scale, MAX_STATES},
               {&k->greatest, 1},
               {&k->to, 1},
               {&k->next, 1},
               {k->first, MAX_STATES},
               {k->last, MAX_STATES},
               {k->series, MAX_STATES * TERMS},
               {k->anchor[0][0], 2 * 5 * 3},
               {k->turn, 2}};
  for (size_t j = 0; j < sizeof parts / sizeof *parts; j++)
    if (!all_finite(parts[j].first, parts[j].count)) return "the motion of a contact is not finite";
  return NULL;
}

const char *read_state(const unsigned char *bytes, unsigned long long count, memory_t *memory) {
  header_t found;
  if (count != STATE_BYTES) return "its length is not that of this model's states";
  memcpy(&found, bytes, sizeof found);
  memcpy(memory, bytes + sizeof found, sizeof *memory);
  const header_t right = header_for(memory);
  if (memcmp(found.magic, right.magic, sizeof found.magic))
    return "it is not a state of a contact model";
  if (found.version != right.version) return "it was written by another version";
  if (found.length != right.length) return "its header gives another length";
  if (found.model != right.model) return "it belongs to another model";
  if (found.checksum != right.checksum) return "its checksum does not match; it has been changed";
  const char *wrong = check_memory(memory);
  for (long i = 0; i < N_CONTACTS && !wrong; i++) wrong = check_contact(memory, i);
  return wrong;
}
