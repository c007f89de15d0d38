/* What rows.h declares. */
#include "rows.h"

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

Py_ssize_t settle(int64_t *cells, Py_ssize_t wide, Py_ssize_t n, const int64_t *rows,
                  int64_t *detections, Py_ssize_t matched, int64_t max_misses, int64_t *order,
                  int64_t *matched_by) {
    int64_t *patience = cells + PATIENCE * wide, *age = cells + AGE * wide;
    int64_t *misses = cells + MISSES * wide;
    Py_ssize_t missed = 0;
    for (Py_ssize_t i = 0; i < n; i++) age[i]++, misses[i]++;
    for (Py_ssize_t k = 0; k < matched; k++) {
        misses[rows[k]] = 0, patience[rows[k]] = max_misses;
        matched_by[rows[k]] = detections[k];
    }
    for (Py_ssize_t i = 0; i < n; i++) missed += misses[i] != 0;
    if (missed != n - matched) return -1;
    Py_ssize_t alive = sort_out(misses, patience, matched, n, order);
    for (Py_ssize_t i = 0; i < matched; i++) detections[i] = matched_by[order[i]];
    return alive;
}

Py_ssize_t moves(const int64_t *order, Py_ssize_t n, int64_t *from, int64_t *to) {
    Py_ssize_t moved = 0;
    for (Py_ssize_t i = 0; i < n; i++)
        if (order[i] != i) from[moved] = order[i], to[moved++] = i;
    return moved;
}

#define MOVE(type)                                                        \
    type *room = spare;                                                   \
    for (Py_ssize_t number = 0; moved && number < rows; number++) {       \
        type *row = matrix + number * wide;                               \
        for (Py_ssize_t k = 0; k < moved; k++) room[k] = row[from[k]];    \
        for (Py_ssize_t k = 0; k < moved; k++) row[to[k]] = room[k];      \
    }

void move_wide(uint64_t *matrix, Py_ssize_t rows, Py_ssize_t wide, const int64_t *from,
               const int64_t *to, Py_ssize_t moved, void *spare) {
    MOVE(uint64_t)
}

void move_narrow(uint32_t *matrix, Py_ssize_t rows, Py_ssize_t wide, const int64_t *from,
                 const int64_t *to, Py_ssize_t moved, void *spare) {
    MOVE(uint32_t)
}

void say(const Columns *columns, Py_ssize_t velocity, const int64_t *rows, const int64_t *places,
         Py_ssize_t n, double *boxes, double *velocities) {
    const float *speed = columns->state + velocity * columns->step;
    for (Py_ssize_t i = 0; i < n; i++) {
        Py_ssize_t row = rows ? rows[i] : i;
        double *box = boxes + BOX * places[i], *velocity_m_s = velocities + 3 * places[i];
        for (int packed = 0; packed < BOX; packed++)
            box[FIELD[packed]] = columns->boxes[packed * columns->box_step + row];
        for (int axis = 0; axis < 3; axis++)
            velocity_m_s[axis] = speed[axis * columns->step + row];
    }
}
