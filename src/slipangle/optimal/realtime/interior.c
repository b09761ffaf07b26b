/* Interior point on the Riccati factor, for held rows that the plan before does not tell, and the method as a whole.

   Mehrotra, SIAM J. Optim. 2, 1992. */

#define MOST_FACTORS 12 /* from the rows of the plan before; if they do not do, an interior point is faster */
#define MOST_INTERIOR 40
#define ON_THE_WAY 1e-5    /* of the last step: the digits of the next one are not the last */
#define JAMMED 6           /* steps after which limits that are missed should be nearer */
#define MOST_PRODUCTS 1e9
#define TO_INTERIOR 20 /* factors that an interior point takes the time of; where condensing takes less, it is next */

/* ---- interior point ------------------------------------------------------------------------------------------- */

/* Limits, one side of a row each, LANES at a time: distance to the limit, excess allowed, their multipliers. Hard ones,
   and the places after the last, have `soft` 0 and an excess of 0 at a multiplier of 1. */

#define SIDE(name) ((double *)s->stages.name)

/* The size of the gradient, by which products are small. */
static double small_force(const Work *s)
{
    double size = 0;
    for (int a = 0; a < QN; a++)
        size = larger(fabs(s->qp.g[a]), size);
    return larger(size, 1e-6 * s->stages.top);
}

/* The lowest price of an excess. */
static double lowest_price(const Work *s)
{
    const Stages *r = &s->stages;
    double least = INFINITY;
    for (int k = 0; k < r->rows; k++)
        least = s->qp.plain[r->row[k]] > 0 ? smaller(s->qp.plain[r->row[k]], least) : least;
    return least;
}

static void begin_sides(Work *s, double more)
{
    Stages *r = &s->stages;
    const Qp *q = &s->qp;
    int n = 0;
    double product = more * 10 * small_force(s);
    for (int k = 0; k < r->rows; k++)
        for (int side = 1, i = r->row[k]; side >= -1; side -= 2) {
            double limit = side > 0 ? q->hi[i] : -q->lo[i], room = 0.1 * sqrt(STIFF * r->top / r->stiff[i]);
            if (!(limit < INFINITY))
                continue;
            int soft = q->plain[i] < INFINITY;
            double distance = larger(limit, room), price = product / distance;
            if (soft && q->square[i] <= 0)
                price = smaller(price, 0.5 * q->plain[i]);
            SIDE(limit)[n] = limit, SIDE(turn)[n] = (double)side, SIDE(used)[n] = 1, SIDE(soft)[n] = (double)soft;
            SIDE(plain)[n] = soft ? q->plain[i] : 0, SIDE(square)[n] = soft ? q->square[i] : 0;
            SIDE(distance)[n] = distance, SIDE(price_of)[n] = price;
            SIDE(of_excess)[n] = !soft ? 1 : q->square[i] <= 0 ? q->plain[i] - price : product / room;
            SIDE(excess)[n] = !soft ? 0 : q->square[i] <= 0 ? product / SIDE(of_excess)[n] : room;
            r->of[n++] = i;
        }
    r->sides = n;
    for (; n % LANES; n++) {
        SIDE(turn)[n] = SIDE(used)[n] = SIDE(soft)[n] = SIDE(plain)[n] = SIDE(square)[n] = 0;
        SIDE(price_of)[n] = SIDE(excess)[n] = SIDE(at)[n] = SIDE(moved)[n] = 0;
        SIDE(limit)[n] = SIDE(distance)[n] = SIDE(of_excess)[n] = 1;
    }
    r->side_vectors = n / LANES;
    memset(r->by_distance, 0, sizeof r->by_distance);
    memset(r->by_price, 0, sizeof r->by_price);
    memset(r->by_excess, 0, sizeof r->by_excess);
    memset(r->by_of_excess, 0, sizeof r->by_of_excess);
}

/* Sum of the products of multipliers and distances after a part of the step, over their number. */
static double mean_product(const Work *s, double t)
{
    const Stages *r = &s->stages;
    V sum = {0}, many = {0};
    for (int k = 0; k < r->side_vectors; k++) {
        sum += r->used[k] * (r->distance[k] + t * r->by_distance[k]) * (r->price_of[k] + t * r->by_price[k]);
        sum += r->soft[k] * (r->excess[k] + t * r->by_excess[k]) * (r->of_excess[k] + t * r->by_of_excess[k]);
        many += r->used[k] + r->soft[k];
    }
    double total = 0, count = 0;
    for (int j = 0; j < LANES; j++)
        total += v_lane(sum, j), count += v_lane(many, j);
    return count > 0 ? total / count : 0;
}

/* Slopes of the sides' multipliers by the values of their rows, and what is missing of their limits. */
static void slope_sides(Work *s)
{
    Stages *r = &s->stages;
    for (int k = 0; k < r->sides; k++)
        SIDE(at)[k] = SIDE(turn)[k] * r->value[r->of[k]];
    for (int k = 0; k < r->side_vectors; k++) {
        r->gap[k] = r->limit[k] - r->at[k] - r->distance[k] + r->excess[k];
        r->miss[k] = r->soft[k] * (r->plain[k] + r->square[k] * r->excess[k] - r->price_of[k] - r->of_excess[k]);
        r->over_excess[k] = r->soft[k] / (r->of_excess[k] + r->excess[k] * r->square[k]);
        r->per_price[k] = r->excess[k] * r->over_excess[k];
        r->over_distance[k] = 1.0 / (r->distance[k] + r->price_of[k] * r->per_price[k]);
    }
    memset(r->slope, 0, sizeof r->slope);
    for (int k = 0; k < r->sides; k++)
        r->slope[r->of[k]] += SIDE(price_of)[k] * SIDE(over_distance)[k];
}

/* Step of the multipliers where the rows stay, if the products are to come to `centre`; `round` 1 corrects them for
   what the step of round 0 leaves. */
static void aim_sides(Work *s, double centre, int round)
{
    Stages *r = &s->stages;
    for (int k = 0; k < r->side_vectors; k++) {
        V given = r->used[k] * centre - r->distance[k] * r->price_of[k], paid = r->soft[k] * centre - r->excess[k] * r->of_excess[k];
        if (round) {
            given -= r->by_distance[k] * r->by_price[k];
            paid -= r->by_excess[k] * r->by_of_excess[k];
        }
        r->still_excess[k] = (paid - r->excess[k] * r->miss[k]) * r->over_excess[k];
        r->still_price[k] = (given - r->price_of[k] * (r->gap[k] + r->still_excess[k])) * r->over_distance[k];
    }
    memset(r->after, 0, sizeof r->after);
    for (int k = 0; k < r->sides; k++)
        r->after[r->of[k]] += SIDE(turn)[k] * (SIDE(price_of)[k] + SIDE(still_price)[k]);
}

/* Step of all sides after that of the rows; how far along it everything stays positive. */
static double step_sides(Work *s)
{
    Stages *r = &s->stages;
    V most = v_all(0.9804); /* no further than 1.02 of the step */
    for (int k = 0; k < r->sides; k++)
        SIDE(moved)[k] = SIDE(turn)[k] * r->value_by[r->of[k]];
    for (int k = 0; k < r->side_vectors; k++) {
        V price = r->still_price[k] + r->price_of[k] * r->over_distance[k] * r->moved[k];
        V excess = r->still_excess[k] + r->per_price[k] * price, distance = r->gap[k] + excess - r->moved[k];
        V of_excess = r->miss[k] + r->soft[k] * (r->square[k] * excess - price);
        r->by_price[k] = price, r->by_excess[k] = excess, r->by_distance[k] = distance, r->by_of_excess[k] = of_excess;
        most = v_fmax(most, r->used[k] * -price / (r->price_of[k] + (1.0 - r->used[k])));
        most = v_fmax(most, r->used[k] * -distance / r->distance[k]);
        most = v_fmax(most, r->soft[k] * -excess / (r->excess[k] + (1.0 - r->soft[k])));
        most = v_fmax(most, r->soft[k] * -of_excess / r->of_excess[k]);
    }
    double top = 0;
    for (int j = 0; j < LANES; j++)
        top = larger(v_lane(most, j), top);
    return 1 / top;
}

static void move_sides(Work *s, double t)
{
    Stages *r = &s->stages;
    for (int k = 0; k < r->side_vectors; k++) {
        r->distance[k] += t * r->by_distance[k], r->price_of[k] += t * r->by_price[k];
        r->excess[k] += t * r->by_excess[k], r->of_excess[k] += t * r->by_of_excess[k];
    }
}

/* Mehrotra's predictor and corrector on all sides of the rows, from products `more` than small ones, until they are: r->v
   and r->price are then near the answer. -1 where limits that are missed stay so, as the products are too small for that. */
static int from_products(Work *s, double more)
{
    Stages *r = &s->stages;
    Qp *q = &s->qp;
    memset(r->v, 0, sizeof r->v);
    memset(r->e, 0, sizeof r->e);
    memset(r->value, 0, sizeof r->value);
    begin_sides(s, more);
    double begun = mean_product(s, 0), missing = 1;
    for (int n = 0; n < MOST_INTERIOR; n++) {
        double product = mean_product(s, 0), centre = 0, t = 1;
        slope_sides(s);
        if (now(q) > q->until)
            return QP_LATE;
        if (!(product < INFINITY) || !factor_stages(s, 0))
            return QP_NUMBER;
        for (int round = 0; round < 2; round++) {
            aim_sides(s, centre, round);
            solve_stages(s);
            t = step_sides(s);
            double share = mean_product(s, smaller(t, 1)) / product;
            centre = product * share * share * share;
        }
        q->iterations++;
        t = smaller(0.995 * t, 1), missing *= 1 - t;
        if (n == JAMMED && missing > 0.5 && more < MOST_PRODUCTS)
            return -1;
        move_rows(s, t);
        move_sides(s, t);
        if (mean_product(s, 0) <= 1e-11 * begun && t > 0.9)
            break;
    }
    for (int k = 0; k < r->rows; k++)
        r->price[r->row[k]] = 0;
    for (int k = 0; k < r->sides; k++)
        r->price[r->of[k]] += SIDE(turn)[k] * SIDE(price_of)[k];
    return QP_SOLVED;
}

static int by_interior(Work *s, double more)
{
    int status = s->stages.bends.count ? QP_NUMBER : -1;
    for (; status < 0; more *= 1e3)
        status = from_products(s, more);
    return status;
}

/* ---- method --------------------------------------------------------------------------------------------------- */

/* What holds the rows, by their values and multipliers. */
static void guess_modes(Work *s)
{
    Stages *r = &s->stages;
    const Qp *q = &s->qp;
    for (int k = 0; k < r->rows; k++) {
        int i = r->row[k];
        double up = r->price[i] + r->stiff[i] * (r->value[i] - q->hi[i]);
        double down = r->price[i] + r->stiff[i] * (r->value[i] - q->lo[i]), over = up > 0 ? up : -down;
        r->sign[i] = up > 0 ? 1 : down < 0 ? -1 : 0;
        r->mode[i] = r->sign[i] == 0 ? FREE : over <= q->plain[i] ? KEPT : q->square[i] > 0 ? PAID : SPENT;
    }
}

/* Whether hard limits are kept to a few digits. */
static int keeps_rows(const Work *s)
{
    const Stages *r = &s->stages;
    const Qp *q = &s->qp;
    for (int k = 0; k < r->rows; k++) {
        int i = r->row[k];
        double over = r->value[i] - q->hi[i], under = q->lo[i] - r->value[i], limit = over > under ? q->hi[i] : q->lo[i];
        double size = 1 + fabs(limit) + fabs(r->value[i]);
        if (!(q->plain[i] < INFINITY) && !(larger(over, under) <= FEW_DIGITS * size))
            return 0;
    }
    return 1;
}

/* The exact answer from an interior point; or that point itself on the way, where rows that are held depend on each other. */
static int from_point(Work *s, double more)
{
    Stages *r = &s->stages;
    double v[QN], price[QT];
    int mode[QT], status = by_interior(s, more);
    if (status != QP_SOLVED)
        return status;
    guess_modes(s);
    memcpy(r->after, r->price, sizeof r->after);
    memcpy(v, r->v, sizeof v);
    memcpy(price, r->price, sizeof price);
    memcpy(mode, r->mode, sizeof mode);
    int near = s->step > ON_THE_WAY && keeps_rows(s) && (gradient_of_rows(s, 1e-300) <= FEW_DIGITS || balance_of_rows(s) <= FEW_DIGITS);
    status = by_rows(s, MOST_FACTORS);
    if (status != QP_NUMBER || !near)
        return status;
    memcpy(r->v, v, sizeof v);
    memcpy(r->after, price, sizeof price);
    memcpy(r->mode, mode, sizeof mode);
    return QP_SOLVED;
}

/* The same from small products or, where these lead nowhere as prices are far above all other forces, from theirs. */
static int from_inside(Work *s)
{
    int status = from_point(s, 1);
    double more = lowest_price(s) / small_force(s);
    return status == QP_NUMBER && more > 1 && more < INFINITY ? from_point(s, more) : status;
}

/* The answer that was found, as `qp_solve` leaves it. */
static void hand_over(Work *s)
{
    Stages *r = &s->stages;
    Qp *q = &s->qp;
    memset(q->lambda, 0, sizeof q->lambda);
    memset(q->mode, 0, sizeof q->mode);
    memcpy(q->u, r->v, sizeof r->v);
    q->k = 0;
    for (int k = 0; k < r->rows; k++) {
        int i = r->row[k];
        q->lambda[i] = r->after[i], q->mode[i] = r->mode[i];
        if (r->mode[i] == KEPT || r->mode[i] == PAID)
            q->row[q->k] = i, q->sign[q->k++] = r->sign[i];
    }
}

static void begin_program(Work *s, int warm)
{
    Stages *r = &s->stages;
    begin_rows(s);
    if (warm)
        expect_rows(s);
    memset(r->v, 0, sizeof r->v);
    memset(r->e, 0, sizeof r->e);
    s->qp.iterations = 0, s->qp.kkt = INFINITY;
}

static int end_program(Work *s, int status)
{
    s->qp_iterations += s->qp.iterations;
    if (status == QP_SOLVED)
        hand_over(s);
    return status;
}

/* u and lambda of the quadratic program, as `qp_solve`; QP_NUMBER where it takes too many steps. */
static int solve_long(Work *s, int warm)
{
    begin_program(s, warm);
    int status = by_rows(s, MOST_FACTORS);
    if (status == QP_NUMBER && to_condense(s) > TO_INTERIOR * TO_FACTOR)
        status = from_inside(s);
    return end_program(s, status);
}

/* The same where states that are eliminated are no way to an answer: by the interior point alone. */
static int solve_inside(Work *s)
{
    begin_program(s, 0);
    return end_program(s, from_inside(s));
}

#ifdef CURVED
/* The same with all curvature, from the rows that were held last; QP_NUMBER where it is not positive on those held here. */
static int solve_saddle(Work *s)
{
    Stages *r = &s->stages;
    begin_program(s, 1);
    count_negative(s, 1);
    price_rows(s);
    memcpy(r->slope, r->wanted, sizeof r->slope);
    int status = factor_stages(s, 0) ? by_rows(s, MOST_FACTORS) : QP_NUMBER;
    if (status != QP_SOLVED)
        count_negative(s, 0);
    return end_program(s, status);
}
#endif
