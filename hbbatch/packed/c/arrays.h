/* Arrays of tracks and detections: a row a quantity and a column a track or detection. Matrices of
 * tracks may be wider than there are tracks.
 */
#ifndef HBBATCH_ARRAYS_H
#define HBBATCH_ARRAYS_H

#include "buffers.h"
#include "elementary.h"
#include <math.h>
#include <stdlib.h>

#define UNROLLED _Pragma("GCC unroll 16")

/* What the module offers. */
typedef PyObject *Kernel(PyObject *module, PyObject *const *given, Py_ssize_t count);
Kernel match, steps, lines, local_fit;

#endif
