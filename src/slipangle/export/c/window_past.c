/* A window of samples, of a moving horizon estimator: what is kept of them. */

typedef struct {
    double u[NU], before[NU], y[NY], seen[NY];
} Row;

typedef struct {
    double mean[NZ], P[NZ * NZ]; /* estimate before the window */
    Row rows[HORIZON + 2];
    double found[HORIZON + 2][NZ], priors[HORIZON + 1][NZ * NZ]; /* states; their covariances before each was taken in */
} Window;

typedef struct {
    car_window *solver;
    Window window, spare;
    int64_t failures; /* windows without a solution */
} Past;
