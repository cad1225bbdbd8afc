/* Finds singular points of users' charts on a path.

   Integration goes on through a point where |f_u| or |f_v| is 0, as the equations are smooth there.
   But the normal f_u x f_v changes its sign, and is compared from place to place. */

/* dot product of unit normals at neighbouring places, below which one has changed its sign; they
   may differ by 45 degrees besides */
static const double TURNED_OVER = -0.7;
/* Part of a panel within which the normal of no surface turns so far. Shorter parts are not looked
   at: beside an edge where f_u and f_v align, normals there are only rounding, and may seem to turn
   smoothly. */
static const double SHARPEST = 1e-4;

/* Normals at places xi of a panel, and u v theta there */
static void normals(work_t *w, const track_t *k, int64_t panel, const double *xi, lanes_t place,
                    double (*out)[3]) {
  series_at(k->panels.series + panel * k->panels.rows * TERMS, 3, xi, place);
  lanes_t p = run(table_at(w, k, C_FRAME, place)) + 3, q = p + 3;
  for (int i = 0; i < L; i++)
    for (int j = 0; j < 3; j++) {
      const int a = (j + 1) % 3, c = (j + 2) % 3;
      out[i][j] = p[a][i] * q[c][i] - p[c][i] * q[a][i];
    }
}

/* Fails where the normal changes its sign, or does not exist, on a part of a panel. Where it turns
   far between two of L places, the part between is checked too, as it may turn smoothly. before:
   the normal where the part begins, then where it ends */
static void check_part(work_t *w, const track_t *k, int64_t panel, double low, double high,
                       double *before) {
  double n[L][3], place[3][L], xi[L];
  for (int i = 0; i < L; i++) xi[i] = low + (high - low) / (L - 1) * i;
  xi[L - 1] = high; /* to the last bit, as it is a place of the whole too */
  normals(w, k, panel, xi, place, n);
  for (int i = 0; i < L; i++) {
    const double turned = n[i][0] * before[0] + n[i][1] * before[1] + n[i][2] * before[2];
    if (!(turned > TURNED_OVER)) {
      if (i == 0 || high - low < SHARPEST) {
        failure_t *e = w->failure;
        e->side = k->body->side, e->u = place[0][i], e->v = place[1][i];
        fail(w, SINGULAR_CHART);
      }
      check_part(w, k, panel, xi[i - 1], xi[i], before);
    }
    memcpy(before, n[i], sizeof n[i]);
  }
}

static void require_regular(work_t *w, const track_t *k) {
  double before[3] = {0.0};
  if (k->in_space || !k->body->surface->may_be_singular) return;
  for (int64_t p = 0; p < k->panels.n; p++) check_part(w, k, p, -1.0, 1.0, before);
}
