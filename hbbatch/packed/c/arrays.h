/* Arrays of tracks and detections: a row a quantity and a column a track or detection. Matrices of
 * tracks may be wider than there are tracks.
 */
#ifndef HBBATCH_ARRAYS_H
#define HBBATCH_ARRAYS_H

#include "buffers.h"
#include <math.h>
#include <stdlib.h>

#define PI 3.14159265358979323846

/* What the module offers. */
typedef PyObject *Kernel(PyObject *module, PyObject *const *given, Py_ssize_t count);
Kernel match, settle, arrange, say, birth, predict, update, lines, local_fit;

#endif
