/* Memory of riccati.c, bends.c, rows.c and interior.c. */

#define FEW 6 /* remembered steps; with more the program is condensed */
#define RZ (NX + NV)
#define ZW (NX + NU)
#define ZV ((ZW + LANES - 1) / LANES)
#define ZL (ZV * LANES)
#define AT(row) ((row) * ZV)
#define SIDES ((2 * QT + LANES - 1) / LANES)
#define COLUMNS (2 * FEW)
typedef struct { /* curvature that is remembered, as a sum of products, and what the factor makes of them */
    double y[COLUMNS * QL], weight[COLUMNS], factor[COLUMNS * COLUMNS];
    double dv[COLUMNS * QN], e_by[M1(COLUMNS * (N + 1) * NE)], value_by[COLUMNS * QT];
    int count;
} Bends;
typedef struct {
    V Z[N * RZ * ZV], T[N * ZW * ZV];                /* derivatives of the next state, and these by column */
    V E[M1((N + 1) * NE * ZV)], L[M1(N_LIMITS * ZV)]; /* of errors and limited quantities */
    V S[N * NU * ZV], x[(N + 1) * ZV];               /* factor: of inputs by states; where the states move */
    V unit[(NU + 1) * ZV];                           /* 1 in the place of each input, and of the state */
    V limit[SIDES], turn[SIDES], used[SIDES], soft[SIDES], plain[SIDES], square[SIDES]; /* sides of rows */
    V distance[SIDES], price_of[SIDES], excess[SIDES], of_excess[SIDES], at[SIDES], moved[SIDES];
    V by_distance[SIDES], by_price[SIDES], by_excess[SIDES], by_of_excess[SIDES];
    V gap[SIDES], miss[SIDES], over_excess[SIDES], per_price[SIDES], over_distance[SIDES];
    V still_excess[SIDES], still_price[SIDES];
    double R[N * NU * NU]; /* factor: of inputs by inputs */
    double slope[QT], wanted[QT], stiff[QT], price[QT], after[QT], value[QT], value_by[QT], sign[QT], off[QT];
    double damped[QN];  /* curvature beside the problem's own, as steps of inputs are damped */
    double v[QN], dv[QN], bent[QN], forces[QN], e[M1((N + 1) * NE)], e_by[M1((N + 1) * NE)];
    double top;
    Bends bends;
    int first[N + 2], rate[QN], row[QT], mode[QT], better[QT], coming[QT], how[QT], of[2 * QT];
    int rows, expected, sides, side_vectors, fell; /* fell: the input at which there was no factor */
} Stages;
