/* PackedKalman.update and PackedHybrid.update. */
#include "filter.h"

/* Measured minus prior boxes in the heading frame, that heading, and the agreement of both: a half
 * turn does not matter to the difference of yaws, but makes the agreement negative. */
static void innovate(const Tracks *t, const double *measured, const int64_t *detections,
                     Rows apart) {
    for (int row = 0; row < YAW; row++)
        for (int j = 0; j < t->n; j++) {
            double seen = measured[BOX * detections[j] + FIELD[row]];
            apart[row][j] = (float)(seen - t->boxes[row * t->box_step + j]);
        }
    for (int j = 0; j < t->n; j++) {
        double by = measured[BOX * detections[j] + YAW] - t->boxes[YAW * t->box_step + j];
        double turns = whole_periods(by + 0.5 * PI, PI);
        apart[YAW][j] = (float)(by - turns * PI);
        apart[AGREEMENT_ROW][j] = whole_periods(turns, 2.0) * 2.0 == turns ? 1.0f : -1.0f;
    }
    heading(t->boxes + YAW * t->box_step, apart[COS_ROW], apart[SIN_ROW], t->n);
    turn(apart[PLAN], apart[PLAN + 1], apart[COS_ROW], apart[SIN_ROW], -1.0f, t->n);
}

/* What the gain network sees, its rows `step` apart: shared rows, innovation, where from, spread of
 * the axes. */
static void features(const Tracks *t, const Array *high, const float *seen,
                     const int64_t *detections, Rows apart, float *in, int step) {
    Py_ssize_t shared = t->layout[ELAPSED] + 2, rows = shared + GAIN_ROWS;
    size_t bytes = sizeof(float) * (size_t)t->n;
    float *to = in + shared * step;
    for (Py_ssize_t row = 0; row < shared; row++)
        memcpy(in + row * step, t->state + row * t->step, bytes);
    for (int row = 0; row < BOX; row++, to += step) memcpy(to, apart[row], bytes);
    for (int row = 0; row < FROM_SENSOR_ROWS; row++)
        of_detections(seen, VARIANCE_ROWS + row, detections, t->n, to + row * step);
    turn(to + 2 * step, to + 3 * step, apart[COS_ROW], apart[SIN_ROW], -1.0f, t->n);
    to += FROM_SENSOR_ROWS * step;
    for (int axis = 0; axis < AXES; axis++)
        for (int j = 0; j < t->n; j++)
            to[axis * step + j] = logarithm(part(t, COVARIANCE)[axis * t->step + j]);
    limit(in, step, high, rows, t->n);
    fill_up(in, rows, t->n);
}

/* What the gain network said, (8, n) in [-1, 1]: of the next noise, and of this variance. */
static void scale_noise(const Tracks *t, const float *said, int step, Rows variance) {
    const float *learned = part(t, LEARNED), *q = part(t, Q);
    float *noise = part(t, NOISE);
    for (int axis = 0; axis < AXES; axis++)
        for (int j = 0; j < t->n; j++) {
            float most = LARGEST_SAID * learned[j];
            noise[axis * t->step + j] = q[axis * t->step + j] * expf(most * said[axis * step + j]);
            variance[MOTION + axis][j] *= expf(most * said[(AXES + axis) * step + j]);
        }
}

/* motion.covariance.correct of one axis: gains times innovation into `change`, a row a derivative
 * AXES rows apart, and the posterior covariance. The gain of the position is returned in `gain`. */
static void correct_axis(const Tracks *t, float *covariance, const float *variance,
                         const float *innovation, float (*change)[BLOCK], float *gain) {
    int order = (int)t->layout[ORDER], place = order, n = t->n;
    Py_ssize_t block = AXES * t->step;
    float higher[3][BLOCK];
    for (int j = 0; j < n; j++) {
        float inverse = 1.0f / (covariance[j] + variance[j]);
        gain[j] = covariance[j] * inverse;
        change[0][j] = gain[j] * innovation[j];
        for (int d = 1; d < order; d++) {
            higher[d][j] = covariance[d * block + j] * inverse;
            change[d * AXES][j] = higher[d][j] * innovation[j];
        }
    }
    for (int i = 1; i < order; i++)
        for (int k = i; k < order; k++, place++)
            for (int j = 0; j < n; j++)
                covariance[place * block + j] -= higher[i][j] * covariance[k * block + j];
    for (int d = 0; d < order; d++)
        for (int j = 0; j < n; j++)
            covariance[d * block + j] -= gain[j] * covariance[d * block + j];
}

/* Changes of sizes and axes, (7 and more rows) in the heading frame; posterior covariances. */
static void correct(const Tracks *t, Rows apart, Rows variance, Rows change) {
    float *spread = part(t, SIZE_VARIANCE), gain[BLOCK];
    for (int row = SIZE; row < 3; row++, spread += t->step)
        for (int j = 0; j < t->n; j++) {
            double least = SMALLEST_SIZE_M - t->boxes[row * t->box_step + j];
            float share = spread[j] * (1.0f / (spread[j] + variance[row][j]));
            float by = share * apart[row][j];
            change[row][j] = by < least ? (float)least : by;
            spread[j] -= share * spread[j];
        }
    for (int axis = 0; axis < AXES; axis++)
        correct_axis(t, part(t, COVARIANCE) + axis * t->step, variance[MOTION + axis],
                     apart[MOTION + axis], change + MOTION + axis, gain);
}

/* Make changes, turned to the world's axes. */
static void apply(const Tracks *t, Rows apart, Rows change) {
    for (int d = 0; d < t->layout[ORDER]; d++)
        turn(change[MOTION + AXES * d], change[MOTION + AXES * d + 1], apart[COS_ROW],
             apart[SIN_ROW], 1.0f, t->n);
    for (int row = 0; row < BOX; row++)
        for (int j = 0; j < t->n; j++) t->boxes[row * t->box_step + j] += change[row][j];
    for (int d = 1; d < t->layout[ORDER]; d++)
        for (int axis = 0; axis < AXES; axis++) {
            float *to = part(t, d == 1 ? VELOCITY : ACCELERATION) + axis * t->step;
            for (int j = 0; j < t->n; j++) to[j] += change[MOTION + AXES * d + axis][j];
        }
}

/* model.filters.settle_heading. */
static void settle_heading(const Tracks *t, const float *agreement) {
    double *yaw = t->boxes + YAW * t->box_step;
    float *vote = part(t, VOTE);
    for (int j = 0; j < t->n; j++) {
        float votes = vote[j] + agreement[j];
        votes = LEAST(votes, MAX_HEADING_VOTE);
        /* By no turn or, where the vote is lost, a half turn; then at most that from zero. */
        double turned = yaw[j] + (votes < 0.0f ? PI : 0.0);
        yaw[j] = turned - 2.0 * PI * whole_periods(turned + PI, 2.0 * PI);
        vote[j] = fabsf(votes);
    }
}

/* What the learned filter remembers of a correction. */
static void remember_update(const Tracks *t, Rows change) {
    float *history = part(t, HISTORY);
    const float *inverse = part(t, INVERSE_DT);
    size_t bytes = sizeof(float) * (size_t)t->n;
    for (int row = 0; row < BOX; row++)
        for (int j = 0; j < t->n; j++) history[row * t->step + j] += change[row][j] * inverse[j];
    memset(part(t, COUNTERS), 0, bytes);
    memset(part(t, ELAPSED), 0, bytes);
    log_sizes(t);
}

/* The gain network on all that is known: the memory, the first rows of the state, is replaced, and
 * noises are scaled if it says anything of them. */
static void learn(const Tracks *t, const Layer *layers, const Array *high, const float *seen,
                  const int64_t *detections, Rows apart, Rows variance) {
    int step = whole_registers(t->n);
    SCRATCH(in);
    features(t, high, seen, detections, apart, in, step);
    const float *said = this_machine()->gain(layers, in, step);
    if (layers[3].outputs) scale_noise(t, said, step, variance);
    for (Py_ssize_t row = 0; row < t->layout[ONE]; row++)
        memcpy(t->state + row * t->step, in + row * step, sizeof(float) * (size_t)t->n);
}

FOR_EACH_PROCESSOR void update(const Filter *filter, const Columns *columns, const Known *known,
                               const int64_t *detections, Py_ssize_t all) {
    for (Py_ssize_t start = 0; start < all; start += BLOCK) {
        Tracks t = some(filter, columns, start, all);
        const int64_t *from = detections + start;
        float apart[APART_ROWS][BLOCK], variance[BOX][BLOCK], change[BOX + 2 * AXES][BLOCK];
        innovate(&t, known->measured, from, apart);
        for (int row = 0; row < BOX; row++)
            of_detections(known->seen, row, from, t.n, variance[row]);
        if (filter->learned)
            learn(&t, filter->gain, filter->gain_limit, known->seen, from, apart, variance);
        correct(&t, apart, variance, change);
        for (int row = 0; filter->learned && row < BOX; row++)
            memcpy(part(&t, CORRECTION) + row * t.step, change[row], sizeof(float) * (size_t)t.n);
        apply(&t, apart, change);
        settle_heading(&t, apart[AGREEMENT_ROW]);
        if (filter->learned) remember_update(&t, change);
    }
}
