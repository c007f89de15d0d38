/* Arrays that come from Python, by the buffer protocol: C-contiguous, of one type each, a row a
 * quantity and a column a track or detection. Matrices of tracks may be wider than there are
 * tracks. Whatever would lead beyond an array is refused with ValueError.
 */
#ifndef HBBATCH_ARRAYS_H
#define HBBATCH_ARRAYS_H

#define Py_LIMITED_API 0x030B0000
#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#define PI 3.14159265358979323846
#define LEAST(a, b) ((a) < (b) ? (a) : (b))
#define MOST(a, b) ((a) > (b) ? (a) : (b))

enum { MOST_ARRAYS = 12 };

typedef struct {
    Py_buffer view;
    Py_ssize_t rows, columns;
} Array;

/* Set ValueError; NULL. */
void *refuse(const char *why);

/* Give back the first so many arrays. */
void release(Array *arrays, int count);

/* The arrays that a call begins with: `kinds` has a type and a number of dimensions for each, as
 * "d2l1"; types in upper case are written to, l are 64-bit integers, b bytes. `scalars` more
 * arguments must follow. How many arrays there are, to be released; -1 with an exception set. */
int take(Array *arrays, PyObject *const *given, Py_ssize_t count, const char *kinds, int scalars);

/* Whether all indices lie in [0, limit). */
int within(const Array *indices, Py_ssize_t limit);

/* What the module offers. */
typedef PyObject *Kernel(PyObject *module, PyObject *const *given, Py_ssize_t count);
Kernel match, settle, arrange, say, birth, predict_features, predict, update_features, update;
Kernel rectify, reset_memory, mix_memory, lines;

#endif
