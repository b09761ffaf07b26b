/* Gauss-Newton method on one optimal control problem: linearise all stages at once, condense, solve, expand.

   The generated part before this file defines the sizes N, NX, NU, NW, NP, NE (tracked), NL (limited), NK (stage
   slopes of the integrator), the weights and patterns, `evaluate_dynamics` and `evaluate_stage`. Inputs are counted in
   units of SCALE inside the quadratic program. Costs are half of the problem's. */

enum { SOLVED, ITERATED, ITERATION_LIMIT, STALLED, TIME_OUT, INFEASIBLE, NOT_FINITE, FAILED };
enum { CONTINUE, FROM_NOTHING, GIVEN, GIVEN_INPUTS };

#define PAIRS 24 /* remembered steps and changes of the gradient */

typedef struct {
    /* what Python sets */
    double x0[NX], applied[NU], w[M1(N * NW)], p[M1((N + 1) * NP)], r[N * NU], bounds[M1((N + 1) * NL * 2)];
    double q[M1((N + 1) * NE)], wr[N * NU], ws[N * NU], plain[M1(NL)], square[M1(NL)]; /* weights */
    double tolerance, time_limit, newton;
    int64_t max_iterations, fixed, fresh;
    /* the iterate and what Python reads, u to residual as one block */
    double u[N * NU], x[(N + 1) * NX], k[M1(N * NK)], cost, violation, residual;
    double step, seconds, seconds_prepare, seconds_feedback;
    int64_t iterations, qp_iterations;
    /* linearisation */
    double A[N * NX * NX], B[N * NX * NU], E[M1((N + 1) * NE * NX)], D[M1((N + 1) * NE * NU)];
    double LX[M1((N + 1) * NL * NX)], LU[M1((N + 1) * NL * NU)];
    double next[N * NX], e[M1((N + 1) * NE)], l[M1((N + 1) * NL)];
    /* step */
    double dx[(N + 1) * NX], pi[(N + 1) * NX], du[N * NU];
    double u_from[N * NU], x_from[(N + 1) * NX], k_from[M1(N * NK)], penalty[(N + 1) * NX], hard_penalty;
    double pair_s[PAIRS * QL], pair_y[PAIRS * QL], g_from[QL], product[QL];
    int64_t pairs, open_end; /* open_end: the last state is where the last step ends */
    V G[2 * NX * QL / LANES], R[QL / LANES];
    double begin;
    Qp qp;
    Scratch scratch;
} Work;

