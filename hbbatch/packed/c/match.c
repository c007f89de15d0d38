/* Association: tracking.association.match with the cost ciou_3d. */
#include "arrays.h"

/* tracking.costs.shapes_of but the aspect, and costs.reach_m. */
typedef struct {
    double x, y, z, reach, half[3], area, volume, cos, sin;
} Shape;

/* Where a box is, whose numbers lie `step` apart, and how far it can be matched. */
static Shape place_of(const double *box, size_t step, double stretch) {
    Shape s = {.x = box[0], .y = box[step], .z = box[2 * step]};
    for (int axis = 0; axis < 3; axis++) s.half[axis] = 0.5 * box[(size_t)(3 + axis) * step];
    double squared = s.half[0] * s.half[0] + s.half[1] * s.half[1] + s.half[2] * s.half[2];
    s.reach = stretch * sqrt(squared);
    return s;
}

/* The rest of a shape. */
static void complete(const double *box, size_t step, Shape *s) {
    s->area = box[3 * step] * box[4 * step], s->volume = s->area * box[5 * step];
    s->cos = cos(box[6 * step]), s->sin = sin(box[6 * step]);
}

/* overlap.rectangle_intersection, m2: pose of the first rectangle in the frame of the second. */
static double shared_area(const double pose[4], const double first[2], const double second[2]) {
    double c = pose[2], s = pose[3], area = 0.0, upright = 0.0;
    double grown = 1.0 + 1e-9; /* edges never coincide exactly: overlap._GROWTH */
    double half[2][2] = {{first[0] * grown, first[1] * grown}, {second[0], second[1]}};
    /* turn[axis][rectangle][along or across], centre[axis][rectangle] in the frame of the other */
    double turn[2][2][2] = {{{c, -s}, {c, s}}, {{s, c}, {-s, c}}};
    double centre[2][2] = {{pose[0], -(pose[0] * c + pose[1] * s)},
                           {pose[1], -(pose[1] * c - pose[0] * s)}};
    for (int rect = 0; rect < 2; rect++)
        for (int along = 0; along < 2; along++) {
            double edge[2], other[2], inverse[2], reach[2];
            for (int axis = 0; axis < 2; axis++) {
                edge[axis] = turn[axis][rect][along] * half[rect][along];
                other[axis] = turn[axis][rect][1 - along] * half[rect][1 - along];
                inverse[axis] = 1.0 / (edge[axis] + 1e-300);
                reach[axis] = fabs(inverse[axis]) * half[1 - rect][axis];
            }
            for (int side = 0; side < 2; side++) {
                double middle[2], to = 1.0, back = 1.0;
                for (int axis = 0; axis < 2; axis++) {
                    middle[axis] = centre[axis][rect] + (side ? -other[axis] : other[axis]);
                    double at = middle[axis] * inverse[axis];
                    to = LEAST(to, at + reach[axis]), back = LEAST(back, reach[axis] - at);
                }
                double length = MOST(to + back, 0.0);
                if (rect) upright += length;
                else
                    area += (along == side ? -1.0 : 1.0) * length *
                            (middle[0] * edge[1] - middle[1] * edge[0]);
            }
        }
    return MOST(0.5 * (area + upright * second[0] * second[1]), 0.0);
}

/* tracking.costs.ciou_3d of the shapes of a prior and a detection, or infinity if that is at the
 * threshold or above. */
static double ciou_3d(const Shape *p, const Shape *d, double threshold) {
    double far = 0.0, span = 0.0, least = INFINITY, overlap = 0.0, shared = 0.0;
    double dx = d->x - p->x, dy = d->y - p->y;
    double pose[4] = {dx * p->cos + dy * p->sin, dy * p->cos - dx * p->sin,
                      d->cos * p->cos + d->sin * p->sin, d->sin * p->cos - d->cos * p->sin};
    double cos_by = fabs(pose[2]), sin_by = fabs(pose[3]);
    double distance[3] = {fabs(pose[0]), fabs(pose[1]), fabs(d->z - p->z)};
    double half[3] = {d->half[0] * cos_by + d->half[1] * sin_by,
                      d->half[1] * cos_by + d->half[0] * sin_by, d->half[2]};
    for (int axis = 0; axis < 3; axis++) {
        double reach = p->half[axis] + half[axis];
        double apart = MOST(fabs(half[axis] - p->half[axis]), distance[axis]);
        far += distance[axis] * distance[axis];
        span += (reach + apart) * (reach + apart);
        overlap = reach - apart;
        least = LEAST(least, overlap);
    }
    if (least > 0.0) shared = shared_area(pose, d->half, p->half) * overlap;
    double rest = 1.0 - shared / (p->volume + d->volume - shared), spread = far / span;
    if (!(rest + spread < threshold)) return INFINITY;
    /* The difference of the angles that length and width make. */
    double v = atan2(p->half[0] * d->half[1] - d->half[0] * p->half[1],
                     p->half[1] * d->half[1] + p->half[0] * d->half[0]);
    v *= v * (4.0 / (PI * PI));
    return v * v / MOST(v + rest, 1e-12) + rest + spread;
}

typedef struct {
    double x;
    int64_t block;
    Py_ssize_t number;
} Key;

typedef struct {
    double cost;
    Py_ssize_t track, place;
} Pair;

/* In the order of blocks, within a block along x. */
static int before(const void *first, const void *second) {
    const Key *a = first, *b = second;
    if (a->block != b->block) return a->block < b->block ? -1 : 1;
    if (a->x != b->x) return a->x < b->x ? -1 : 1;
    return (a->number > b->number) - (a->number < b->number);
}

static int cheaper(const void *first, const void *second) {
    const Pair *a = first, *b = second;
    if (a->cost != b->cost) return a->cost < b->cost ? -1 : 1;
    if (a->track != b->track) return a->track < b->track ? -1 : 1;
    return (a->place > b->place) - (a->place < b->place);
}

/* First place of a block whose x is not below a value. */
static Py_ssize_t first_from(const Key *keys, Py_ssize_t high, int64_t block, double x) {
    Py_ssize_t low = 0;
    while (low < high) {
        Py_ssize_t middle = low + (high - low) / 2;
        const Key *key = keys + middle;
        if (key->block < block || (key->block == block && key->x < x)) low = middle + 1;
        else high = middle;
    }
    return low;
}

/* Pairs of tracks and sorted detections that are cheaper than the threshold; -1 without memory. */
static Py_ssize_t affordable(const Array *priors, const int64_t *block, const Key *keys,
                             const Shape *detections, Py_ssize_t count, double stretch,
                             double threshold, Pair **pairs, Py_ssize_t room) {
    Py_ssize_t found = 0, tracks = priors->columns;
    double widest = 0.0;
    for (Py_ssize_t k = 0; k < count; k++)
        if (detections[k].reach > widest) widest = detections[k].reach; /* NaN never is. */
    for (Py_ssize_t i = 0; i < tracks; i++) {
        const double *box = (const double *)priors->view.buf + i;
        Shape own = place_of(box, (size_t)tracks, stretch);
        double strip = own.reach + widest;
        int completed = 0;
        Py_ssize_t place = first_from(keys, count, block[i], own.x - strip);
        for (; place < count && keys[place].block == block[i]; place++) {
            const Shape *d = detections + place;
            double dx = d->x - own.x, dy = d->y - own.y, both = own.reach + d->reach;
            if (keys[place].x - own.x > strip) break;
            if (!(dx * dx + dy * dy < both * both)) continue;
            if (!completed) complete(box, (size_t)tracks, &own);
            completed = 1;
            double cost = ciou_3d(&own, d, threshold);
            if (!(cost < threshold)) continue;
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
static Py_ssize_t choose(const Pair *pairs, Py_ssize_t found, const Key *keys, Py_ssize_t tracks,
                         char *taken, int64_t *rows, int64_t *numbers) {
    Py_ssize_t matched = 0;
    for (Py_ssize_t k = 0; k < found; k++) {
        char *track = taken + pairs[k].track, *place = taken + tracks + pairs[k].place;
        if (*track || *place) continue;
        *track = *place = 1;
        rows[matched] = pairs[k].track;
        numbers[matched++] = keys[pairs[k].place].number;
    }
    return matched;
}

/* match(priors, track_block, boxes, block, rows, numbers, start, stop, stretch, threshold)
 * -> how many pairs were written; of the detections, boxes (m, 7), those from start to stop. */
FOR_EACH_PROCESSOR PyObject *match(PyObject *module, PyObject *const *given, Py_ssize_t count) {
    (void)module;
    Array a[MOST_ARRAYS];
    int taken = take(a, given, count, "d2l1d2l1L1L1", 4);
    if (taken < 0) return NULL;
    Py_ssize_t start = PyNumber_AsSsize_t(given[6], PyExc_OverflowError);
    Py_ssize_t stop = PyNumber_AsSsize_t(given[7], PyExc_OverflowError);
    double stretch = PyFloat_AsDouble(given[8]), threshold = PyFloat_AsDouble(given[9]);
    if (PyErr_Occurred()) return release(a, taken), NULL;
    Py_ssize_t tracks = a[0].columns, found = -1, matched = 0, seen = -1;
    if (start >= 0 && start <= stop && stop <= a[2].rows) seen = stop - start;
    if (a[0].rows != 7 || a[1].columns != tracks || a[2].columns != 7 ||
        a[3].columns != a[2].rows || seen < 0 ||
        a[4].columns < LEAST(tracks, seen) || a[5].columns < LEAST(tracks, seen))
        return release(a, taken), refuse("match: shapes do not agree");
    Py_ssize_t room = 4 * tracks + 64;
    Key *keys = PyMem_Malloc(sizeof(Key) * (size_t)(seen + 1));
    Shape *detections = PyMem_Malloc(sizeof(Shape) * (size_t)(seen + 1));
    Pair *pairs = PyMem_Malloc(sizeof(Pair) * (size_t)room);
    char *used = PyMem_Calloc((size_t)(tracks + seen + 1), 1);
    if (keys && detections && pairs && used) {
        const double *boxes = a[2].view.buf;
        for (Py_ssize_t number = start; number < stop; number++) {
            double x = boxes[7 * number]; /* what is not a number lies behind everything */
            int64_t block = ((const int64_t *)a[3].view.buf)[number];
            keys[number - start] = (Key){isnan(x) ? INFINITY : x, block, number};
        }
        qsort(keys, (size_t)seen, sizeof(Key), before);
        for (Py_ssize_t k = 0; k < seen; k++) {
            detections[k] = place_of(boxes + 7 * keys[k].number, 1, stretch);
            complete(boxes + 7 * keys[k].number, 1, detections + k);
        }
        found = affordable(a, a[1].view.buf, keys, detections, seen, stretch, threshold, &pairs,
                           room);
    }
    if (found >= 0) {
        qsort(pairs, (size_t)found, sizeof(Pair), cheaper);
        matched = choose(pairs, found, keys, tracks, used, a[4].view.buf, a[5].view.buf);
    }
    PyMem_Free(keys), PyMem_Free(detections), PyMem_Free(pairs), PyMem_Free(used);
    release(a, taken);
    return found < 0 ? PyErr_NoMemory() : PyLong_FromSsize_t(matched);
}
