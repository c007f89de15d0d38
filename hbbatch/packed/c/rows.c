/* Bookkeeping of tracks: columns moved, counted, begun and said; parts of the networks. */
#include "arrays.h"

/* Rows of the table of tracks (tracking.rows). */
enum { PATIENCE = 3, AGE, MISSES, CELL_ROWS };

/* Rows that were matched first, those that live on next, dying ones last; a row stays where it is as
 * far as that allows, for moving it costs more than all else. How many live on. */
static Py_ssize_t sort_out(const int64_t *misses, const int64_t *patience, Py_ssize_t matched,
                           Py_ssize_t n, int64_t *order) {
    Py_ssize_t from = matched, last = n;
    for (Py_ssize_t i = 0; i < n; i++) order[i] = i;
    for (Py_ssize_t i = 0; i < matched; i++) {
        if (!misses[i]) continue;
        while (misses[from]) from++;
        order[i] = from, order[from++] = i;
    }
    while (matched < last) {
        int64_t row = order[matched];
        if (misses[row] < patience[row]) matched++;
        else order[matched] = order[--last], order[last] = row;
    }
    return matched;
}

/* settle(cells, matched, detections, order, count, patience) -> how many live on; detections are
 * put in the order of their rows; tracking.rows.settle_any. */
FOR_EACH_PROCESSOR PyObject *settle(PyObject *module, PyObject *const *given, Py_ssize_t count) {
    (void)module;
    Array a[MOST_ARRAYS];
    int taken = take(a, given, count, "L2l1L1L1", 2);
    if (taken < 0) return NULL;
    Py_ssize_t n = PyNumber_AsSsize_t(given[4], PyExc_OverflowError), wide = a[0].columns;
    Py_ssize_t max_misses = PyNumber_AsSsize_t(given[5], PyExc_OverflowError);
    Py_ssize_t matched = a[1].columns, alive = 0, missed = 0;
    if (PyErr_Occurred()) return release(a, taken), NULL;
    if (a[0].rows != CELL_ROWS || n < 0 || n > wide || matched > n || a[2].columns != matched ||
        a[3].columns != n || !within(a + 1, n))
        return release(a, taken), refuse("settle: shapes do not agree");
    int64_t *patience = (int64_t *)a[0].view.buf + PATIENCE * wide, *age = patience + wide;
    int64_t *misses = age + wide, *detections = a[2].view.buf, *order = a[3].view.buf;
    const int64_t *rows = a[1].view.buf;
    int64_t *matched_by = PyMem_Calloc((size_t)n + 1, sizeof(int64_t));
    if (!matched_by) return release(a, taken), PyErr_NoMemory();
    for (Py_ssize_t i = 0; i < n; i++) age[i]++, misses[i]++;
    for (Py_ssize_t k = 0; k < matched; k++) {
        misses[rows[k]] = 0, patience[rows[k]] = max_misses;
        matched_by[rows[k]] = detections[k];
    }
    for (Py_ssize_t i = 0; i < n; i++) missed += misses[i] != 0;
    if (missed == n - matched) {
        alive = sort_out(misses, patience, matched, n, order);
        for (Py_ssize_t i = 0; i < matched; i++) detections[i] = matched_by[order[i]];
    } else {
        refuse("settle: a row is matched twice");
    }
    PyMem_Free(matched_by);
    release(a, taken);
    return PyErr_Occurred() ? NULL : PyLong_FromSsize_t(alive);
}

/* Of a row of numbers, take those at `from` to the places `to`; `spare` has room for them. */
#define MOVE(type)                                                                \
    do {                                                                          \
        type *row = (type *)a[0].view.buf + number * wide, *spare = (type *)room; \
        for (Py_ssize_t k = 0; k < moved; k++) spare[k] = row[from[k]];           \
        for (Py_ssize_t k = 0; k < moved; k++) row[to[k]] = spare[k];             \
    } while (0)

/* arrange(matrix, order): column order[i] becomes column i; numbers of 4 or 8 bytes. */
FOR_EACH_PROCESSOR PyObject *arrange(PyObject *module, PyObject *const *given, Py_ssize_t count) {
    (void)module;
    Array a[MOST_ARRAYS];
    int taken = take(a, given, count, "X2l1", 0);
    if (taken < 0) return NULL;
    Py_ssize_t wide = a[0].columns, n = a[1].columns, moved = 0;
    if (n > wide || !within(a + 1, wide))
        return release(a, taken), refuse("arrange: shapes do not agree");
    const int64_t *order = a[1].view.buf;
    int64_t *room = PyMem_Malloc(3 * sizeof(int64_t) * (size_t)(n + 1));
    if (!room) return release(a, taken), PyErr_NoMemory();
    int64_t *from = room + n, *to = from + n;
    for (Py_ssize_t i = 0; i < n; i++)
        if (order[i] != i) from[moved] = order[i], to[moved++] = i;
    for (Py_ssize_t number = 0; moved && number < a[0].rows; number++) {
        if (a[0].view.itemsize == 8) MOVE(uint64_t);
        else MOVE(uint32_t);
    }
    PyMem_Free(room);
    release(a, taken);
    Py_RETURN_NONE;
}

/* say(boxes, state, rows, places, said_boxes, said_velocity, velocity): box, in the order of its
 * fields, and velocity (from that row of the state on) of each track to its place. */
FOR_EACH_PROCESSOR PyObject *say(PyObject *module, PyObject *const *given, Py_ssize_t count) {
    (void)module;
    static const int packed[7] = {3, 4, 5, 0, 1, 2, 6};
    Array a[MOST_ARRAYS];
    int taken = take(a, given, count, "d2f2l1l1D2D2", 1);
    if (taken < 0) return NULL;
    Py_ssize_t velocity = PyNumber_AsSsize_t(given[6], PyExc_OverflowError), n = a[2].columns;
    if (PyErr_Occurred()) return release(a, taken), NULL;
    if (a[0].rows != 7 || velocity < 0 || velocity > a[1].rows - 3 || a[3].columns != n ||
        a[4].columns != 7 || a[5].columns != 3 ||
        !within(a + 2, LEAST(a[0].columns, a[1].columns)) ||
        !within(a + 3, LEAST(a[4].rows, a[5].rows)))
        return release(a, taken), refuse("say: shapes do not agree");
    const double *boxes = a[0].view.buf;
    const float *speed = (const float *)a[1].view.buf + velocity * a[1].columns;
    const int64_t *rows = a[2].view.buf, *places = a[3].view.buf;
    for (Py_ssize_t i = 0; i < n; i++) {
        double *box = (double *)a[4].view.buf + 7 * places[i];
        double *velocity_m_s = (double *)a[5].view.buf + 3 * places[i];
        for (int field = 0; field < 7; field++)
            box[field] = boxes[packed[field] * a[0].columns + rows[i]];
        for (int axis = 0; axis < 3; axis++)
            velocity_m_s[axis] = speed[axis * a[1].columns + rows[i]];
    }
    release(a, taken);
    Py_RETURN_NONE;
}
