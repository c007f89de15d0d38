/* Association: tracking.association.match with the cost ciou_3d. */
#include "match.h"
#include "sort.h"

/* A box: centre, half of its sizes, yaw. */
enum { X, Y, Z, HALF, YAW_RAD = HALF + 3, SHAPE };

/* Boxes are compared so many pairs at a time. */
enum { BATCH = 64 };

typedef struct {
    double reach, at[SHAPE];
} Shape;

/* A box, whose numbers lie `step` apart, and how far it can be matched: costs.reach_m. */
static Shape shape_of(const double *box, size_t step, double stretch) {
    Shape s = {.at = {box[0], box[step], box[2 * step]}};
    double squared = 0.0;
    for (size_t axis = 0; axis < 3; axis++) {
        double half = s.at[HALF + axis] = 0.5 * box[(3 + axis) * step];
        squared += half * half;
    }
    s.at[YAW_RAD] = box[6 * step];
    s.reach = stretch * sqrt(squared);
    return s;
}

static inline double volume(const double at[SHAPE]) {
    return 8.0 * at[HALF] * at[HALF + 1] * at[HALF + 2];
}

/* overlap.rectangle_intersection, m2: pose of the first rectangle in the frame of the second. */
static inline double shared_area(const double pose[4], const double first[2], const double second[2]) {
    double c = pose[2], s = pose[3], area = 0.0, upright = 0.0;
    double grown = 1.0 + 1e-9; /* edges never coincide exactly: overlap._GROWTH */
    double half[2][2] = {{first[0] * grown, first[1] * grown}, {second[0], second[1]}};
    /* turn[axis][rectangle][along or across], centre[axis][rectangle] in the frame of the other */
    double turn[2][2][2] = {{{c, -s}, {c, s}}, {{s, c}, {-s, c}}};
    double centre[2][2] = {{pose[0], -(pose[0] * c + pose[1] * s)},
                           {pose[1], -(pose[1] * c - pose[0] * s)}};
    UNROLLED for (int rect = 0; rect < 2; rect++)
        UNROLLED for (int along = 0; along < 2; along++) {
            double edge[2], other[2], inverse[2], reach[2];
            UNROLLED for (int axis = 0; axis < 2; axis++) {
                edge[axis] = turn[axis][rect][along] * half[rect][along];
                other[axis] = turn[axis][rect][1 - along] * half[rect][1 - along];
                inverse[axis] = 1.0 / (edge[axis] + 1e-300);
                reach[axis] = fabs(inverse[axis]) * half[1 - rect][axis];
            }
            UNROLLED for (int side = 0; side < 2; side++) {
                double middle[2], to = 1.0, back = 1.0;
                UNROLLED for (int axis = 0; axis < 2; axis++) {
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

/* tracking.costs.ciou_3d of a prior and a detection, but for the aspect: what is not shared, and how
 * far apart they are. Nothing branches, so that many pairs are compared at once. */
static inline void compare(const double p[SHAPE], const double d[SHAPE], double *rest,
                           double *spread) {
    double far = 0.0, span = 0.0, least = INFINITY, overlap = 0.0;
    double dx = d[X] - p[X], dy = d[Y] - p[Y], c, s, pose[4];
    cosine_and_sine(p[YAW_RAD], &c, &s);
    cosine_and_sine(d[YAW_RAD] - p[YAW_RAD], pose + 2, pose + 3);
    pose[0] = dx * c + dy * s, pose[1] = dy * c - dx * s;
    double cos_by = fabs(pose[2]), sin_by = fabs(pose[3]);
    double distance[3] = {fabs(pose[0]), fabs(pose[1]), fabs(d[Z] - p[Z])};
    double half[3] = {d[HALF] * cos_by + d[HALF + 1] * sin_by,
                      d[HALF + 1] * cos_by + d[HALF] * sin_by, d[HALF + 2]};
    UNROLLED for (int axis = 0; axis < 3; axis++) {
        double reach = p[HALF + axis] + half[axis];
        double apart = MOST(fabs(half[axis] - p[HALF + axis]), distance[axis]);
        far += distance[axis] * distance[axis];
        span += (reach + apart) * (reach + apart);
        overlap = reach - apart;
        least = LEAST(least, overlap);
    }
    double area = shared_area(pose, d + HALF, p + HALF);
    double shared = least > 0.0 ? area * overlap : 0.0;
    *rest = 1.0 - shared / (volume(p) + volume(d) - shared);
    *spread = far / span;
}

/* The cost, with the difference of the angles that length and width make. */
static double ciou_3d(const double p[2], const double d[2], double rest, double spread) {
    double v = atan2(p[0] * d[1] - d[0] * p[1], p[1] * d[1] + p[0] * d[0]);
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
    int64_t rank;
    Py_ssize_t track, place;
} Pair;

/* In the order of blocks, within a block along x. */
static inline int before(const Key *a, const Key *b) {
    return a->block < b->block || (a->block == b->block && a->x < b->x);
}

static inline int cheaper(const Pair *a, const Pair *b) {
    return a->cost < b->cost || (a->cost == b->cost && a->rank < b->rank);
}

DEFINE_SORT(sort_keys, Key, before)
DEFINE_SORT(sort_pairs, Pair, cheaper)

/* First place of a block whose x is not below a value. */
static Py_ssize_t first_from(const Key *keys, Py_ssize_t count, int64_t block, double x) {
    const Key wanted = {x, block, 0}, *from = keys;
    while (count > 0) { /* without branches, which would be guessed wrong half the time */
        Py_ssize_t half = count / 2;
        int behind = before(from + half, &wanted);
        from += behind ? half + 1 : 0;
        count = behind ? count - half - 1 : half;
    }
    return from - keys;
}

/* Pairs that are looked at together, and those found to be cheaper than the threshold. */
typedef struct {
    double prior[SHAPE][BATCH], seen[SHAPE][BATCH];
    Pair of[BATCH], *pairs;
    int count;
    Py_ssize_t found, room;
} Search;

/* Keep what is affordable of a batch. Whether there was memory. */
static int look_at(Search *s, double threshold) {
    double rest[BATCH], spread[BATCH];
    for (int j = 0; j < s->count; j++) {
        double p[SHAPE], d[SHAPE];
        UNROLLED for (int i = 0; i < SHAPE; i++) p[i] = s->prior[i][j], d[i] = s->seen[i][j];
        compare(p, d, rest + j, spread + j);
    }
    if (s->found + s->count > s->room) {
        Pair *more = realloc(s->pairs, sizeof(Pair) * (size_t)(s->room = 2 * s->room + BATCH));
        if (!more) return 0;
        s->pairs = more;
    }
    for (int j = 0; j < s->count; j++) {
        if (!(rest[j] + spread[j] < threshold)) continue;
        double p[2] = {s->prior[HALF][j], s->prior[HALF + 1][j]};
        double d[2] = {s->seen[HALF][j], s->seen[HALF + 1][j]};
        s->of[j].cost = ciou_3d(p, d, rest[j], spread[j]);
        if (s->of[j].cost < threshold) s->pairs[s->found++] = s->of[j];
    }
    s->count = 0;
    return 1;
}

static void add(Search *s, const Shape *prior, const Shape *seen, Pair pair) {
    for (int i = 0; i < SHAPE; i++)
        s->prior[i][s->count] = prior->at[i], s->seen[i][s->count] = seen->at[i];
    s->of[s->count++] = pair;
}

/* Pairs of tracks and sorted detections that are affordable, by track. Whether there was memory. */
static int search(Search *s, Priors tracks, const Key *keys, const Shape *detections,
                  Py_ssize_t count, Affordable most) {
    double widest = 0.0;
    for (Py_ssize_t k = 0; k < count; k++)
        if (detections[k].reach > widest) widest = detections[k].reach; /* NaN never is. */
    for (Py_ssize_t i = 0; i < tracks.n; i++) {
        Shape own = shape_of(tracks.boxes + i, (size_t)tracks.n, most.stretch);
        double strip = own.reach + widest;
        Py_ssize_t place = first_from(keys, count, tracks.block[i], own.at[X] - strip);
        for (; place < count && keys[place].block == tracks.block[i]; place++) {
            const Shape *d = detections + place;
            double dx = d->at[X] - own.at[X], dy = d->at[Y] - own.at[Y];
            double both = own.reach + d->reach;
            if (keys[place].x - own.at[X] > strip) break;
            if (!(dx * dx + dy * dy < both * both)) continue;
            add(s, &own, d, (Pair){INFINITY, tracks.rank[i], i, place});
            if (s->count == BATCH && !look_at(s, most.threshold)) return 0;
        }
    }
    return look_at(s, most.threshold);
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

FOR_EACH_PROCESSOR Py_ssize_t match_boxes(Priors tracks, const double *boxes,
                                          const int64_t *block, Py_ssize_t start, Py_ssize_t stop,
                                          Affordable most, int64_t *rows, int64_t *numbers) {
    Py_ssize_t matched = -1, seen = stop - start;
    Search s = {.room = 2 * tracks.n + BATCH};
    Key *keys = malloc(2 * sizeof(Key) * (size_t)(seen + 1));
    Shape *detections = malloc(sizeof(Shape) * (size_t)(seen + 1));
    Pair *spare = NULL;
    char *used = calloc((size_t)(tracks.n + seen + 1), 1);
    s.pairs = malloc(sizeof(Pair) * (size_t)s.room);
    if (keys && detections && s.pairs && used) {
        for (Py_ssize_t number = start; number < stop; number++) {
            double x = boxes[7 * number]; /* what is not a number lies behind everything */
            keys[number - start] = (Key){isnan(x) ? INFINITY : x, block[number], number};
        }
        sort_keys(keys, keys + seen, seen);
        for (Py_ssize_t k = 0; k < seen; k++)
            detections[k] = shape_of(boxes + 7 * keys[k].number, 1, most.stretch);
        if (search(&s, tracks, keys, detections, seen, most))
            spare = malloc(sizeof(Pair) * (size_t)(s.found + 1));
    }
    if (spare) {
        sort_pairs(s.pairs, spare, s.found);
        matched = choose(s.pairs, s.found, keys, tracks.n, used, rows, numbers);
    }
    free(keys), free(detections), free(s.pairs), free(spare), free(used);
    return matched;
}

/* match(priors, track_block, rank, boxes, block, rows, numbers, start, stop, stretch, threshold)
 * -> how many pairs were written; of the detections, boxes (m, 7), those from start to stop. */
PyObject *match(PyObject *module, PyObject *const *given, Py_ssize_t count) {
    (void)module;
    enum { BOXES, BLOCKS, RANKS, SEEN, SEEN_BLOCKS, ROWS, NUMBERS, ALL_ARRAYS };
    Array a[ALL_ARRAYS];
    Py_ssize_t start, stop, matched = -1;
    Affordable most;
    int taken = take(a, given, count, "d2l1l1d2l1L1L1", 4);
    if (taken < 0) return NULL;
    if (!whole_number(given[taken], &start) || !whole_number(given[taken + 1], &stop) ||
        !number(given[taken + 2], &most.stretch) || !number(given[taken + 3], &most.threshold))
        return release(a, taken), NULL;
    Py_ssize_t n = a[BOXES].columns, seen = a[SEEN].rows;
    if (a[BOXES].rows != 7 || a[BLOCKS].columns != n || a[RANKS].columns != n ||
        a[SEEN].columns != 7 || a[SEEN_BLOCKS].columns != seen || start < 0 || start > stop ||
        stop > seen || LEAST(a[ROWS].columns, a[NUMBERS].columns) < LEAST(n, stop - start))
        return release(a, taken), refuse("match: shapes do not agree");
    Priors tracks = {a[BOXES].view.buf, a[BLOCKS].view.buf, a[RANKS].view.buf, n};
    matched = match_boxes(tracks, a[SEEN].view.buf, a[SEEN_BLOCKS].view.buf, start, stop, most,
                          a[ROWS].view.buf, a[NUMBERS].view.buf);
    release(a, taken);
    return matched < 0 ? PyErr_NoMemory() : PyLong_FromSsize_t(matched);
}
