/* Long: steps of the model and errors of the stages, each beside its derivatives. */
/* Next state of all steps of the model and errors of all stages with their derivatives, LANES columns at a time. */

INLINE int column(int first, int count, int lane, int last)
{
    int i = first + (lane < count ? lane : count - 1);
    return i < last ? i : last;
}

#define GATHER(name, place)                                                                       \
    static void name(V *to, const double *from, int width, int first, int count, int last)        \
    {                                                                                             \
        for (int lane = 0; lane < LANES; lane++) {                                                \
            const double *at = from + place(column(first, count, lane, last)) * width;            \
            for (int a = 0; a < width; a++)                                                       \
                v_lane(to[a], lane) = at[a];                                                              \
        }                                                                                         \
    }
GATHER(gather, )
#if NS == N
#define gather_held gather
#define gather_nodes gather
#else
GATHER(gather_held, STAGE_OF) /* what is held over a stage, for each of its steps */
GATHER(gather_nodes, NODE)    /* states at which stages begin, and the last */
#endif

static void scatter(const V *from, double *to, int width, int first, int count, int last)
{
    for (int lane = 0; lane < count && first + lane <= last; lane++) {
        double *at = to + (first + lane) * width;
        for (int a = 0; a < width; a++)
            at[a] = v_lane(from[a], lane);
    }
}

/* A function of CasADi's own code on `in` and `out`; it keeps pointers of its own behind these. */
#define CALL(function) \
    (memcpy(c->in, in, sizeof in), memcpy(c->out, out, sizeof out), function(c->in, c->out, c->iw, c->work, 0))

#if DYNAMICS == RADAU

/* Newton's matrix is that of the increments z = H k of the states from the beginning of the step to its stages, H its
   coefficients times its length, as between two states it has only diagonals there; G is the inverse of H.

   Place of the derivative of an increment by a core state or an input: those of one lie side by side and are solved for
   together, as each solution alone waits for its own sums. */
#define MOVED(i, by) ((i) * (NC + NU) + (by))

/* Sums of H or G with the numbers of each state's stages. */
INLINE void times_stages(const double *H, const V *from, V *to)
{
    for (int a = 0; a < 3 * NC; a += 3) {
        V k0 = from[a], k1 = from[a + 1], k2 = from[a + 2];
        for (int j = 0; j < 3; j++)
            to[a + j] = H[3 * j] * k0 + H[3 * j + 1] * k1 + H[3 * j + 2] * k2;
    }
}

/* Core states at the stage j of a step; the last stage is its end. */
INLINE void stage_states(const Scratch *c, int j, V *to)
{
    for (int a = 0; a < NC; a++)
        to[CORE[a]] = c->x[CORE[a]] + c->z[3 * a + j];
}

/* Stage slopes that carry the fast states to where they settle: short, growing, linearly implicit Euler steps. */
static void settle_fast_states(Scratch *c, I which)
{
    V y[NX], m[NC * NC], b[NC];
    for (int a = 0; a < NX; a++)
        y[a] = c->x[a];
    for (double h = 1e-3 * STEP; h < 0.3 * STEP; h *= 1.6) {
        core(y, c->u, c->w, c->f, c->fx, c->fu);
        for (int i = 0; i < NC; i++) {
            b[i] = h * c->f[i];
            for (int j = 0; j < NC; j++)
                m[i * NC + j] = (i == j ? 1.0 : 0.0) - h * c->fx[i * NC + j];
        }
        for (int k = 0; k < NC; k++)
            for (int i = k + 1; i < NC; i++) {
                V f = m[i * NC + k] / m[k * NC + k];
                for (int j = k; j < NC; j++)
                    m[i * NC + j] -= f * m[k * NC + j];
                b[i] -= f * b[k];
            }
        for (int i = NC - 1; i >= 0; i--) {
            for (int j = i + 1; j < NC; j++)
                b[i] -= m[i * NC + j] * b[j];
            b[i] /= m[i * NC + i];
            y[CORE[i]] += b[i];
        }
    }
    for (int i = 0; i < NK; i++) {
        V slope = RADAU_REST[i % 3] * (y[CORE[i / 3]] - c->x[CORE[i / 3]]);
        c->k[i] = v_pick(which & (slope == slope), slope, v_pick(which, v_all(0.0), c->k[i]));
    }
}

/* Stage slopes k of one step of Radau IIA by exact Newton steps; columns that
   find none stay marked in `moving`. A step is the last one where it, or what its shrinking promises of the next, is
   within the tolerance; the first counts as shrunk from `from`, zero if nothing is known of where k is. */
INLINE void find_stages(Scratch *c, const double *H, const double *G, double step, double tolerance, double from, int settle,
                        I *moving)
{
    V at[NX], unit[NC], before = v_all(INFINITY), last = v_all(from), t = v_all(1.0);
    for (int a = 0; a < NX; a++)
        at[a] = c->x[a];
    for (int a = 0; a < NC; a++)
        unit[a] = step / (1.0 + v_fabs(c->x[CORE[a]]));
    for (int round = 0;; round++) {
        times_stages(H, c->k, c->z);
        for (int j = 0; j < 3; j++) {
            stage_states(c, j, at);
            core(at, c->u, c->w, c->f + j * NC, c->fx + j * NC * NC, c->fu + j * NC * NU);
        }
        newton_matrix(c->fx, G, c->m);
        for (int a = 0; a < NC; a++)
            for (int j = 0; j < 3; j++)
                c->d[3 * a + j] = c->k[3 * a + j] - c->f[j * NC + a];
        V size = {0}, most = {0};
        for (int i = 0; i < NK; i++) {
            V r = unit[i / 3] * c->d[i];
            size += r * r;
        }
        /* wheels past the peak of their tire throw a full step too far: halve it until the residual falls */
        I worse = v_unless(size <= before) & v_unless(size <= tolerance * tolerance) & (t > 1e-4);
        V of_size = before, of_step = last, of_t = t;
        newton_factor(c->m);
        newton_solve(c->m, c->d);
        times_stages(G, c->d, c->d);
        for (int i = 0; i < NK; i++)
            most += v_fabs(unit[i / 3] * c->d[i]);
        *moving = worse | v_unless((most <= tolerance) | (most * most <= tolerance * (last - most)));
        t = v_pick(worse, 0.5 * t, v_all(1.0));
        before = v_pick(worse, before, size);
        last = v_pick(worse, v_all(0.0), most);
        for (int i = 0; i < NK; i++) {
            c->kept[i] = v_pick(worse, c->kept[i], c->k[i]);
            c->way[i] = v_pick(worse, c->way[i], c->d[i]);
            c->k[i] = c->kept[i] - t * c->way[i];
        }
        if (!v_any(*moving) || round == 29)
            break;
        /* what does not move stays as it was, whatever is beside it */
        for (int i = 0; i < NK; i++)
            c->k[i] = v_pick(*moving, c->k[i], c->kept[i]);
        before = v_pick(*moving, before, of_size), last = v_pick(*moving, last, of_step), t = v_pick(*moving, t, of_t);
        if (round == 14 && settle) { /* once more, from wheels at rest in their slip */
            settle_fast_states(c, *moving);
            before = v_pick(*moving, v_all(INFINITY), before);
            last = v_pick(*moving, v_all(0.0), last);
        }
    }
}

/* End of the step and its derivatives from the stages; the last factors give them, by the implicit function theorem. */
INLINE void end_step(Scratch *c, const double *H, int whole)
{
    for (int a = 0; a < NC; a++)
        for (int j = 0; j < 3; j++) {
            for (int b = 0; b < NC; b++)
                c->s[MOVED(3 * a + j, b)] = c->fx[(j * NC + a) * NC + b];
            for (int b = 0; b < NU; b++)
                c->s[MOVED(3 * a + j, NC + b)] = c->fu[(j * NC + a) * NU + b];
        }
    newton_solve_sides(c->m, c->s);
    times_stages(H, c->k, c->z);
    stage_states(c, 2, c->next);
    for (int a = 0; a < NC; a++)
        for (int b = 0; b < NC + NU; b++) {
            V end = c->s[MOVED(3 * a + 2, b)];
            if (b < NC)
                c->A[CORE[a] * NX + CORE[b]] = end + (a == b ? 1.0 : 0.0);
            else
                c->B[CORE[a] * NU + b - NC] = end;
        }
#if NQ > 0
    if (whole)
        quadrature(c->z, c->x, c->u, c->w, c->q, c->qz, c->qx, c->qu);
    else
        short_quadrature(c->z, c->x, c->u, c->w, c->q, c->qz, c->qx, c->qu);
    for (int a = 0; a < NQ; a++) {
        int row = REST[a];
        c->next[row] = c->q[a];
        for (int b = 0; b < NX; b++)
            c->A[row * NX + b] = c->qx[a * NX + b];
        for (int b = 0; b < NU; b++)
            c->B[row * NU + b] = c->qu[a * NU + b];
        V sum[NC + NU];
        memset(sum, 0, sizeof sum);
        for (int i = Q_FIRST[a]; i < Q_FIRST[a + 1]; i++)
            for (int b = 0; b < NC + NU; b++)
                sum[b] += c->qz[a * NK + Q_AT[i]] * c->s[MOVED(Q_AT[i], b)];
        for (int b = 0; b < NC; b++)
            c->A[row * NX + CORE[b]] += sum[b];
        for (int b = 0; b < NU; b++)
            c->B[row * NU + b] += sum[NC + b];
    }
#endif
}

/* Many short steps instead of one for the columns in `which`, derivatives by the chain rule; NaN if even they fail. Their
   factors are those of no column. */
static __attribute__((noinline, cold)) void short_steps(Scratch *c, double tolerance, I which)
{
    V from[NX], next[NX], k[NK], A[NX * NX], B[NX * NU], total[NX * NX], through[NX * NU], row[NX];
    I failed = which & 0;
    c->m = c->factors + GROUPS * NK * NK, c->s = c->by + GROUPS * (NC + NU) * NK;
    memcpy(from, c->x, sizeof from);
    memcpy(next, c->next, sizeof next);
    memcpy(k, c->k, sizeof k);
    memcpy(A, c->A, sizeof A);
    memset(total, 0, sizeof total);
    memcpy(B, c->B, sizeof B);
    for (int n = 0; n < SHORT; n++) {
        I moving;
        memset(c->k, 0, sizeof k);
        find_stages(c, SHORT_H, SHORT_G, STEP / SHORT, tolerance, 0, 0, &moving);
        failed |= moving;
        end_step(c, SHORT_H, 0);
        memcpy(c->x, c->next, sizeof from);
        if (n == 0) {
            memcpy(total, c->A, sizeof total);
            memcpy(through, c->B, sizeof through);
            continue;
        }
        for (int b = 0; b < NX + NU; b++) {
            V *old = b < NX ? total + b : through + b - NX;
            int wide = b < NX ? NX : NU;
            for (int a = 0; a < NX; a++) {
                row[a] = b < NX ? v_all(0.0) : c->B[a * NU + b - NX];
                for (int i = A_FIRST[a]; i < A_FIRST[a + 1]; i++)
                    row[a] += c->A[a * NX + A_AT[i]] * old[A_AT[i] * wide];
            }
            for (int a = 0; a < NX; a++)
                old[a * wide] = row[a];
        }
    }
    for (int a = 0; a < NX; a++) {
        V end = v_pick(failed, v_all(NAN), c->next[a]);
        c->next[a] = v_pick(which, end, next[a]);
        c->x[a] = from[a];
    }
    for (int i = 0; i < NK; i++) /* from nothing again next time */
        c->k[i] = v_pick(which, v_all(0.0), k[i]);
    for (int a = 0; a < NX; a++) /* elsewhere A stays zero, whatever became NaN */
        for (int i = A_FIRST[a]; i < A_FIRST[a + 1]; i++) {
            int at = a * NX + A_AT[i];
            c->A[at] = v_pick(which, total[at], A[at]);
        }
    for (int i = 0; i < NX * NU; i++)
        c->B[i] = v_pick(which, through[i], B[i]);
}

/* End of the step from the stages, without derivatives. */
INLINE void end_alone(Scratch *c)
{
    times_stages(RADAU_H, c->k, c->z);
    stage_states(c, 2, c->next);
#if NQ > 0
    quadrature_values(c->z, c->x, c->u, c->w, c->q);
    for (int a = 0; a < NQ; a++)
        c->next[REST[a]] = c->q[a];
#endif
}

/* Three-stage Radau IIA. The core states (those that feed back on each other) are implicit; the others follow by
   quadrature. Stage slopes k are kept between calls. Returns which columns took short steps. */
static I integrate(Scratch *c, double tolerance, double from, int derivatives)
{
    I moving;
    find_stages(c, RADAU_H, RADAU_G, STEP, tolerance, from, 1, &moving);
    if (derivatives)
        end_step(c, RADAU_H, 1);
    else
        end_alone(c);
    if (__builtin_expect(v_any(moving), 0))
        short_steps(c, tolerance, moving);
    return moving;
}

/* Stage slopes along the derivatives by the state and the inputs from `first` on, after these have moved by `by`. */
INLINE void move_slopes_by(Scratch *c, const V *by, int first)
{
    V way[NK];
    for (int i = 0; i < NK; i++) {
        way[i] = c->s[MOVED(i, first)] * by[first];
        for (int b = first + 1; b < NC + NU; b++)
            way[i] += c->s[MOVED(i, b)] * by[b];
    }
    times_stages(RADAU_G, way, way);
    for (int i = 0; i < NK; i++)
        c->k[i] += way[i];
}

/* Stage slopes along their derivatives after the state and the inputs have moved by dx and du; how far. */
INLINE V move_along(Scratch *c)
{
    V far = {0}, by[NC + NU];
    memcpy(c->kept, c->k, sizeof c->k);
    for (int b = 0; b < NC + NU; b++)
        by[b] = b < NC ? c->dx[CORE[b]] : c->du[b - NC];
    move_slopes_by(c, by, 0);
    for (int i = 0; i < NK; i++)
        far += v_fabs(STEP / (1.0 + v_fabs(c->x[CORE[i / 3]])) * (c->k[i] - c->kept[i]));
    return far;
}

/* Stage slopes corrected once with the factors at hand; by how much. */
INLINE V correct(Scratch *c)
{
    V at[NX], off = {0};
    for (int a = 0; a < NX; a++)
        at[a] = c->x[a];
    times_stages(RADAU_H, c->k, c->z);
    for (int j = 0; j < 3; j++) {
        stage_states(c, j, at);
        core_values(at, c->u, c->w, c->f + j * NC);
    }
    for (int a = 0; a < NC; a++)
        for (int j = 0; j < 3; j++)
            c->d[3 * a + j] = c->k[3 * a + j] - c->f[j * NC + a];
    newton_solve(c->m, c->d);
    times_stages(RADAU_G, c->d, c->d);
    for (int i = 0; i < NK; i++) {
        c->k[i] -= c->d[i];
        off += v_fabs(STEP / (1.0 + v_fabs(c->x[CORE[i / 3]])) * c->d[i]);
    }
    return off;
}

/* End of the step after the state and the inputs have moved by dx and du: stages follow along their derivatives and are
   corrected once. */
INLINE void follow(Scratch *c)
{
    move_along(c);
    V off = correct(c);
    end_alone(c);
    for (int i = 0; i < NK; i++) /* a better start for the next step, unless they were far off */
        c->k[i] = v_pick(off <= 1e-2, c->k[i], c->kept[i]);
#if NS > N
    V by[NC + NU];
    for (int b = 0; b < NU; b++)
        by[NC + b] = c->shift[b];
    move_slopes_by(c, by, NC);
#endif
}

#endif

#if DYNAMICS != CALLED
/* Next state of the columns at hand, which are those of a group, and its derivatives but of that behind the last
   column; whether some took short steps. There is one copy of this, so that a column comes out the same to the last bit
   whatever is beside it. */
static __attribute__((noinline)) int evaluate_columns(Work *s, int group)
{
    Scratch *c = &s->scratch;
#if DYNAMICS == RADAU
    c->m = c->factors + group * NK * NK, c->s = c->by + group * (NC + NU) * NK;
    c->spoilt[group] = integrate(c, s->newton, s->from, group < GROUPS);
    return v_any(c->spoilt[group]);
#else
    if (group < GROUPS)
        explicit_dynamics(c->x, c->u, c->w, c->next, c->A, c->B);
    else
        explicit_values(c->x, c->u, c->w, c->next);
    return 0;
#endif
}
#endif

#if JUMPS > 0
/* What follows stages that take no time, of the steps from `first` on, with derivatives or without. */
static __attribute__((noinline)) void take_jumps(Work *s, int first, int count, int derivatives)
{
    V x[NX], u[NU], w[M1(NW)], next[NX], A[NX * NX], B[NX * NU];
    memset(A, 0, sizeof A), memset(B, 0, sizeof B), memset(u, 0, sizeof u);
    for (int j = 0; j < JUMPS; j++) {
        int m = JUMP[j];
        if (m < first || m >= first + count)
            continue;
        gather(x, s->x, NX, m, 1, NS - 1);
        gather(u, s->u, NU, m, 1, N - 1);
        gather(w, s->w, NW, m, 1, N - 1);
        jump(x, u, w, next, A, B);
        scatter(next, s->next, NX, m, 1, NS - 1);
        if (derivatives) {
            scatter(A, s->A, NX * NX, m, 1, NS - 1);
            scatter(B, s->B, NX * NU, m, 1, NS - 1);
        }
    }
}
#else
#define take_jumps(s, first, count, derivatives)
#endif

static void evaluate_dynamics(Work *s, int first, int count)
{
    Scratch *c = &s->scratch;
    s->ahead = 0;
#if DYNAMICS == CALLED
    for (int i = first; i < first + count && i < NS; i++) {
        const double *in[3] = {s->x + i * NX, s->u + STAGE_OF(i) * NU, s->w + STAGE_OF(i) * NW};
        double *out[3] = {s->next + i * NX, s->A + i * NX * NX, s->B + i * NX * NU};
        CALL(called_dynamics);
    }
#else
    gather(c->x, s->x, NX, first, count, NS - 1);
    gather_held(c->u, s->u, NU, first, count, NS - 1);
    gather_held(c->w, s->w, NW, first, count, NS - 1);
#if DYNAMICS == RADAU
    gather(c->k, s->k, NK, first, count, NS - 1);
#endif
    evaluate_columns(s, first / LANES);
#if DYNAMICS == RADAU
    if (count < LANES)
        c->spoilt[first / LANES] |= -1;
    scatter(c->k, s->k, NK, first, count, NS - 1);
#endif
    scatter(c->next, s->next, NX, first, count, NS - 1);
    scatter(c->A, s->A, NX * NX, first, count, NS - 1);
    scatter(c->B, s->B, NX * NU, first, count, NS - 1);
#endif
    take_jumps(s, first, count, 1);
}

#if STAGE != CALLED
static void gather_stage(const Work *s, Scratch *c, int first)
{
    gather_nodes(c->x, s->x, NX, first, LANES, N);
    gather(c->u, s->u, NU, first, LANES, N - 1);
    gather(c->w, s->w, NW, first, LANES, N);
    gather(c->p, s->p, NP, first, LANES, N);
}
#endif

static void evaluate_stage(Work *s, int first)
{
    Scratch *c = &s->scratch;
#if STAGE == CALLED
    for (int i = first; i < first + LANES && i <= N; i++) {
        int at = i < N ? i : N - 1;
        const double *in[4] = {s->x + NODE(i) * NX, s->u + at * NU, s->w + i * NW, s->p + i * NP};
        double *out[6] = {s->e + i * NE, s->l + i * NL, s->E + i * NE * NX, s->D + i * NE * NU,
                          s->LX + i * NL * NX, s->LU + i * NL * NU};
        CALL(called_stage);
    }
#else
    gather_stage(s, c, first);
    lanes_stage(c->x, c->u, c->w, c->p, c->e, c->l, c->E, c->D, c->LX, c->LU);
    scatter(c->e, s->e, NE, first, LANES, N);
    scatter(c->l, s->l, NL, first, LANES, N);
    scatter(c->E, s->E, NE * NX, first, LANES, N);
    scatter(c->D, s->D, NE * NU, first, LANES, N);
    scatter(c->LX, s->LX, NL * NX, first, LANES, N);
    scatter(c->LU, s->LU, NL * NU, first, LANES, N);
#endif
}

#if DYNAMICS == RADAU
/* What belongs to the last step, also for the one after it. */
INLINE void repeat_last(V *rows, int count)
{
    const V *from = rows + (NS - 1) / LANES * count;
    V *to = rows + NS / LANES * count;
    for (int i = 0; i < count; i++)
        v_lane(to[i], NS % LANES) = v_lane(from[i], (NS - 1) % LANES);
}

/* Factors, derivatives of the stage slopes and movements since the linearisation, of LANES columns; that after the last
   is the step after it, from where that was. */
static void gather_moves(Work *s, int first)
{
    Scratch *c = &s->scratch;
    int group = first / LANES;
    c->m = c->factors + group * NK * NK, c->s = c->by + group * (NC + NU) * NK;
    gather(c->dx, s->dx, NX, first, LANES, NS - 1);
    gather_held(c->du, s->du, NU, first, LANES, NS - 1);
    gather(c->k, s->k, NK, first, LANES, NS - 1);
    gather(c->x, s->x, NX, first, LANES, NS);
    if (NS - first >= LANES)
        return;
    for (int lane = NS - first; lane < LANES; lane++)
        for (int a = 0; a < NX; a++)
            v_lane(c->dx[a], lane) = s->x[NS * NX + a] - s->x_from[(NS - 1) * NX + a];
    v_lane(c->spoilt[group], NS % LANES) = v_lane(c->spoilt[(NS - 1) / LANES], (NS - 1) % LANES);
    if (AHEAD || NS % LANES == 0)
        repeat_last(c->by, (NC + NU) * NK);
}

/* Of the columns, also of the one after the last, what `correct` needs beside their movements. */
INLINE void gather_corrections(Work *s, int first)
{
    Scratch *c = &s->scratch;
    if (NS - first < LANES && (AHEAD || NS % LANES == 0))
        repeat_last(c->factors, NK * NK);
    gather_held(c->u, s->u, NU, first, LANES, NS - 1);
    gather_held(c->w, s->w, NW, first, LANES, NS - 1);
}
#endif

#if AHEAD
/* Places of steps a step later: the one after the last is the last one there, and after that is the first, left behind. */
#define LATER(i) ((i) < NS ? (i) + 1 : 0)
#define HELD_LATER(i) ((i) + 1 < N ? (i) + 1 : (i) < N ? N - 1 : 0)
GATHER(gather_later, LATER)
GATHER(gather_held_later, HELD_LATER)

#if DYNAMICS == RADAU
/* Stage slopes after x and u have moved by dx and du since they were linearised, along their derivatives, and those of the
   step after the last; how far each has moved. Those of short steps stay. */
static void move_slopes(Work *s, int first, double *along)
{
    Scratch *c = &s->scratch;
    gather_moves(s, first);
    I spoilt = c->spoilt[first / LANES];
    V far = v_pick(spoilt, v_all(0.0), move_along(c));
    for (int i = 0; i < NK; i++)
        c->k[i] = v_pick(spoilt, c->kept[i], c->k[i]);
    scatter(c->k, s->k, NK, first, LANES, NS);
    scatter(&far, along, 1, first, LANES, NS);
}

/* What of eight columns has moved far, corrected: where one has gone FAR_ALONG, all that have gone a hundredth of that, as
   one alone that needs another step of Newton's method takes the time of as many as there are lanes. */
static void correct_slopes(Work *s, int eighth, const double *along)
{
    Scratch *c = &s->scratch;
    int last = eighth + 7 < NS ? eighth + 7 : NS, far = 0;
    for (int i = eighth; i <= last; i++)
        far |= !(along[i] <= FAR_ALONG);
    for (int first = last / LANES * LANES; far && first >= eighth; first -= LANES) {
        V way, moved[NK];
        gather(&way, along, 1, first, LANES, last);
        I which = v_unless(way <= 0.01 * FAR_ALONG);
        if (!v_any(which))
            continue;
        gather_moves(s, first);
        gather_corrections(s, first);
        gather(c->k, s->k, NK, first, LANES, NS);
        gather(c->kept, s->k_from, NK, first, LANES, NS);
        memcpy(moved, c->k, sizeof moved);
        V off = correct(c);
        for (int i = 0; i < NK; i++)
            c->k[i] = v_pick(which, v_pick(off <= 1e-2, c->k[i], c->kept[i]), moved[i]);
        scatter(c->k, s->k, NK, first, LANES, NS);
    }
}
#endif

/* Next states and their derivatives in the places where a plan a step later has them; whether all is as it would be. */
static int evaluate_later(Work *s, int first)
{
    Scratch *c = &s->scratch;
#if DYNAMICS == CALLED
    for (int i = first; i < first + LANES && i <= NS; i++) {
        const double *in[3] = {s->x + LATER(i) * NX, s->u + HELD_LATER(i) * NU, s->w + LATER(i) * NW};
        double *out[3] = {s->next + i * NX, s->A + i * NX * NX, s->B + i * NX * NU};
        if (i < NS)
            CALL(called_dynamics);
        else
            CALL(called_values);
    }
    return 1;
#else
    gather_later(c->x, s->x, NX, first, LANES, NS);
    gather_held_later(c->u, s->u, NU, first, LANES, NS);
    gather_later(c->w, s->w, NW, first, LANES, NS);
#if DYNAMICS == RADAU
    gather_later(c->k, s->k, NK, first, LANES, NS);
#endif
    int spoilt = evaluate_columns(s, first / LANES);
#if DYNAMICS == RADAU
    scatter(c->k, s->ahead_slopes, NK, first, LANES, NS - 1);
#endif
    scatter(c->next, s->next, NX, first, LANES, NS);
    scatter(c->A, s->A, NX * NX, first, LANES, NS - 1);
    scatter(c->B, s->B, NX * NU, first, LANES, NS - 1);
    return !spoilt;
#endif
}
#endif

#if DYNAMICS == RADAU
/* The same for the columns that took short steps, whose slopes lead nowhere: integrated anew. */
static __attribute__((noinline, cold)) void follow_short(Work *s, int first)
{
    Scratch *c = &s->scratch;
    V next[NX], k[NK], start[NK];
    I spoilt = c->spoilt[first / LANES];
    memcpy(next, c->next, sizeof next);
    memcpy(k, c->k, sizeof k);
    gather(c->k, s->k, NK, first, LANES, NS);
    memcpy(start, c->k, sizeof k);
    evaluate_columns(s, GROUPS);
    for (int lane = NS - first; lane < LANES; lane++) /* of the step after the last nothing better is known */
        for (int i = 0; i < NK; i++)
            v_lane(c->k[i], lane) = v_lane(start[i], lane);
    for (int a = 0; a < NX; a++)
        c->next[a] = v_pick(spoilt, c->next[a], next[a]);
    for (int i = 0; i < NK; i++)
        c->k[i] = v_pick(spoilt, c->k[i], k[i]);
}
#endif

/* Where the steps of the model from LANES nodes end after x and u have moved by dx and du since they were linearised,
   and the stage slopes there; without derivatives. */
static void evaluate_ends(Work *s, int first)
{
    Scratch *c = &s->scratch;
    s->ahead = 0;
#if DYNAMICS == CALLED
    for (int i = first; i < first + LANES && i < NS; i++) {
        const double *in[3] = {s->x + i * NX, s->u + STAGE_OF(i) * NU, s->w + STAGE_OF(i) * NW};
        double *out[1] = {s->next + i * NX};
        CALL(called_values);
    }
#else
#if DYNAMICS == RADAU
    gather_moves(s, first);
    for (int lane = 0; NS > N && lane < LANES; lane++) { /* the next plan holds the mean of two inputs over a stage */
        int m = first + lane < NS ? first + lane : NS - 1, before = first + lane > NS ? NS - 1 : first + lane - 1;
        for (int b = 0; b < NU; b++)
            v_lane(c->shift[b], lane) =
                before < 0 ? 0 : s->u_later[STAGE_OF(before) * NU + b] - s->u[STAGE_OF(m) * NU + b];
    }
    gather_corrections(s, first);
    follow(c);
    if (__builtin_expect(v_any(c->spoilt[first / LANES]), 0))
        follow_short(s, first);
    scatter(c->k, s->k, NK, first, LANES, NS);
#else
    gather(c->x, s->x, NX, first, LANES, NS - 1);
    gather_held(c->u, s->u, NU, first, LANES, NS - 1);
    gather_held(c->w, s->w, NW, first, LANES, NS - 1);
    explicit_values(c->x, c->u, c->w, c->next);
#endif
    scatter(c->next, s->next, NX, first, LANES, NS - 1);
#endif
    take_jumps(s, first, LANES, 0);
}

/* Errors and limited quantities of LANES stages, without derivatives. */
static void evaluate_errors(Work *s, int first)
{
    Scratch *c = &s->scratch;
#if STAGE == CALLED
    for (int i = first; i < first + LANES && i <= N; i++) {
        int at = i < N ? i : N - 1;
        const double *in[4] = {s->x + NODE(i) * NX, s->u + at * NU, s->w + i * NW, s->p + i * NP};
        double *out[2] = {s->e + i * NE, s->l + i * NL};
        CALL(called_stage_values);
    }
#else
    gather_stage(s, c, first);
    stage_values(c->x, c->u, c->w, c->p, c->e, c->l);
    scatter(c->e, s->e, NE, first, LANES, N);
    scatter(c->l, s->l, NL, first, LANES, N);
#endif
}
