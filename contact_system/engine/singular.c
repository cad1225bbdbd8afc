/* Singular points of charts that nobody knows to be regular.

   A path goes through one where |f_u| or |f_v| falls to 0: the equations are smooth there, and the
   contact frame turns over. It is looked for between places in equal parts of the panels. */

enum { SEARCH = L }; /* parts of a panel between which a search looks */

/* The least of |f_u| and |f_v| at places xi of a panel */
static void regularity(work_t *w, int side, const body_t *b, const track_t *k, int64_t panel,
                       const double *xi, lanes_t place, double *out) {
  unit_t *u = table_of(w, side, 0, C_LAME, b);
  series_at(k->panels.series + panel * k->panels.rows * TERMS, 3, xi, place);
  copy_rows(u->r, place, 3);
  copy_lanes(out, run(u)[2]);
}

/* Fails where the regularity falls to 0 between two times, beside the least of three places: by
   thirds of the bracket, as long as the slope lets it. fall: how far it may fall there. */
static void search_bracket(work_t *w, int side, const body_t *b, const track_t *k, double low,
                           double high, double fall) {
  const double lost = 1e-12 * b->size;
  for (int i = 0; i < 100 && low < high; i++) {
    const double tried[2] = {(2 * low + high) / 3, (low + 2 * high) / 3};
    double found[2];
    for (int q = 0; q < 2; q++) {
      const int64_t p = interval(k->panels.edges, k->panels.n, tried[q], 0);
      const double from = k->panels.edges[p], to = k->panels.edges[p + 1];
      double xi[L], place[3][L], least[L];
      fill_lanes(xi, 2.0 * (tried[q] - from) / (to - from) - 1.0);
      regularity(w, side, b, k, p, xi, place, least);
      found[q] = least[0];
      if (!(least[0] <= lost)) continue;
      failure_t *e = w->failure;
      e->side = side, e->u = place[0][0], e->v = place[1][0];
      fail(w, SINGULAR_CHART);
    }
    if (found[0] <= found[1])
      high = tried[1];
    else
      low = tried[0];
    fall *= 2.0 / 3.0; /* what is left of a bracket lies this near to the better of the two */
    if (fmin(found[0], found[1]) > fall) return;
  }
}

static void require_regular(work_t *w, int side, const body_t *b, const track_t *k) {
  if (k->ambient || !(b->surface->flags & MAY_BE_SINGULAR)) return;
  /* two places before the one that is looked at: the last of the panel before */
  double at[3] = {0}, least[3] = {0}, place[3][L], xi[L];
  for (int64_t p = 0; p < k->panels.n; p++) {
    const double from = k->panels.edges[p], span = k->panels.edges[p + 1] - from;
    const double part = 2.0 / SEARCH;
    const int first = p == 0, last = p + 1 == k->panels.n;
    /* places -1, 0, ..., SEARCH - 1 of a panel; SEARCH and SEARCH + 1 of the last */
    for (int q = 0; q < L; q++) xi[q] = -1.0 + part * q;
    double inner[L], ends[L], beside[L];
    regularity(w, side, b, k, p, xi, place, inner);
    for (int q = 0; q < L; q++)
      beside[q] = -1.0 + part * (q == 0 ? -1 : q == 1 ? SEARCH : SEARCH + 1);
    regularity(w, side, b, k, p, beside, place, ends);
    if (first) at[0] = from - span / SEARCH, least[0] = ends[0], at[1] = from, least[1] = inner[0];
    for (int q = first; q < SEARCH + 2 * last; q++) {
      at[2] = from + span * q / SEARCH, least[2] = q < SEARCH ? inner[q] : ends[q - SEARCH + 1];
      const double step[2] = {at[1] - at[0], at[2] - at[1]};
      const double slope = fmax((least[0] - least[1]) / step[0], (least[2] - least[1]) / step[1]);
      const int lowest = least[1] <= fmin(least[0], least[2]);
      if (lowest && least[1] <= 2.0 / 3.0 * fmax(step[0], step[1]) * slope) {
        const double end = k->panels.edges[k->panels.n];
        search_bracket(w, side, b, k, fmax(at[0], 0.0), fmin(at[2], end), slope * (at[2] - at[0]));
      }
      at[0] = at[1], least[0] = least[1], at[1] = at[2], least[1] = least[2];
    }
  }
}
