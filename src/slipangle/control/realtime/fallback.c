/* Where given inputs lead: what a fallback predicts, at the cost of two linearisations. */

#define SWEEPS 2
#define COARSE 1e-3 /* accuracy of the integrator's stages in the first sweep */
#define NEAR 1e-4 /* a sweep that moves no state by more, relative to 1 + |x|, leaves about the square of it */

/* Inputs within limits and rates, and states from x0 on: Newton's method on all steps side by side, from the states
   that s->x holds. As many sweeps as time allows, at least one; 0 where the states leave the finite numbers. */
int rt_follow(Work *s)
{
    double until = now() + s->time_limit, exact = s->newton;
    keep_inputs(s);
    memset(s->k, 0, sizeof s->k);
    for (int sweep = 0; sweep < SWEEPS; sweep++) {
        s->newton = sweep ? exact : fmax(exact, COARSE);
        for (int i = 0; i < NS; i += LANES)
            evaluate_dynamics(s, i, LANES);
        s->newton = exact;
        double most = 0;
        for (int a = 0; a < NX; a++)
            s->dx[a] = s->x0[a] - s->x[a];
        for (int m = 0; m < NS; m++) {
            const double *A = s->A + m * NX * NX, *dx = s->dx + m * NX;
            for (int a = 0; a < NX; a++) {
                double v = s->next[m * NX + a] - s->x[(m + 1) * NX + a];
                for (int c = A_FIRST[a]; c < A_FIRST[a + 1]; c++)
                    v += A[a * NX + A_AT[c]] * dx[A_AT[c]];
                s->dx[(m + 1) * NX + a] = v;
            }
        }
        if (!all_finite(s->dx, (NS + 1) * NX))
            return 0;
        for (int i = 0; i < (NS + 1) * NX; i++) {
            s->x[i] += s->dx[i];
            most = fmax(most, fabs(s->dx[i]) / (1 + fabs(s->x[i])));
        }
        if ((sweep && most <= NEAR) || now() > until)
            break;
    }
    return 1;
}
