/* The filters' steps on columns of tracks (packed.kalman, packed.hybrid). */
#ifndef HBBATCH_FILTER_H
#define HBBATCH_FILTER_H

#include "network.h"

/* Arrays of a filter (packed.arrays.FilterArrays): limits come before the layers of a network. */
enum {
    LAYOUT, NEWBORN, RESIDUAL_LIMIT, RESIDUAL_LAYERS, GAIN_LIMIT = RESIDUAL_LAYERS + 3, GAIN_LAYERS,
    FILTER_ARRAYS = GAIN_LAYERS + 4
};

/* The classical filter has no layers, and one that was not taught to speak of noise no read-out. */
typedef struct {
    const int64_t *layout;
    Py_ssize_t mixed;
    int learned;
    const Array *newborn, *residual_limit, *gain_limit;
    Layer residual[3], gain[4];
} Filter;

/* What is known beforehand: of all frames (packed.kalman.PackedKalman.times) and all detections. */
typedef struct {
    const Array *times;
    const double *measured;
    const float *seen;
    const int64_t *kinds;
} Known;

/* The filter of these arrays; whether they fit together. */
int filter_of(const Array *arrays, Filter *filter);

/* At most a block of columns from `start` on, where there are `all`. */
Tracks some(const Filter *filter, const Columns *columns, Py_ssize_t start, Py_ssize_t all);

/* The first n columns go on to their frames, centres by a share of the way if shares are given;
 * prior boxes, in the order of a box's fields, are written to (7, n). */
void predict(const Filter *filter, const Columns *columns, const Known *known,
             const int64_t *frames, const double *shares, double *prior, Py_ssize_t n);

/* The first n columns are corrected by these detections. */
void update(const Filter *filter, const Columns *columns, const Known *known,
            const int64_t *detections, Py_ssize_t n);

/* n columns from `first` on are begun by these detections. */
void birth(const Filter *filter, const Columns *columns, const Known *known,
           const int64_t *detections, Py_ssize_t first, Py_ssize_t n);

#endif
