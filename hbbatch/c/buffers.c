#include "buffers.h"

void *refuse(const char *why) {
    PyErr_SetString(PyExc_ValueError, why);
    return NULL;
}

void release(Array *arrays, int count) {
    while (count > 0) PyBuffer_Release(&arrays[--count].view);
}

/* Whether a buffer holds numbers of a kind, where a processor may read them: d and f as they are, l
 * for 64-bit integers, b for bytes. */
static int holds(const Py_buffer *view, char kind) {
    const char *format = view->format ? view->format : "B";
    if (strlen(format) != 1 || (uintptr_t)view->buf % (size_t)view->itemsize) return 0;
    if (kind == 'l') return (*format == 'l' || *format == 'q') && view->itemsize == 8;
    return *format == (kind == 'b' ? 'B' : kind);
}

int take(Array *arrays, PyObject *const *given, Py_ssize_t count, const char *kinds, int scalars) {
    int wanted = (int)strlen(kinds) / 2;
    if (count != wanted + scalars) return refuse("wrong number of arguments"), -1;
    for (int i = 0; i < wanted; i++) {
        char kind = kinds[2 * i], lower = (char)(kind | 32);
        int flags = PyBUF_C_CONTIGUOUS | PyBUF_FORMAT | (kind == lower ? 0 : PyBUF_WRITABLE);
        Py_buffer *view = &arrays[i].view;
        if (PyObject_GetBuffer(given[i], view, flags)) return release(arrays, i), -1;
        if (!holds(view, lower) || view->ndim != kinds[2 * i + 1] - '0') {
            release(arrays, i + 1);
            return refuse("an array of another type or number of dimensions"), -1;
        }
        arrays[i].rows = view->ndim == 2 ? view->shape[0] : 1;
        arrays[i].columns = view->shape[view->ndim - 1];
    }
    return wanted;
}

int whole_number(PyObject *given, Py_ssize_t *value) {
    *value = PyNumber_AsSsize_t(given, PyExc_OverflowError);
    return *value != -1 || !PyErr_Occurred();
}

int number(PyObject *given, double *value) {
    *value = PyFloat_AsDouble(given);
    return *value != -1.0 || !PyErr_Occurred();
}

int within(const Array *indices, Py_ssize_t limit) {
    const int64_t *index = indices->view.buf;
    for (Py_ssize_t i = 0; i < indices->columns; i++)
        if (index[i] < 0 || index[i] >= limit) return 0;
    return 1;
}
