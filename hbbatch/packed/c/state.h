/* States of tracks: where their parts are, and what all steps of the filters do with them. */
#ifndef HBBATCH_STATE_H
#define HBBATCH_STATE_H

#include "arrays.h"

/* What the filters' modules and these kernels must agree on (motion.constants). */
#define SMALLEST_SIZE_M 0.05
#define MAX_HEADING_VOTE 5.0f
#define LONGEST_TENTHS 20.0f
#define LARGEST_SAID 4.0f

/* A state's layout (packed.layout): first rows of its parts, and what else the steps depend on;
 * then pairs of covariance blocks, one added to the other when time passes. The parts from
 * CORRECTION on are -1 for the classical filter. */
enum {
    ORDER, TURNS, VELOCITY, ACCELERATION, SIZE_VARIANCE, COVARIANCE, VOTE, NOISE, SIZE_NOISE,
    CORRECTION, ONE, LOG_SIZE, ELAPSED, TENTHS, HISTORY, HISTORY_END, Q, LEARNED, COUNTERS,
    INVERSE_DT, LAYOUT_LENGTH
};
enum { DT_S, HALF_S, IN_TENTHS, INVERSE, WEIGHTS }; /* packed.kalman.Times */
enum { SIZE = 0, PLAN = 3, MOTION = 3, YAW = 6, BOX = 7, AXES = 4, BLOCK = 64 };
enum { SAID = 3 }; /* motion.constants.RESIDUAL_UNIT */
enum { COS_ROW = 7, SIN_ROW, AGREEMENT_ROW, APART_ROWS }; /* after an innovation */
enum { VARIANCE_ROWS = BOX, FROM_SENSOR_ROWS = 4, SEEN_ROWS = 11 }; /* packed.kalman.DETECTION */
enum { GAIN_ROWS = BOX + FROM_SENSOR_ROWS + AXES }; /* packed.features.update_features */

/* Where a packed box (packed.arrays.PACKED) has the fields of a box, and these it. */
static const int FIELD[BOX] = {3, 4, 5, 0, 1, 2, 6};

typedef float Rows[][BLOCK];

/* Some columns of the boxes and states of tracks. */
typedef struct {
    const int64_t *layout;
    double *boxes;
    float *state;
    Py_ssize_t box_step, step, mixed, blocks;
    int n;
} Tracks;

static inline float *part(const Tracks *t, int name) {
    return t->state + t->layout[name] * t->step;
}

static inline Py_ssize_t blocks_of(const int64_t *layout) {
    return layout[ORDER] * (layout[ORDER] + 1) / 2;
}

/* Whether a layout's parts lie within a state, and those that networks see side by side. */
int lies_within(const Array *layout, const Array *state, int learned);

/* Columns from `start` on, at most a block of `all`. */
Tracks some(const Array *layout, const Array *boxes, const Array *state, Py_ssize_t start,
           Py_ssize_t all);

/* Values of some columns, named by number. */
void pick(const float *row, const int64_t *columns, int n, float *to);

/* What is known of some detections. */
void of_detections(const float *seen, int number, const int64_t *detections, int n, float *to);

/* Turn vectors by a heading, or back by it with the sign -1. */
void turn(float *x, float *y, const float *c, const float *s, float sign, int n);

/* Cosine and sine of headings. */
void heading(const double *yaw, float *c, float *s, int n);

/* Cut rows at what training saw; `high` has a limit for each of the last rows. */
void limit(float *features, Py_ssize_t step, const Array *high, Py_ssize_t rows, int n);

/* Logarithms of the sizes, which the networks see. */
void log_sizes(const Tracks *t);

#endif
