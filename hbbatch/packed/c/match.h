/* Association: tracking.association.match with the cost ciou_3d. */
#ifndef HBBATCH_MATCH_H
#define HBBATCH_MATCH_H

#include "arrays.h"

/* What a pair may cost: how far a box can be matched, over half its diagonal
 * (costs.reach_over_radius), and the cost that is too much. */
typedef struct {
    double stretch, threshold;
} Affordable;

/* Pairs of tracks, whose prior boxes are (7, tracks), and of the detections from start to stop, both
 * of the same block: row and number of each are written, the cheapest first. How many there are;
 * -1 without memory. */
Py_ssize_t match_boxes(const double *priors, const int64_t *track_block, Py_ssize_t tracks,
                       const double *boxes, const int64_t *block, Py_ssize_t start,
                       Py_ssize_t stop, Affordable most, int64_t *rows, int64_t *numbers);

#endif
