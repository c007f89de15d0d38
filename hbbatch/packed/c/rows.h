/* Bookkeeping of tracks: the table of tracking.rows, columns moved, boxes said. */
#ifndef HBBATCH_ROWS_H
#define HBBATCH_ROWS_H

#include "filter.h"

/* Rows of the table; columns as many as those of boxes and states. */
enum { FIRST, SEQUENCE, TRACK_BLOCK, PATIENCE, AGE, MISSES, CELL_ROWS };

/* Count a step (tracking.rows.RowTable.settle) of the first n of `wide` columns: rows that are
 * matched come first in the order, those that die last; detections are put in the order of their
 * rows. How many live on, -1 if a row is matched twice. `spare` is room for n. */
Py_ssize_t settle(int64_t *cells, Py_ssize_t wide, Py_ssize_t n, const int64_t *rows,
                  int64_t *detections, Py_ssize_t matched, int64_t patience, int64_t *order,
                  int64_t *spare);

/* Columns that an order of n moves: from where and where to. How many. */
Py_ssize_t moves(const int64_t *order, Py_ssize_t n, int64_t *from, int64_t *to);

/* Make so many moves in a matrix of numbers of 8 or 4 bytes; `spare` is room for them. */
void move(const Array *matrix, const int64_t *from, const int64_t *to, Py_ssize_t moved,
          void *spare);

/* Boxes (7), in the order of their fields, and velocities (3), from that row of the state on, of so
 * many columns; of column rows[i], or i without rows, to place places[i]. */
void say(const Columns *columns, Py_ssize_t velocity, const int64_t *rows, const int64_t *places,
         Py_ssize_t n, double *boxes, double *velocities);

#endif
