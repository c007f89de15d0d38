/* What state.h declares, and how states begin: packed.kalman, packed.hybrid. */
#include "state.h"

int lies_within(const Array *layout, const Array *state, int learned) {
    const int64_t *l = layout->view.buf;
    Py_ssize_t length = layout->columns - LAYOUT_LENGTH;
    if (length < 0 || length % 2 || l[ORDER] < 2 || l[ORDER] > 3) return 0;
    for (Py_ssize_t i = LAYOUT_LENGTH; i < layout->columns; i++)
        if (l[i] < 0 || l[i] >= blocks_of(l)) return 0;
    int extent[LAYOUT_LENGTH] = {
        [VELOCITY] = AXES, [ACCELERATION] = AXES * (int)(l[ORDER] - 2),
        [SIZE_VARIANCE] = 3 + AXES, [COVARIANCE] = AXES * (int)blocks_of(l), [VOTE] = 1,
        [NOISE] = AXES, [SIZE_NOISE] = 3, [CORRECTION] = BOX, [LOG_SIZE] = 3, [ELAPSED] = 2,
        [TENTHS] = 1, [HISTORY] = BOX, [Q] = AXES, [LEARNED] = 1, [COUNTERS] = 2, [INVERSE_DT] = 1,
    };
    for (int name = VELOCITY; name < (learned ? LAYOUT_LENGTH : CORRECTION); name++)
        if (l[name] < 0 || l[name] > state->rows - extent[name]) return 0;
    return l[COVARIANCE] == l[SIZE_VARIANCE] + 3 &&
           (!learned || (l[TENTHS] == l[ELAPSED] + 2 && l[VELOCITY] == l[TENTHS] + 1 &&
                         l[HISTORY] == l[VELOCITY] + AXES && l[HISTORY_END] >= l[HISTORY] + BOX &&
                         (l[HISTORY_END] - l[HISTORY]) % BOX == 0));
}

Tracks some(const Array *layout, const Array *boxes, const Array *state, Py_ssize_t start,
            Py_ssize_t all) {
    const int64_t *l = layout->view.buf;
    return (Tracks){l, (double *)boxes->view.buf + start, (float *)state->view.buf + start,
                    boxes->columns, state->columns, (layout->columns - LAYOUT_LENGTH) / 2,
                    blocks_of(l), (int)LEAST(all - start, BLOCK)};
}

void pick(const float *row, const int64_t *columns, int n, float *to) {
    for (int j = 0; j < n; j++) to[j] = row[columns[j]];
}

void of_detections(const float *seen, int number, const int64_t *detections, int n,
                   float *to) {
    for (int j = 0; j < n; j++) to[j] = seen[SEEN_ROWS * detections[j] + number];
}

void turn(float *x, float *y, const float *c, const float *s, float sign, int n) {
    for (int j = 0; j < n; j++) {
        float along = x[j] * c[j] - sign * (y[j] * s[j]);
        y[j] = y[j] * c[j] + sign * (x[j] * s[j]);
        x[j] = along;
    }
}

void heading(const double *yaw, float *c, float *s, int n) {
    for (int j = 0; j < n; j++) c[j] = cosf((float)yaw[j]), s[j] = sinf((float)yaw[j]);
}

void limit(float *features, Py_ssize_t step, const Array *high, Py_ssize_t rows, int n) {
    Py_ssize_t first = rows - high->columns;
    for (Py_ssize_t row = first; row < rows; row++) {
        float *value = features + row * step, most = ((const float *)high->view.buf)[row - first];
        for (int j = 0; j < n; j++) {
            float least = value[j] < -most ? -most : value[j];
            value[j] = least > most ? most : least;
        }
    }
}

void log_sizes(const Tracks *t) {
    for (int row = 0; row < 3; row++)
        for (int j = 0; j < t->n; j++)
            part(t, LOG_SIZE)[row * t->step + j] = logf((float)t->boxes[row * t->box_step + j]);
}

/* Whether detections are of kinds that there are. */
static int are_kinds(const int64_t *kinds, const Array *detections, Py_ssize_t count) {
    const int64_t *number = detections->view.buf;
    for (Py_ssize_t i = 0; i < detections->columns; i++)
        if (kinds[number[i]] < 0 || kinds[number[i]] >= count) return 0;
    return 1;
}

/* PackedKalman.birth, PackedHybrid.birth: columns from `first` on, begun by detections.
 * birth(layout, newborn, kinds, measured, seen, detections, boxes, state, first) */
FOR_EACH_PROCESSOR PyObject *birth(PyObject *module, PyObject *const *given, Py_ssize_t count) {
    (void)module;
    Array a[MOST_ARRAYS];
    int taken = take(a, given, count, "l1f2l1d2f2l1D2F2", 1);
    if (taken < 0) return NULL;
    Py_ssize_t first = PyNumber_AsSsize_t(given[8], PyExc_OverflowError), all = a[5].columns;
    if (PyErr_Occurred()) return release(a, taken), NULL;
    Array *layout = a, *newborn = a + 1, *measured = a + 3, *seen = a + 4, *boxes = a + 6;
    Array *state = a + 7;
    const int64_t *l = layout->view.buf, *kinds = a[2].view.buf, *detections = a[5].view.buf;
    int learned = layout->columns > CORRECTION && l[CORRECTION] >= 0;
    Py_ssize_t room = LEAST(boxes->columns, state->columns) - first;
    if (!lies_within(layout, state, learned) || boxes->rows != BOX || measured->columns != BOX ||
        seen->columns != SEEN_ROWS || newborn->rows != state->rows || first < 0 || room < all ||
        seen->rows != measured->rows || a[2].columns != measured->rows ||
        !within(a + 5, measured->rows) || !are_kinds(kinds, a + 5, newborn->columns))
        return release(a, taken), refuse("birth: shapes do not agree");
    for (Py_ssize_t start = 0; start < all; start += BLOCK) {
        Tracks t = some(layout, boxes, state, start, all);
        const int64_t *from = detections + start;
        t.boxes += first, t.state += first;
        for (Py_ssize_t row = 0; row < state->rows; row++) {
            const float *value = (const float *)newborn->view.buf + row * newborn->columns;
            for (int j = 0; j < t.n; j++) t.state[row * t.step + j] = value[kinds[from[j]]];
        }
        for (int row = 0; row < BOX; row++) {
            for (int j = 0; j < t.n; j++)
                t.boxes[row * t.box_step + j] =
                    ((const double *)measured->view.buf)[BOX * from[j] + FIELD[row]];
            of_detections(seen->view.buf, row, from, t.n, part(&t, SIZE_VARIANCE) + row * t.step);
        }
        for (int row = 0; learned && row < 3; row++)
            for (int j = 0; j < t.n; j++)
                part(&t, LOG_SIZE)[row * t.step + j] =
                    (float)log(MOST(t.boxes[row * t.box_step + j], SMALLEST_SIZE_M));
    }
    release(a, taken);
    Py_RETURN_NONE;
}
