/* What rows.h declares. */
#include "rows.h"

/* Rows that were matched first, those that live on next, dying ones last; a row stays where it is
 * as far as that allows, for moving it costs more than all else. How many live on. */
static Py_ssize_t sort_out(const int64_t *matched_by, const int64_t *misses,
                           const int64_t *patience, Py_ssize_t matched, Py_ssize_t n,
                           int64_t *order) {
    Py_ssize_t from = matched, last = n;
    for (Py_ssize_t i = 0; i < n; i++) order[i] = i;
    for (Py_ssize_t i = 0; i < matched; i++) {
        if (matched_by[i] >= 0) continue;
        while (matched_by[from] < 0) from++;
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
    for (Py_ssize_t i = 0; i < n; i++) age[i]++, misses[i]++, matched_by[i] = -1;
    for (Py_ssize_t k = 0; k < matched; k++) {
        if (matched_by[rows[k]] >= 0) return -1;
        misses[rows[k]] = 0, patience[rows[k]] = max_misses;
        matched_by[rows[k]] = detections[k];
    }
    Py_ssize_t alive = sort_out(matched_by, misses, patience, matched, n, order);
    for (Py_ssize_t i = 0; i < matched; i++) detections[i] = matched_by[order[i]];
    return alive;
}

Py_ssize_t moves(const int64_t *order, Py_ssize_t n, int64_t *from, int64_t *to) {
    Py_ssize_t moved = 0;
    for (Py_ssize_t i = 0; i < n; i++)
        if (order[i] != i) from[moved] = order[i], to[moved++] = i;
    return moved;
}

/* Numbers of so many bytes, whatever they are. */
static inline void move_numbers(char *matrix, size_t size, Py_ssize_t rows, Py_ssize_t wide,
                                const int64_t *from, const int64_t *to, Py_ssize_t moved,
                                char *spare) {
    for (Py_ssize_t number = 0; number < rows; number++, matrix += size * (size_t)wide) {
        for (Py_ssize_t k = 0; k < moved; k++)
            memcpy(spare + size * (size_t)k, matrix + size * (size_t)from[k], size);
        for (Py_ssize_t k = 0; k < moved; k++)
            memcpy(matrix + size * (size_t)to[k], spare + size * (size_t)k, size);
    }
}

void move(const Array *matrix, const int64_t *from, const int64_t *to, Py_ssize_t moved,
          void *spare) {
    char *numbers = matrix->view.buf;
    Py_ssize_t rows = moved ? matrix->rows : 0, wide = matrix->columns;
    if (matrix->view.itemsize == 8) move_numbers(numbers, 8, rows, wide, from, to, moved, spare);
    else move_numbers(numbers, 4, rows, wide, from, to, moved, spare);
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
