/* Memory of riccati.c. */

#define SIDES ((2 * QT + LANES - 1) / LANES)
typedef struct {
    V S[N * NU * ((NX + NV + LANES - 1) / LANES)]; /* factor: of inputs by states, and of inputs */
    V limit[SIDES], turn[SIDES], used[SIDES], soft[SIDES], plain[SIDES], square[SIDES]; /* sides of rows */
    V distance[SIDES], price_of[SIDES], excess[SIDES], of_excess[SIDES], at[SIDES], moved[SIDES];
    V by_distance[SIDES], by_price[SIDES], by_excess[SIDES], by_of_excess[SIDES];
    V gap[SIDES], miss[SIDES], over_excess[SIDES], per_price[SIDES], over_distance[SIDES];
    V still_excess[SIDES], still_price[SIDES];
    double R[N * NU * NU];
    double A[M1(JOINED * NX * NX)], B[M1(JOINED * NX * NU)]; /* of stages of several steps */
    double slope[QT], wanted[QT], stiff[QT], price[QT], after[QT], value[QT], value_by[QT], sign[QT], off[QT];
    double v[QN], dv[QN], bent[QN], forces[QN], r[QN], dx[(N + 1) * NX], e[M1((N + 1) * NE)], e_by[M1((N + 1) * NE)];
    double top;
    int first[N + 2], rate[QN], row[QT], mode[QT], coming[QT], how[QT], of[2 * QT];
    int rows, expected, sides, side_vectors;
} Stages;
