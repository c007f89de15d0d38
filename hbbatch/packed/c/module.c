/* The lock step, compiled, and what else is done for each box. What a function computes is defined
 * by the Python named beside it. No state is kept between calls; filters' scratch is rows of BLOCK
 * columns on the stack. Metres, seconds, radians.
 */
#include "arrays.h"

static PyMethodDef methods[] = {
    METHOD(match),
    METHOD(steps),
    METHOD(lines),
    METHOD(local_fit),
    {NULL, NULL, 0, NULL},
};

static PyModuleDef_Slot slots[] = {{0, NULL}};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "_kernels", NULL, 0, methods, slots, NULL, NULL, NULL,
};

PyMODINIT_FUNC PyInit__kernels(void) { return PyModuleDef_Init(&definition); }
