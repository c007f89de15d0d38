/* Association: tracking.association.match with the cost ciou_3d. */
#ifndef HBBATCH_MATCH_H
#define HBBATCH_MATCH_H

#include "arrays.h"

/* What a pair may cost: how far a box can be matched, over half its diagonal
 * (costs.reach_over_radius), and the cost that is too much. */
typedef struct {
    double stretch, threshold;
} Affordable;

/* n tracks: prior boxes (7, n), blocks, and who goes first where costs are equal. */
typedef struct {
    const double *boxes;
    const int64_t *block, *rank;
    Py_ssize_t n;
} Priors;

/* Pairs of tracks and of the detections from start to stop, both of the same block: row and number
 * of each are written, the cheapest first. How many there are; -1 without memory. */
Py_ssize_t match_boxes(Priors tracks, const double *boxes, const int64_t *block, Py_ssize_t start,
                       Py_ssize_t stop, Affordable most, int64_t *rows, int64_t *numbers);

#endif
