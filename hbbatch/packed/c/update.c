/* PackedKalman.update and PackedHybrid.update. */
#include "state.h"

/* Measured minus prior boxes in the heading frame, that heading, and the agreement of both: a half
 * turn does not matter to the difference of yaws, but makes the agreement negative. */
static void innovate(const Tracks *t, const double *measured, const int64_t *detections,
                     float *apart, Py_ssize_t step) {
    for (int row = 0; row < YAW; row++)
        for (int j = 0; j < t->n; j++) {
            double seen = measured[BOX * detections[j] + FIELD[row]];
            apart[row * step + j] = (float)(seen - t->boxes[row * t->box_step + j]);
        }
    for (int j = 0; j < t->n; j++) {
        double by = measured[BOX * detections[j] + YAW] - t->boxes[YAW * t->box_step + j];
        double wrapped = fmod(by + 0.5 * PI, PI);
        apart[YAW * step + j] = (float)((wrapped < 0.0 ? wrapped + PI : wrapped) - 0.5 * PI);
        apart[AGREEMENT_ROW * step + j] = (float)cos(by);
    }
    float *c = apart + COS_ROW * step, *s = apart + SIN_ROW * step;
    heading(t->boxes + YAW * t->box_step, c, s, t->n);
    turn(apart + PLAN * step, apart + (PLAN + 1) * step, c, s, -1.0f, t->n);
}

/* What the gain network sees: shared rows, innovation, where from, spread of the axes. */
static void gain_features(const Tracks *t, const float *seen, const int64_t *detections,
                          const float *apart, float *features, Py_ssize_t step) {
    Py_ssize_t shared = t->layout[ELAPSED] + 2;
    size_t bytes = sizeof(float) * (size_t)t->n;
    for (Py_ssize_t row = 0; row < shared; row++)
        memcpy(features + row * step, t->state + row * t->step, bytes);
    features += shared * step;
    for (int row = 0; row < BOX; row++) memcpy(features + row * step, apart + row * step, bytes);
    features += BOX * step;
    for (int row = 0; row < FROM_SENSOR_ROWS; row++)
        of_detections(seen, VARIANCE_ROWS + row, detections, t->n, features + row * step);
    turn(features + 2 * step, features + 3 * step, apart + COS_ROW * step, apart + SIN_ROW * step,
         -1.0f, t->n);
    features += FROM_SENSOR_ROWS * step;
    for (int axis = 0; axis < AXES; axis++)
        for (int j = 0; j < t->n; j++)
            features[axis * step + j] = logf(part(t, COVARIANCE)[axis * t->step + j]);
}

/* Innovations and, with rows to write them to, features of PackedHybrid.update. */
PyObject *update_features(PyObject *module, PyObject *const *given, Py_ssize_t count) {
    (void)module;
    Array a[MOST_ARRAYS];
    int taken = take(a, given, count, "l1d2f2d2f2l1f1F2F2", 0);
    if (taken < 0) return NULL;
    Array *layout = a, *boxes = a + 1, *state = a + 2, *measured = a + 3, *seen = a + 4;
    Array *high = a + 6, *apart = a + 7, *out = a + 8;
    const int64_t *l = layout->view.buf;
    Py_ssize_t all = a[5].columns;
    int learned = out->rows > 0;
    if (!lies_within(layout, state, learned) || boxes->rows != BOX || boxes->columns < all ||
        state->columns < all || measured->columns != BOX || seen->columns != SEEN_ROWS ||
        seen->rows != measured->rows || !within(a + 5, seen->rows) || apart->rows != APART_ROWS ||
        apart->columns != all ||
        (learned && (out->columns != all || high->columns > out->rows ||
                     out->rows != l[ELAPSED] + 2 + BOX + FROM_SENSOR_ROWS + AXES)))
        return release(a, taken), refuse("update_features: shapes do not agree");
    for (Py_ssize_t start = 0; start < all; start += BLOCK) {
        Tracks t = some(layout, boxes, state, start, all);
        const int64_t *detections = (const int64_t *)a[5].view.buf + start;
        float *innovation = (float *)apart->view.buf + start;
        float *features = (float *)out->view.buf + start;
        innovate(&t, measured->view.buf, detections, innovation, all);
        if (!learned) continue;
        gain_features(&t, seen->view.buf, detections, innovation, features, all);
        limit(features, all, high, out->rows, t.n);
    }
    release(a, taken);
    Py_RETURN_NONE;
}

/* What the gain network said, (8, n) in [-1, 1]: of the next noise, and of this variance. */
static void scale_noise(const Tracks *t, const float *said, Py_ssize_t step, Rows variance) {
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
static void correct(const Tracks *t, const float *apart, Py_ssize_t step, Rows variance,
                    Rows change) {
    float *spread = part(t, SIZE_VARIANCE), gain[BLOCK];
    for (int row = SIZE; row < 3; row++, spread += t->step)
        for (int j = 0; j < t->n; j++) {
            double least = SMALLEST_SIZE_M - t->boxes[row * t->box_step + j];
            float share = spread[j] * (1.0f / (spread[j] + variance[row][j]));
            float by = share * apart[row * step + j];
            change[row][j] = by < least ? (float)least : by;
            spread[j] -= share * spread[j];
        }
    for (int axis = 0; axis < AXES; axis++)
        correct_axis(t, part(t, COVARIANCE) + axis * t->step, variance[MOTION + axis],
                     apart + (MOTION + axis) * step, change + MOTION + axis, gain);
}

/* Make changes, turned to the world's axes. */
static void apply(const Tracks *t, const float *apart, Py_ssize_t step, Rows change) {
    for (int d = 0; d < t->layout[ORDER]; d++)
        turn(change[MOTION + AXES * d], change[MOTION + AXES * d + 1], apart + COS_ROW * step,
             apart + SIN_ROW * step, 1.0f, t->n);
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
        float votes = vote[j] + copysignf(1.0f, agreement[j]);
        votes = LEAST(votes, MAX_HEADING_VOTE);
        /* By no turn or, where the vote is lost, a half turn; then wrapped to [-pi, pi). */
        double turned = fmod(yaw[j] - copysign(0.5 * PI, votes) + 1.5 * PI, 2.0 * PI);
        yaw[j] = (turned < 0.0 ? turned + 2.0 * PI : turned) - PI;
        vote[j] = fabsf(votes);
    }
}

/* What the learned filter remembers of a correction; rows of the memory come first. */
static void remember_update(const Tracks *t, const float *memory, Py_ssize_t step, Rows change) {
    float *history = part(t, HISTORY);
    const float *inverse = part(t, INVERSE_DT);
    size_t bytes = sizeof(float) * (size_t)t->n;
    for (Py_ssize_t row = 0; row < t->layout[ONE]; row++)
        memcpy(t->state + row * t->step, memory + row * step, bytes);
    for (int row = 0; row < BOX; row++)
        for (int j = 0; j < t->n; j++) history[row * t->step + j] += change[row][j] * inverse[j];
    memset(part(t, COUNTERS), 0, bytes);
    memset(part(t, ELAPSED), 0, bytes);
    log_sizes(t);
}

/* PackedKalman.update and, with the memory of the gain network and what it said, if it says
 * anything, PackedHybrid.update. */
PyObject *update(PyObject *module, PyObject *const *given, Py_ssize_t count) {
    (void)module;
    Array a[MOST_ARRAYS];
    int taken = take(a, given, count, "l1D2F2f2l1f2f2f2", 0);
    if (taken < 0) return NULL;
    Array *layout = a, *boxes = a + 1, *state = a + 2, *seen = a + 3, *apart = a + 5;
    Array *memory = a + 6, *said = a + 7;
    Py_ssize_t all = a[4].columns;
    int learned = memory->rows > 0, scales = said->rows > 0;
    if (!lies_within(layout, state, learned) || boxes->rows != BOX || boxes->columns < all ||
        state->columns < all || seen->columns != SEEN_ROWS || !within(a + 4, seen->rows) ||
        apart->rows != APART_ROWS || apart->columns != all ||
        (learned && (memory->columns != all ||
                     memory->rows < ((const int64_t *)layout->view.buf)[ONE])) ||
        (scales && (!learned || said->rows != 2 * AXES || said->columns != all)))
        return release(a, taken), refuse("update: shapes do not agree");
    for (Py_ssize_t start = 0; start < all; start += BLOCK) {
        Tracks t = some(layout, boxes, state, start, all);
        const int64_t *detections = (const int64_t *)a[4].view.buf + start;
        const float *innovation = (const float *)apart->view.buf + start;
        float variance[BOX][BLOCK], change[BOX + 2 * AXES][BLOCK];
        for (int row = 0; row < BOX; row++)
            of_detections(seen->view.buf, row, detections, t.n, variance[row]);
        if (scales) scale_noise(&t, (const float *)said->view.buf + start, all, variance);
        correct(&t, innovation, all, variance, change);
        for (int row = 0; learned && row < BOX; row++)
            memcpy(part(&t, CORRECTION) + row * t.step, change[row], sizeof(float) * (size_t)t.n);
        apply(&t, innovation, all, change);
        settle_heading(&t, innovation + AGREEMENT_ROW * all);
        if (learned) remember_update(&t, (const float *)memory->view.buf + start, all, change);
    }
    release(a, taken);
    Py_RETURN_NONE;
}
