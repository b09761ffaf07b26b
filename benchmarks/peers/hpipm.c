/* HPIPM, as CasADi ships it, on programs of one size: given new matrices and vectors of all stages, solved. */
#include <stdlib.h>
#include <string.h>
#include "hpipm_d_ocp_qp.h"
#include "hpipm_d_ocp_qp_dim.h"
#include "hpipm_d_ocp_qp_ipm.h"
#include "hpipm_d_ocp_qp_sol.h"
#include "hpipm_d_part_cond.h"

typedef struct {
    struct d_ocp_qp_dim dim, few;
    struct d_ocp_qp qp, qp_few;
    struct d_ocp_qp_sol sol, sol_few;
    struct d_ocp_qp_ipm_arg arg;
    struct d_ocp_qp_ipm_ws ws;
    struct d_part_cond_qp_arg cond_arg;
    struct d_part_cond_qp_ws cond_ws;
    int n, n2, nu, *nx, *ng, *ns;
} Peer;

/* For n stages, joined into n2; all limits are those of inputs and general ones, of which `soft` are the soft ones. */
void *hpipm_begin(int n, int n2, int nu, int *nx, int *ng, int *ns, int *soft, double tolerance)
{
    Peer *p = calloc(1, sizeof *p);
    p->n = n, p->n2 = n2, p->nu = nu;
    size_t size = sizeof(int) * (size_t)(n + 1);
    p->nx = malloc(size), p->ng = malloc(size), p->ns = malloc(size);
    memcpy(p->nx, nx, size), memcpy(p->ng, ng, size), memcpy(p->ns, ns, size);
    d_ocp_qp_dim_create(n, &p->dim, malloc(d_ocp_qp_dim_memsize(n)));
    for (int i = 0; i <= n; i++) {
        d_ocp_qp_dim_set_nx(i, nx[i], &p->dim);
        d_ocp_qp_dim_set_nu(i, i < n ? nu : 0, &p->dim);
        d_ocp_qp_dim_set_nbu(i, i < n ? nu : 0, &p->dim);
        d_ocp_qp_dim_set_ng(i, ng[i], &p->dim);
        d_ocp_qp_dim_set_ns(i, ns[i], &p->dim);
    }
    d_ocp_qp_create(&p->dim, &p->qp, malloc(d_ocp_qp_memsize(&p->dim)));
    d_ocp_qp_sol_create(&p->dim, &p->sol, malloc(d_ocp_qp_sol_memsize(&p->dim)));
    for (int i = 0, at = 0; i <= n; at += ns[i++]) {
        int of[64];
        for (int j = 0; j < nu; j++)
            of[j] = j;
        if (i < n)
            d_ocp_qp_set_idxbu(i, of, &p->qp);
        for (int j = 0; j < ns[i]; j++)
            of[j] = (i < n ? nu : 0) + soft[at + j];
        d_ocp_qp_set_idxs(i, of, &p->qp);
    }
    struct d_ocp_qp_dim *dim = &p->dim;
    if (n2 < n) {
        int *blocks = malloc(sizeof(int) * (size_t)(n2 + 1));
        d_part_cond_qp_compute_block_size(n, n2, blocks);
        d_ocp_qp_dim_create(n2, &p->few, malloc(d_ocp_qp_dim_memsize(n2)));
        d_part_cond_qp_compute_dim(&p->dim, blocks, &p->few);
        d_part_cond_qp_arg_create(n2, &p->cond_arg, malloc(d_part_cond_qp_arg_memsize(n2)));
        d_part_cond_qp_arg_set_default(&p->cond_arg);
        d_part_cond_qp_arg_set_ric_alg(0, &p->cond_arg);
        d_ocp_qp_create(&p->few, &p->qp_few, malloc(d_ocp_qp_memsize(&p->few)));
        d_ocp_qp_sol_create(&p->few, &p->sol_few, malloc(d_ocp_qp_sol_memsize(&p->few)));
        d_part_cond_qp_ws_create(&p->dim, blocks, &p->few, &p->cond_arg, &p->cond_ws,
                                 malloc(d_part_cond_qp_ws_memsize(&p->dim, blocks, &p->few, &p->cond_arg)));
        dim = &p->few;
    }
    d_ocp_qp_ipm_arg_create(dim, &p->arg, malloc(d_ocp_qp_ipm_arg_memsize(dim)));
    d_ocp_qp_ipm_arg_set_default(SPEED, &p->arg);
    int most = 100;
    d_ocp_qp_ipm_arg_set("iter_max", &most, &p->arg);
    d_ocp_qp_ipm_arg_set("tol_stat", &tolerance, &p->arg);
    d_ocp_qp_ipm_arg_set("tol_eq", &tolerance, &p->arg);
    d_ocp_qp_ipm_arg_set("tol_ineq", &tolerance, &p->arg);
    d_ocp_qp_ipm_arg_set("tol_comp", &tolerance, &p->arg);
    d_ocp_qp_ipm_ws_create(dim, &p->arg, &p->ws, malloc(d_ocp_qp_ipm_ws_memsize(dim, &p->arg)));
    return p;
}

static double *next(double **data, int count)
{
    double *at = *data;
    *data += count;
    return at;
}

/* Matrices by column, all stages one behind the other; u: the inputs of all. The solver's status, 0 for an answer. */
int hpipm_solve(void *peer, double *data, double *u)
{
    Peer *p = peer;
    struct d_ocp_qp *qp = &p->qp;
    for (int i = 0; i <= p->n; i++) {
        int nx = p->nx[i], nu = i < p->n ? p->nu : 0, ng = p->ng[i], ns = p->ns[i];
        if (i < p->n) {
            int later = p->nx[i + 1];
            d_ocp_qp_set_A(i, next(&data, later * nx), qp);
            d_ocp_qp_set_B(i, next(&data, later * nu), qp);
            d_ocp_qp_set_b(i, next(&data, later), qp);
        }
        d_ocp_qp_set_Q(i, next(&data, nx * nx), qp);
        d_ocp_qp_set_S(i, next(&data, nu * nx), qp);
        d_ocp_qp_set_R(i, next(&data, nu * nu), qp);
        d_ocp_qp_set_q(i, next(&data, nx), qp);
        d_ocp_qp_set_r(i, next(&data, nu), qp);
        d_ocp_qp_set_lbu(i, next(&data, nu), qp);
        d_ocp_qp_set_ubu(i, next(&data, nu), qp);
        d_ocp_qp_set_C(i, next(&data, ng * nx), qp);
        d_ocp_qp_set_D(i, next(&data, ng * nu), qp);
        d_ocp_qp_set_lg(i, next(&data, ng), qp);
        d_ocp_qp_set_ug(i, next(&data, ng), qp);
        double *square = next(&data, ns), *plain = next(&data, ns), none[64] = {0};
        d_ocp_qp_set_Zl(i, square, qp);
        d_ocp_qp_set_Zu(i, square, qp);
        d_ocp_qp_set_zl(i, plain, qp);
        d_ocp_qp_set_zu(i, plain, qp);
        d_ocp_qp_set_lls(i, none, qp);
        d_ocp_qp_set_lus(i, none, qp);
    }
    if (p->n2 < p->n) {
        d_part_cond_qp_cond(qp, &p->qp_few, &p->cond_arg, &p->cond_ws);
        d_ocp_qp_ipm_solve(&p->qp_few, &p->sol_few, &p->arg, &p->ws);
        d_part_cond_qp_expand_sol(qp, &p->sol_few, &p->sol, &p->cond_arg, &p->cond_ws);
    } else
        d_ocp_qp_ipm_solve(qp, &p->sol, &p->arg, &p->ws);
    for (int i = 0; i < p->n; i++)
        d_ocp_qp_sol_get_u(i, &p->sol, u + i * p->nu);
    int status;
    d_ocp_qp_ipm_get("status", &p->ws, &status);
    return status;
}
