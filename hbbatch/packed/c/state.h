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

/* Boxes and states of tracks, a column each; there may be more columns than tracks. */
typedef struct {
    double *boxes;
    float *state;
    Py_ssize_t box_step, step;
} Columns;

/* Some of them, at most a block. */
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

/* Values of some columns, named by number. */
static inline void pick(const float *row, const int64_t *columns, int n, float *to) {
    for (int j = 0; j < n; j++) to[j] = row[columns[j]];
}

/* What is known of some detections. */
static inline void of_detections(const float *seen, int number, const int64_t *detections, int n,
                                 float *to) {
    for (int j = 0; j < n; j++) to[j] = seen[SEEN_ROWS * detections[j] + number];
}

/* Turn vectors by a heading, or back by it with the sign -1. */
static inline void turn(float *x, float *y, const float *c, const float *s, float sign, int n) {
    for (int j = 0; j < n; j++) {
        float along = x[j] * c[j] - sign * (y[j] * s[j]);
        y[j] = y[j] * c[j] + sign * (x[j] * s[j]);
        x[j] = along;
    }
}

/* Cosine and sine of headings. */
static inline void heading(const double *yaw, float *c, float *s, int n) {
    for (int j = 0; j < n; j++) {
        double cosine, sine;
        cosine_and_sine(yaw[j], &cosine, &sine);
        c[j] = (float)cosine, s[j] = (float)sine;
    }
}

/* Cut rows at what training saw; `high` has a limit for each of the last rows. */
static inline void limit(float *features, Py_ssize_t step, const Array *high, Py_ssize_t rows,
                         int n) {
    Py_ssize_t first = rows - high->columns;
    for (Py_ssize_t row = first; row < rows; row++) {
        float *value = features + row * step, most = ((const float *)high->view.buf)[row - first];
        for (int j = 0; j < n; j++) {
            float least = value[j] < -most ? -most : value[j];
            value[j] = least > most ? most : least;
        }
    }
}

/* Logarithms of the sizes, which the networks see. */
static inline void log_sizes(const Tracks *t) {
    for (int row = 0; row < 3; row++)
        for (int j = 0; j < t->n; j++)
            part(t, LOG_SIZE)[row * t->step + j] =
                logarithm((float)t->boxes[row * t->box_step + j]);
}

#endif
