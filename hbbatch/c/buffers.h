/* Arrays that come from Python, by the buffer protocol: C-contiguous, of one type each. Whatever
 * would lead beyond an array is refused with ValueError.
 */
#ifndef HBBATCH_BUFFERS_H
#define HBBATCH_BUFFERS_H

#define Py_LIMITED_API 0x030B0000
#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <stdint.h>
#include <string.h>

#define LEAST(a, b) ((a) < (b) ? (a) : (b))
#define MOST(a, b) ((a) > (b) ? (a) : (b))
#define METHOD(name) {#name, (PyCFunction)(void (*)(void))name, METH_FASTCALL, NULL}

/* Compiled twice, with all that it calls: for processors with AVX2, and for all others of the kind. */
#if defined(__x86_64__) && defined(__GNUC__) && defined(__gnu_linux__) && defined(__GLIBC__)
#define FOR_EACH_PROCESSOR __attribute__((flatten, target_clones("avx2", "default")))
#else
#define FOR_EACH_PROCESSOR
#endif

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

/* What an argument after them says; 0 with an exception set if it is no number. */
int whole_number(PyObject *given, Py_ssize_t *value);
int number(PyObject *given, double *value);

/* Whether all indices lie in [0, limit). */
int within(const Array *indices, Py_ssize_t limit);

#endif
