/* PackedKalman.predict and PackedHybrid.predict. */
#include "filter.h"

/* motion.covariance.propagate: P becomes F P F' + Q. A block takes from later ones only. */
static void propagate(const Tracks *t, const float *times, Py_ssize_t step, const int64_t *frames) {
    float *covariance = part(t, COVARIANCE), weight[BLOCK];
    const float *noise = part(t, NOISE);
    const int64_t *pair = t->layout + LAYOUT_LENGTH;
    for (Py_ssize_t m = 0; m < t->mixed + t->blocks; m++) {
        int mixes = m < t->mixed;
        pick(times + (WEIGHTS + m) * step, frames, t->n, weight);
        float *to = covariance + AXES * (mixes ? pair[2 * m] : m - t->mixed) * t->step;
        const float *from = mixes ? covariance + AXES * pair[2 * m + 1] * t->step : noise;
        for (int axis = 0; axis < AXES; axis++, to += t->step, from += t->step)
            for (int j = 0; j < t->n; j++) to[j] += from[j] * weight[j];
    }
}

/* model.kalman: the state goes on by a time step; mean velocity of the axes meanwhile. */
static void advance(const Tracks *t, const float *times, Py_ssize_t step, const int64_t *frames,
                    const float *dt, const float *half, Rows mean) {
    float *size = part(t, SIZE_VARIANCE), *v = part(t, VELOCITY);
    const float *noise = part(t, SIZE_NOISE), *a = part(t, ACCELERATION);
    propagate(t, times, step, frames);
    for (int row = 0; row < 3; row++)
        for (int j = 0; j < t->n; j++) size[row * t->step + j] += noise[row * t->step + j] * dt[j];
    for (int axis = 0; axis < AXES; axis++)
        for (int j = 0; j < t->n; j++) {
            Py_ssize_t at = axis * t->step + j;
            float gained = t->layout[ORDER] == 3 ? a[at] * half[j] : 0.0f;
            mean[axis][j] = v[at] + gained;
            v[at] = mean[axis][j] + gained;
        }
    if (!t->layout[TURNS]) return;
    /* The chord of a turn points along the heading in the middle of it. */
    float c[BLOCK], s[BLOCK];
    for (int j = 0; j < t->n; j++) {
        double cosine, sine;
        cosine_and_sine(v[3 * t->step + j] * half[j], &cosine, &sine);
        c[j] = (float)cosine, s[j] = (float)sine;
    }
    turn(mean[0], mean[1], c, s, 1.0f, t->n);
    for (int axis = 0; axis < 2; axis++)
        memcpy(v + axis * t->step, mean[axis], sizeof(float) * (size_t)t->n);
    turn(v, v + t->step, c, s, 1.0f, t->n);
}

/* What the residual predictor sees, its rows `step` apart: velocity and history in the heading
 * frame, all else as it is. */
static void features(const Tracks *t, const Array *high, const float *c, const float *s,
                     float *in, int step) {
    Py_ssize_t rows = t->layout[HISTORY_END];
    for (Py_ssize_t row = 0; row < rows; row++)
        memcpy(in + row * step, t->state + row * t->step, sizeof(float) * (size_t)t->n);
    /* Elapsed and tenths are as many rows as a size, so velocity is laid out like a rate. */
    for (Py_ssize_t row = t->layout[ELAPSED] + PLAN; row < rows; row += BOX)
        turn(in + row * step, in + (row + 1) * step, c, s, -1.0f, t->n);
    limit(in, step, high, rows, t->n);
    fill_up(in, rows, t->n);
}

/* What the residual predictor says along, across and of yaw, as rates of the world. */
static void residual(const Tracks *t, const Layer *layers, const Array *high, const float *tenths,
                     Rows rate) {
    static const int row_of[SAID] = {PLAN, PLAN + 1, YAW};
    const float *learned = part(t, LEARNED);
    float c[BLOCK], s[BLOCK];
    int step = whole_registers(t->n);
    SCRATCH(in);
    heading(t->boxes + YAW * t->box_step, c, s, t->n);
    memcpy(part(t, TENTHS), tenths, sizeof(float) * (size_t)t->n);
    features(t, high, c, s, in, step);
    const float *said = this_machine()->residual(layers, in, step);
    for (int row = 0; row < SAID; row++)
        for (int j = 0; j < t->n; j++) rate[row_of[row]][j] = said[row * step + j] * learned[j];
    turn(rate[PLAN], rate[PLAN + 1], c, s, 1.0f, t->n);
}

/* What the learned filter remembers of a step: its rates, times since detection and birth. */
static void remember_step(const Tracks *t, Rows rate, const float *tenths, const float *inverse) {
    float *history = part(t, HISTORY), *counter = part(t, COUNTERS), *elapsed = part(t, ELAPSED);
    size_t bytes = sizeof(float) * (size_t)t->n;
    for (Py_ssize_t row = t->layout[HISTORY_END] - t->layout[HISTORY] - 1; row >= 0; row--)
        memcpy(history + row * t->step,
               row < BOX ? rate[row] : history + (row - BOX) * t->step, bytes);
    for (int row = 0; row < 2; row++)
        for (int j = 0; j < t->n; j++) {
            Py_ssize_t at = row * t->step + j;
            counter[at] += tenths[j];
            elapsed[at] = logarithm(1.0f + LEAST(counter[at], LONGEST_TENTHS));
        }
    memcpy(part(t, INVERSE_DT), inverse, bytes);
}

FOR_EACH_PROCESSOR void predict(const Filter *filter, const Columns *columns, const Known *known,
                                const int64_t *frames, const double *shares, double *prior,
                                Py_ssize_t all) {
    const float *times = known->times->view.buf;
    Py_ssize_t step = known->times->columns;
    for (Py_ssize_t start = 0; start < all; start += BLOCK) {
        Tracks t = some(filter, columns, start, all);
        const int64_t *frame = frames + start;
        float rate[BOX][BLOCK] = {{0}}, mean[AXES][BLOCK], time[WEIGHTS][BLOCK];
        for (int row = 0; row < WEIGHTS; row++) pick(times + row * step, frame, t.n, time[row]);
        if (filter->learned)
            residual(&t, filter->residual, filter->residual_limit, time[IN_TENTHS], rate);
        advance(&t, times, step, frame, time[DT_S], time[HALF_S], mean);
        for (int axis = 0; axis < AXES; axis++)
            for (int j = 0; j < t.n; j++) rate[MOTION + axis][j] += mean[axis][j];
        for (int row = 0; row < BOX; row++) {
            double *box = t.boxes + row * t.box_step, *to = prior + FIELD[row] * all + start;
            const double *share = shares && row >= MOTION && row < YAW ? shares + start : NULL;
            for (int j = 0; j < t.n; j++) {
                double moved = box[j] + rate[row][j] * time[DT_S][j];
                to[j] = box[j] = share ? box[j] + share[j] * (moved - box[j]) : moved;
            }
        }
        if (filter->learned) remember_step(&t, rate, time[IN_TENTHS], time[INVERSE]);
    }
}
