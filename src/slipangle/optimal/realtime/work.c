/* Gauss-Newton method on one optimal control problem: linearise all stages at once, condense, solve, expand.

   The generated part before this file defines the sizes N (stages), NS (steps of the model), NX, NU, NW, NP, NE
   (tracked), NL (limited), NK (stage slopes of the integrator), the weights and patterns, `evaluate_dynamics` and
   `evaluate_stage`. A stage is one or more steps of the model with the input held; the states after each are nodes, so
   all steps are linearised side by side however long the stages are. Inputs are counted in units of SCALE inside the
   quadratic program. Costs are half of the problem's. */

#if NS == N
#define NODE(i) (i)      /* at which stage i begins */
#define STAGE_OF(m) (m)  /* of the step of the model from node m */
#else
#define NODE(i) NODES[i]
#define STAGE_OF(m) STAGES[m]
#endif

/* Whether one of eight lanes is to spare behind the last step, for one more; where there are fewer lanes and none is,
   that has a group of its own, so that plans do not hang on the width of vectors. */
#define SPARE (NS % 8 != 0)

/* Whether a plan is linearised where it is found, for the next one to start with: the first step, which that has left
   behind, goes into the spare lane. */
#define AHEAD (NS == N && N > 1 && JUMPS == 0 && (DYNAMICS == CALLED || SPARE))

enum { SOLVED, ITERATED, ITERATION_LIMIT, STALLED, TIME_OUT, INFEASIBLE, NOT_FINITE, FAILED, DOUBTFUL };
enum { CONTINUE, FROM_NOTHING, GIVEN, GIVEN_INPUTS, RESUME, RETRY, HANDED_OVER };
enum { LINEARISE, CONDENSE, BY_STAGES, PARTS };

#define PAIRS 24 /* remembered steps and changes of the gradient */
#define CALM 2   /* iterations without a short step before remembered ones count; short: a quarter of one beyond FAR */
#define FLAT 1e-6 /* largest change of an input in units of its range whose effect on the cost may be lost in rounding */
#define IDLE 10  /* such steps that are no smaller than the smallest before end the iterations */
#define BY_ROUNDING 1e-12 /* largest change of an input that may be rounding alone, where it stays at its bound */
#define ROUNDED 1e-8 /* largest change of an input by a whole step, before one that rounding makes useless */
#define PRICES 1e4 /* largest price of a hard limit that no step keeps, over the first */
#define SETTLED 1e-5 /* largest change of an input in units of its range after which missed limits may get a higher price */
#define STAYS 0.9 /* share of an excess over hard limits that a step leaves where nothing brings it down */
#define STAYED 10 /* such steps in a row, at the highest price, after which limits have no answer here */
#define STRAINED 10 /* multiplier of a hard limit over a price that was paid, beyond which steps pay that rather than keep it */
#define GAIN 0.25 /* share of what a whole step promised that it must bring, where limits have a price, to be damped less */
#define PATIENCE 40 /* iterations at one price, or no nearer to limits that have none, after which they get a higher one */
#define FAR 0.05 /* largest change of an input in units of its range; below, remembered steps are what helps */
#define FROM 0.3 /* `from` where stage slopes have been moved to where the step begins: a correction of 2e-4 is the last one */
#define FAR_ALONG 3e-2 /* in units of the state: derivatives of stage slopes lead them no further well enough */
#define NEARBY 0.02 /* largest difference of the state from the one predicted, in `units`, with which derivatives stay */
#define FEW_STEPS 5 /* whole ones, after which a plan may still be far from where they began */
#define DEARER 1e-6 /* of its cost, by which a plan is dearer than what it began with */
#define FEASIBLE 1e-6 /* an unfinished answer with no larger violation of a constraint is still a plan */
#define CONTENT 10 /* iterations with a line search, of real-time ones, after which a plan will do that keeps all constraints */
#define NO_NEARER 8 /* such in a row that bring constraints no nearer, after which they had better fall back */
#define NO_NEARER_PAID 5 /* the same where no step keeps the limits */
#define GENTLE 0.1 /* most that the first step of such a start changes an input; a whole one lets the next go twice as far ... */
#define FREE 4 /* ... and from here on as far as it likes */
#define RETRIES 5 /* solves in a row after which one looks everywhere, as what was in the way may be gone */
#define MORE 30 /* most of them, where full steps were not enough */

typedef struct {
    /* what Python sets */
    double x0[NX], applied[NU], w[M1((N + 1) * NW)], p[M1((N + 1) * NP)], r[N * NU], corridor[(N + 1) * 2];
    double bounds[M1((N + 1) * NL * 2)];
    double q[M1((N + 1) * NE)], wr[N * NU], ws[N * NU], plain[M1(N_LIMITS)], square[M1(N_LIMITS)]; /* weights */
    double lowest[NX + NP + NW], highest[NX + NP + NW]; /* of x0, p and w that can be true */
    double safe[NU], relaxing[N]; /* of the stop law: where it goes, and how much is left of the way at each stage */
    double way_u[N * NU], way_x[(N + 1) * NX]; /* of a fallback, as one block: what it follows, then what it is */
    double tolerance, time_limit, newton, accept;
    int64_t max_iterations, fixed, fresh, misses; /* misses: fallbacks in a row before the last one, which was by missed limits */
    /* the iterate and what Python reads, u to residual as one block */
    double u[N * NU], x[(NS + 1) * NX], k[M1((NS + 1) * NK)], working[1 + 2 * QT], cost, violation, residual;
    double step, seconds, seconds_prepare, seconds_feedback;
    int64_t iterations, qp_iterations, by_stages; /* by_stages: how the last quadratic program was solved */
    int64_t anew; /* whether the solve led nowhere at first, and began anew */
    /* linearisation */
    double A[NS * NX * NX], B[NS * NX * NU], E[M1((N + 1) * NE * NX)], D[M1((N + 1) * NE * NU)];
    double LX[M1((N + 1) * NL * NX)], LU[M1((N + 1) * NL * NU)];
    double next[(NS + 1) * NX], e[M1((N + 1) * NE)], l[M1((N + 1) * NL)];
    double e_after[M1((N + 1) * NE)], l_after[M1(N_LIMITS)], bend; /* of the linear model after the step */
    /* step */
    double dx[(NS + 1) * NX], pi[(NS + 1) * NX], du[N * NU], u_later[N * NU];
    double u_from[N * NU], x_from[(NS + 1) * NX], k_from[M1((NS + 1) * NK)], penalty[(NS + 1) * NX], hard_penalty;
    double pair_s[PAIRS * QL], pair_y[PAIRS * QL], g_from[QL], product[QL];
    int64_t pairs, open_end; /* open_end: the last state is where the last step ends */
    /* what next, A and B belong to after `look_ahead`, and the stage slopes that were found there */
    double ahead_x[NS * NX], ahead_u[N * NU], ahead_w[M1(N * NW)], ahead_k[M1(NS * NK)], ahead_slopes[M1(NS * NK)];
    int64_t ahead, spared; /* whether that is so; groups of columns that the last linearisation took from there */
    V G[2 * NX * QL / LANES], R[2 * M1(NE) * QL / LANES];
    int64_t curved; /* whether there are multipliers for the curvature beyond squares of errors */
    double turn[M1(TURNS)]; /* of the rows of this curvature, 1 or, where it is negative, -1 */
    int64_t saddle, tried;  /* whether a step is to be, or was, one with all of it; whether that was tried */
    int64_t failed, rest;   /* how often in a row that led nowhere; steps until it is tried again */
    double falls_u[M1(SADDLE * N * NU)], falls_x[M1(SADDLE * (NS + 1) * NX)]; /* of saddle.c: where the cost falls */
    int64_t shortened; /* whether a step of a solve to convergence was */
    /* the inputs that it begins with, and the plan that another start leaves for a cheaper one */
    double begun_u[N * NU], left_u[N * NU], left_x[(NS + 1) * NX], left_k[M1((NS + 1) * NK)];
    double left_working[1 + 2 * QT], left_numbers[3];
    double damp; /* of inputs, relative to the curvature */
    double reach; /* most that a step may change an input, in units of its range, where whole ones led astray */
    double top;  /* largest curvature by an input, of the program condensed */
    double own[N * NU], blur; /* that by each, and what was added to it so that there is a factor */
    int64_t unstable; /* whether that blurs the optimum, as states that grow much do: it is not condensed any more */
    int64_t astray; /* whether a step of this solve, by stages, goes so far without its inputs that few digits are left */
    int64_t frail; /* whether the last program was condensed with few digits */
    int64_t hands_over; /* as Python says: whether steps that contract slowly end here, as others go on from there */
    double from; /* size of the step before the first of the integrator's, as far as is known */
    double took[PARTS], since; /* time of parts of an iteration, when one began */
    Qp qp;
    Stages stages; /* of riccati.c */
    Scratch scratch;
} Work;

