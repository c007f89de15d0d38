/* What a lock step does between matrix products, compiled: each step's element-wise work in one
 * pass. What a function computes is defined by the Python named beside it.
 *
 * Arrays come through the buffer protocol: C-contiguous, of one type each, a row a quantity and a
 * column a track or detection. Matrices of tracks may be wider than there are tracks. Whatever
 * would lead beyond an array is refused with ValueError before anything is written. No state is
 * kept between calls; scratch is a few rows of BLOCK columns on the stack. Metres, seconds, radians.
 */
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

/* ---- arguments ---- */

enum { MOST_ARRAYS = 12 };

typedef struct {
    Py_buffer view;
    Py_ssize_t rows, columns;
} Array;

static void *refuse(const char *why) {
    PyErr_SetString(PyExc_ValueError, why);
    return NULL;
}

static void release(Array *arrays, int count) {
    while (count > 0) PyBuffer_Release(&arrays[--count].view);
}

/* Whether a buffer holds numbers of a kind: d and f as they are, l for 64-bit integers. */
static int holds(const Py_buffer *view, char kind) {
    const char *format = view->format ? view->format : "B";
    if (strlen(format) != 1) return 0;
    if (kind == 'l') return (*format == 'l' || *format == 'q') && view->itemsize == 8;
    return *format == kind;
}

/* The arrays that a call begins with: `kinds` has a type and a number of dimensions for each, as
 * "d2l1"; types in upper case are written to. `scalars` more arguments must follow. */
static int take(Array *arrays, PyObject *const *given, Py_ssize_t count, const char *kinds,
                int scalars) {
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

/* ---- association: tracking.association.match with the cost ciou_3d ---- */

/* Rows of tracking.costs.shapes_of. */
enum { Z, X, Y, COS, SIN, MINUS_SIN, HALF_L, HALF_W, HALF_H, AREA, VOLUME, ASPECT, SHAPE_ROWS };

/* tracking.costs.shapes_of, of one box whose numbers lie `step` apart. */
static void shape_of(const double *box, size_t step, double *shape) {
    double length = box[3 * step], width = box[4 * step], height = box[5 * step];
    shape[X] = box[0], shape[Y] = box[step], shape[Z] = box[2 * step];
    shape[COS] = cos(box[6 * step]), shape[SIN] = sin(box[6 * step]);
    shape[MINUS_SIN] = -shape[SIN];
    shape[HALF_L] = 0.5 * length, shape[HALF_W] = 0.5 * width, shape[HALF_H] = 0.5 * height;
    shape[AREA] = length * width, shape[VOLUME] = shape[AREA] * height;
    shape[ASPECT] = atan2(length, width);
}

/* overlap.rectangle_intersection, m2: pose of the first rectangle in the frame of the second. */
static double shared_area(const double pose[4], const double first[2], const double second[2]) {
    double c = pose[2], s = pose[3], area = 0.0, upright = 0.0;
    double half[2][2] = {{first[0] * (1.0 + 1e-9), first[1] * (1.0 + 1e-9)}, {second[0], second[1]}};
    /* turn[axis][rectangle][along or across], centre[axis][rectangle] in the frame of the other */
    double turn[2][2][2] = {{{c, -s}, {c, s}}, {{s, c}, {-s, c}}};
    double centre[2][2] = {{pose[0], -(pose[0] * c + pose[1] * s)},
                           {pose[1], -(pose[1] * c - pose[0] * s)}};
    for (int which = 0; which < 8; which++) {
        int rect = which >> 2, along = which >> 1 & 1, side = which & 1;
        double middle[2], edge[2], to = 1.0, back = 1.0, length;
        for (int axis = 0; axis < 2; axis++) {
            double other = turn[axis][rect][1 - along] * half[rect][1 - along];
            edge[axis] = turn[axis][rect][along] * half[rect][along];
            middle[axis] = centre[axis][rect] + (side ? -other : other);
            double inverse = 1.0 / (edge[axis] + 1e-300), at = middle[axis] * inverse;
            double reach = fabs(inverse) * half[1 - rect][axis];
            to = LEAST(to, at + reach), back = LEAST(back, reach - at);
        }
        length = MOST(to + back, 0.0);
        if (rect) upright += length;
        else
            area += (along == side ? -1.0 : 1.0) * length *
                    (middle[0] * edge[1] - middle[1] * edge[0]);
    }
    return MOST(0.5 * (area + upright * second[0] * second[1]), 0.0);
}

/* tracking.costs.ciou_3d of a prior and a detection, whose rows lie `step` apart. */
static double ciou_3d(const double *prior, const double *detection, size_t step) {
    double d[SHAPE_ROWS], far = 0.0, span = 0.0, least = INFINITY, overlap = 0.0, shared = 0.0;
    for (int row = 0; row < SHAPE_ROWS; row++) d[row] = detection[row * step];
    double dx = d[X] - prior[X], dy = d[Y] - prior[Y], c = prior[COS], s = prior[SIN];
    double pose[4] = {dx * c + dy * s, dy * c - dx * s, d[COS] * c + d[SIN] * s,
                      d[SIN] * c - d[COS] * s};
    double cos_by = fabs(pose[2]), sin_by = fabs(pose[3]);
    double distance[3] = {fabs(pose[0]), fabs(pose[1]), fabs(d[Z] - prior[Z])};
    double half[3] = {d[HALF_L] * cos_by + d[HALF_W] * sin_by,
                      d[HALF_W] * cos_by + d[HALF_L] * sin_by, d[HALF_H]};
    for (int axis = 0; axis < 3; axis++) {
        double own = prior[HALF_L + axis], reach = own + half[axis];
        double apart = MOST(fabs(half[axis] - own), distance[axis]);
        far += distance[axis] * distance[axis];
        span += (reach + apart) * (reach + apart);
        overlap = reach - apart;
        least = LEAST(least, overlap);
    }
    if (least > 0.0) shared = shared_area(pose, d + HALF_L, prior + HALF_L) * overlap;
    double rest = 1.0 - shared / (prior[VOLUME] + d[VOLUME] - shared);
    double v = prior[ASPECT] - d[ASPECT];
    v *= v * (4.0 / (PI * PI));
    return v * v / MOST(v + rest, 1e-12) + rest + far / span;
}

typedef struct {
    double cost;
    Py_ssize_t track, place;
} Pair;

static int cheaper(const void *first, const void *second) {
    const Pair *a = first, *b = second;
    if (a->cost != b->cost) return a->cost < b->cost ? -1 : 1;
    if (a->track != b->track) return a->track < b->track ? -1 : 1;
    return (a->place > b->place) - (a->place < b->place);
}

typedef struct {
    const double *shapes, *reach, *key;
    Py_ssize_t count, start, stop;
    double widest, low, high, stretch, threshold;
} Targets;

/* tracking.association._key of one x. */
static double key_of(const Targets *t, double x, int64_t block) {
    return LEAST(MOST(x, t->low - 1.0), t->high + 1.0) + (double)block * (t->high - t->low + 3.0);
}

/* First place from `start` whose key is not below a value; keys ascend. */
static Py_ssize_t first_from(const Targets *t, double value) {
    Py_ssize_t low = t->start, high = t->stop;
    while (low < high) {
        Py_ssize_t middle = low + (high - low) / 2;
        if (t->key[middle] < value) low = middle + 1;
        else high = middle;
    }
    return low;
}

/* All pairs cheaper than the threshold, unsorted; their number, -1 without memory. */
static Py_ssize_t affordable(const Targets *t, const double *fields, const int64_t *block,
                             Py_ssize_t tracks, Pair **pairs, Py_ssize_t room) {
    Py_ssize_t found = 0;
    for (Py_ssize_t i = 0; i < tracks; i++) {
        double shape[SHAPE_ROWS];
        shape_of(fields + i, (size_t)tracks, shape);
        const double *half = shape + HALF_L;
        double own = half[0] * half[0] + half[1] * half[1] + half[2] * half[2];
        double reach = t->stretch * sqrt(own), strip = reach + t->widest;
        double end = key_of(t, shape[X] + strip, block[i]);
        Py_ssize_t place = first_from(t, key_of(t, shape[X] - strip, block[i]));
        for (; place < t->stop && t->key[place] < end; place++) {
            double dx = shape[X] - t->shapes[X * t->count + place];
            double dy = shape[Y] - t->shapes[Y * t->count + place], both = reach + t->reach[place];
            if (!(dx * dx + dy * dy < both * both)) continue;
            double cost = ciou_3d(shape, t->shapes + place, (size_t)t->count);
            if (!(cost < t->threshold)) continue;
            if (found == room) {
                Pair *more = PyMem_Realloc(*pairs, sizeof(Pair) * (size_t)(room *= 2));
                if (!more) return -1;
                *pairs = more;
            }
            (*pairs)[found++] = (Pair){cost, i, place};
        }
    }
    return found;
}

/* tracking.association.greedy: free pairs from the cheapest on, written as rows and numbers. */
static Py_ssize_t choose(const Pair *pairs, Py_ssize_t found, const Targets *t,
                         const int64_t *order, Py_ssize_t tracks, char *taken, int64_t *rows,
                         int64_t *numbers) {
    Py_ssize_t matched = 0;
    for (Py_ssize_t k = 0; k < found; k++) {
        char *track = taken + pairs[k].track, *place = taken + tracks + pairs[k].place - t->start;
        if (*track || *place) continue;
        *track = *place = 1;
        rows[matched] = pairs[k].track;
        numbers[matched++] = order[pairs[k].place];
    }
    return matched;
}

/* match(fields, block, shapes, reach, key, order, rows, numbers,
 *       start, stop, widest, low, high, stretch, threshold) -> how many pairs were written */
static PyObject *match(PyObject *module, PyObject *const *given, Py_ssize_t count) {
    (void)module;
    Array a[MOST_ARRAYS];
    int taken = take(a, given, count, "d2l1d2d1d1l1L1L1", 7);
    if (taken < 0) return NULL;
    PyObject *const *scalar = given + taken;
    Targets t = {a[2].view.buf, a[3].view.buf, a[4].view.buf, a[2].columns,
                 PyNumber_AsSsize_t(scalar[0], PyExc_OverflowError),
                 PyNumber_AsSsize_t(scalar[1], PyExc_OverflowError),
                 PyFloat_AsDouble(scalar[2]), PyFloat_AsDouble(scalar[3]),
                 PyFloat_AsDouble(scalar[4]), PyFloat_AsDouble(scalar[5]),
                 PyFloat_AsDouble(scalar[6])};
    Py_ssize_t tracks = a[0].columns, all = t.count, found = -1, matched = 0;
    if (PyErr_Occurred()) return release(a, taken), NULL;
    int fits = a[0].rows == 7 && a[1].columns == tracks && a[2].rows == SHAPE_ROWS &&
               a[3].columns == all && a[4].columns == all && a[5].columns == all && t.start >= 0 &&
               t.start <= t.stop && t.stop <= all;
    Py_ssize_t most = fits ? LEAST(tracks, t.stop - t.start) : 0;
    if (!fits || a[6].columns < most || a[7].columns < most)
        return release(a, taken), refuse("match: shapes do not agree");
    Pair *pairs = PyMem_Malloc(sizeof(Pair) * (size_t)(4 * tracks + 64));
    char *used = PyMem_Calloc((size_t)(tracks + t.stop - t.start) + 1, 1);
    if (pairs && used)
        found = affordable(&t, a[0].view.buf, a[1].view.buf, tracks, &pairs, 4 * tracks + 64);
    if (found >= 0) {
        qsort(pairs, (size_t)found, sizeof(Pair), cheaper);
        matched = choose(pairs, found, &t, a[5].view.buf, tracks, used, a[6].view.buf,
                         a[7].view.buf);
    }
    PyMem_Free(pairs), PyMem_Free(used);
    release(a, taken);
    return found < 0 ? PyErr_NoMemory() : PyLong_FromSsize_t(matched);
}

static PyMethodDef methods[] = {
    {"match", (PyCFunction)(void (*)(void))match, METH_FASTCALL, NULL},
    {NULL, NULL, 0, NULL},
};

static PyModuleDef_Slot slots[] = {{0, NULL}};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "_kernels", NULL, 0, methods, slots, NULL, NULL, NULL,
};

PyMODINIT_FUNC PyInit__kernels(void) { return PyModuleDef_Init(&definition); }
