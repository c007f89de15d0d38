/* Lock steps, one after the other: what tracking.eager_steps does, for a filter of filter.h. */
#include "match.h"
#include "rows.h"
#include <time.h>

/* The arrays of a call (packed.kernels.steps); those of the filter begin with FILTER. */
enum {
    OFFSETS, FIRST_FRAME, SEQUENCES, PLACE_OF, BLOCKS, KINDS, MEASURED, SEEN, TIMES, FILTER,
    DAMPING = FILTER + FILTER_ARRAYS, CELLS, BOXES, STATE, FIRSTS, STEPS, SAID_BOXES, SAID_VELOCITY,
    PRIORS, ROWS, NUMBERS, COUNTS, SECONDS, ALL_ARRAYS
};
#define KINDS_OF_ARRAYS \
    "l1l1l1l1l1l1d2f2f2" "l1f2f1f2f2f2f1f2f2f2f2" "d1" "L2D2F2L1L1D2D2" "D1L1L1L1D1"

_Static_assert(sizeof(KINDS_OF_ARRAYS) == 2 * ALL_ARRAYS + 1, "a kind for each array");

enum { TRACKS, PLACES, PREDICTED, CORRECTED, COUNTED };
enum { PREDICT, ASSOCIATE, UPDATE, MANAGE, STAGES };

/* What is counted stays so far below what a number can hold. */
#define MOST_COUNTED ((int64_t)1 << 62)

/* How a step ends. */
typedef enum { DONE, NO_ROOM, NO_MEMORY, NO_FIT, RAISED } End;

typedef struct {
    const Array *arrays;
    Filter filter;
    Columns columns;
    Known known;
    Affordable most;
    Py_ssize_t patience, patience_unconfirmed, max_coasted;
    int64_t counts[COUNTED];
    double *seconds;
    PyObject *matching;
    /* Scratch for as many tracks as there may be. */
    int64_t *frames, *order, *from, *to;
    double *shares, *spare;
    Py_ssize_t room;
} Group;

static int64_t *whole(const Group *g, int array) { return g->arrays[array].view.buf; }
static double *real(const Group *g, int array) { return g->arrays[array].view.buf; }
static int64_t *cell(const Group *g, int row) { return whole(g, CELLS) + row * g->room; }

static double now_s(void) {
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return (double)time.tv_sec + 1e-9 * (double)time.tv_nsec;
}

/* Let a stage have the time since the last one ended. */
static void stop_watch(Group *g, int stage, double *since) {
    double now = now_s();
    g->seconds[stage] += now - *since;
    *since = now;
}

/* tracking.eager_steps.scaling_factor of a track before its step. */
static double scaling_factor(const double *damping, int64_t age, int64_t misses) {
    double ramp_frames = damping[0], minimum = damping[1], maximum = damping[2], most = damping[3];
    double ramp = LEAST((double)(age + 1) / ramp_frames, 1.0);
    if ((double)misses >= most) return minimum;
    if (misses == 0) return ramp;
    return ramp * ((1.0 - (double)misses / most) * (maximum - minimum) + minimum);
}

/* The frame of each track and, with damping, the share of the way it goes. */
static End look_ahead(Group *g, Py_ssize_t step, Py_ssize_t n) {
    for (Py_ssize_t i = 0; i < n; i++) {
        int64_t sequence = cell(g, SEQUENCE)[i];
        if (sequence < 0 || sequence >= g->arrays[FIRST_FRAME].columns) return NO_FIT;
        g->frames[i] = whole(g, FIRST_FRAME)[sequence] + step;
        if (g->frames[i] < 0 || g->frames[i] >= g->known.times->columns) return NO_FIT;
        if (g->arrays[DAMPING].columns)
            g->shares[i] = scaling_factor(real(g, DAMPING), cell(g, AGE)[i], cell(g, MISSES)[i]);
    }
    return DONE;
}

/* What Python matches: rows and numbers of n tracks and of the detections from start to stop. */
static Py_ssize_t ask(Group *g, Py_ssize_t n, Py_ssize_t start, Py_ssize_t stop) {
    PyObject *said = PyObject_CallFunction(g->matching, "nnn", n, start, stop);
    Py_ssize_t matched = said ? PyNumber_AsSsize_t(said, PyExc_OverflowError) : -1;
    Py_XDECREF(said);
    if (PyErr_Occurred()) return -1;
    int64_t *taken = g->to;
    int fits = matched >= 0 && matched <= LEAST(n, stop - start);
    for (Py_ssize_t i = 0; i < stop - start; i++) taken[i] = 0;
    for (Py_ssize_t k = 0; fits && k < matched; k++) {
        int64_t row = whole(g, ROWS)[k], number = whole(g, NUMBERS)[k];
        fits = row >= 0 && row < n && number >= start && number < stop && !taken[number - start];
        if (fits) taken[number - start] = 1;
    }
    if (!fits) refuse("steps: pairs that there are not");
    return fits ? matched : -1;
}

static Py_ssize_t associate(Group *g, Py_ssize_t n, Py_ssize_t start, Py_ssize_t stop) {
    if (!n || start == stop) return 0;
    if (g->matching != Py_None) return ask(g, n, start, stop);
    Priors tracks = {real(g, PRIORS), cell(g, TRACK_BLOCK), cell(g, FIRST), n};
    return match_boxes(tracks, g->known.measured, whole(g, BLOCKS), start, stop, g->most,
                       whole(g, ROWS), whole(g, NUMBERS));
}

/* Matched rows come first, dying ones last. */
static void arrange(Group *g, Py_ssize_t n) {
    Py_ssize_t moved = moves(g->order, n, g->from, g->to);
    for (int matrix = CELLS; matrix <= STATE; matrix++)
        move(g->arrays + matrix, g->from, g->to, moved, g->spare);
}

/* Places of n detections. */
static const int64_t *places_of(Group *g, const int64_t *detections, Py_ssize_t n) {
    for (Py_ssize_t i = 0; i < n; i++) g->to[i] = whole(g, PLACE_OF)[detections[i]];
    return g->to;
}

/* What n tracks are now, columns rows[i] or i, to places places[i]. */
static void record(Group *g, const int64_t *rows, const int64_t *places, Py_ssize_t n) {
    say(&g->columns, g->filter.layout[VELOCITY], rows, places, n, real(g, SAID_BOXES),
        real(g, SAID_VELOCITY));
    for (Py_ssize_t i = 0; i < n; i++)
        whole(g, FIRSTS)[places[i]] = cell(g, FIRST)[rows ? rows[i] : i];
}

/* Tracks that coast are said in places after the others'. */
static void record_coasted(Group *g, Py_ssize_t step, Py_ssize_t n) {
    const int64_t *misses = cell(g, MISSES);
    Py_ssize_t coasted = 0;
    for (Py_ssize_t i = 0; i < n; i++) {
        if (misses[i] == 0 || misses[i] > g->max_coasted) continue;
        int64_t place = g->counts[PLACES]++;
        whole(g, STEPS)[place] = step;
        g->from[coasted] = i, g->to[coasted++] = place;
    }
    record(g, g->from, g->to, coasted);
}

/* Detections that no track continues begin one. */
static void give_birth(Group *g, Py_ssize_t start, Py_ssize_t stop, Py_ssize_t matched) {
    int64_t *newborn = g->from, *free = g->to, alive = g->counts[TRACKS];
    Py_ssize_t born = 0;
    for (Py_ssize_t i = 0; i < stop - start; i++) free[i] = 1;
    for (Py_ssize_t k = 0; k < matched; k++) free[whole(g, NUMBERS)[k] - start] = 0;
    for (Py_ssize_t i = 0; i < stop - start; i++)
        if (free[i]) newborn[born++] = start + i;
    birth(&g->filter, &g->columns, &g->known, newborn, alive, born);
    const int64_t *places = places_of(g, newborn, born);
    for (Py_ssize_t i = 0; i < born; i++) {
        int64_t row = alive + i;
        cell(g, FIRST)[row] = places[i];
        cell(g, SEQUENCE)[row] = whole(g, SEQUENCES)[newborn[i]];
        cell(g, TRACK_BLOCK)[row] = whole(g, BLOCKS)[newborn[i]];
        cell(g, PATIENCE)[row] = g->patience_unconfirmed;
        cell(g, AGE)[row] = cell(g, MISSES)[row] = 0;
        g->order[i] = row;
    }
    record(g, g->order, places, born);
    g->counts[TRACKS] = alive + born;
}

/* Whether all tracks and what is said of them will have room after a step. */
static int has_room(const Group *g, Py_ssize_t seen) {
    int64_t n = g->counts[TRACKS], said = g->max_coasted ? n : 0;
    return n + seen <= g->room && g->counts[PLACES] + said <= g->arrays[FIRSTS].columns;
}

static End one_step(Group *g, Py_ssize_t step) {
    double since = now_s();
    Py_ssize_t start = whole(g, OFFSETS)[step], stop = whole(g, OFFSETS)[step + 1];
    Py_ssize_t n = g->counts[TRACKS];
    if (!has_room(g, stop - start)) return NO_ROOM;
    if (look_ahead(g, step, n) != DONE) return NO_FIT;
    predict(&g->filter, &g->columns, &g->known, g->frames,
            g->arrays[DAMPING].columns ? g->shares : NULL, real(g, PRIORS), n);
    stop_watch(g, PREDICT, &since);
    Py_ssize_t matched = associate(g, n, start, stop);
    if (matched < 0) return g->matching == Py_None ? NO_MEMORY : RAISED;
    stop_watch(g, ASSOCIATE, &since);
    int64_t *detections = whole(g, NUMBERS);
    Py_ssize_t alive = settle(whole(g, CELLS), g->room, n, whole(g, ROWS), detections, matched,
                              g->patience, g->order, g->from);
    if (alive < 0) return NO_FIT;
    arrange(g, n);
    update(&g->filter, &g->columns, &g->known, detections, matched);
    stop_watch(g, UPDATE, &since);
    record(g, NULL, places_of(g, detections, matched), matched);
    if (g->max_coasted) record_coasted(g, step, n);
    g->counts[TRACKS] = alive, g->counts[PREDICTED] += n, g->counts[CORRECTED] += matched;
    if (matched < stop - start) give_birth(g, start, stop, matched);
    stop_watch(g, MANAGE, &since);
    return DONE;
}

/* Whether arrays have the shapes that go together. */
static int shapes_agree(Group *g) {
    const Array *a = g->arrays;
    Py_ssize_t seen = a[SEQUENCES].columns, places = a[FIRSTS].columns, room = a[CELLS].columns;
    g->room = room;
    g->columns = (Columns){a[BOXES].view.buf, a[STATE].view.buf, room, a[STATE].columns};
    g->known = (Known){a + TIMES, a[MEASURED].view.buf, a[SEEN].view.buf, a[KINDS].view.buf};
    g->seconds = real(g, SECONDS);
    if (a[COUNTS].columns != COUNTED || !filter_of(a + FILTER, &g->filter)) return 0;
    memcpy(g->counts, whole(g, COUNTS), sizeof(g->counts));
    return a[OFFSETS].columns > 0 && a[PLACE_OF].columns == seen &&
           a[BLOCKS].columns == seen && a[KINDS].columns == seen &&
           a[MEASURED].rows == seen && a[MEASURED].columns == BOX && a[SEEN].rows == seen &&
           a[SEEN].columns == SEEN_ROWS && a[CELLS].rows == CELL_ROWS && a[BOXES].rows == BOX &&
           a[BOXES].columns == room && a[STATE].columns == room &&
           a[STATE].rows == g->filter.newborn->rows && places >= seen &&
           a[STEPS].columns == places && a[SAID_BOXES].rows == places &&
           a[SAID_BOXES].columns == BOX && a[SAID_VELOCITY].rows == places &&
           a[SAID_VELOCITY].columns == 3 && a[PRIORS].columns == BOX * room &&
           a[ROWS].columns == room && a[NUMBERS].columns == room &&
           a[SECONDS].columns == STAGES &&
           (a[DAMPING].columns == 4 || !a[DAMPING].columns) &&
           a[TIMES].rows == WEIGHTS + g->filter.mixed + blocks_of(g->filter.layout);
}

static int between(const int64_t *values, Py_ssize_t from, Py_ssize_t to, int64_t least,
                   int64_t limit) {
    for (Py_ssize_t i = from; i < to; i++)
        if (values[i] < least || values[i] >= limit) return 0;
    return 1;
}

/* Whether the steps, their detections and the tracks there are lead nowhere beyond an array. */
static int numbers_agree(const Group *g, Py_ssize_t start, Py_ssize_t stop) {
    const Array *a = g->arrays;
    const int64_t *offsets = whole(g, OFFSETS), *counts = g->counts;
    Py_ssize_t seen = a[SEQUENCES].columns, sequences = a[FIRST_FRAME].columns;
    if (start < 0 || start > stop || stop >= a[OFFSETS].columns) return 0;
    for (Py_ssize_t step = start; step < stop; step++)
        if (offsets[step] < 0 || offsets[step] > offsets[step + 1]) return 0;
    return offsets[stop] <= seen && between(counts, 0, COUNTED, 0, MOST_COUNTED) &&
           counts[TRACKS] <= g->room && counts[PLACES] >= seen &&
           counts[PLACES] <= a[FIRSTS].columns &&
           between(whole(g, FIRST_FRAME), 0, sequences, -MOST_COUNTED, MOST_COUNTED) &&
           between(whole(g, SEQUENCES), offsets[start], offsets[stop], 0, sequences) &&
           between(whole(g, PLACE_OF), offsets[start], offsets[stop], 0, seen) &&
           between(whole(g, KINDS), offsets[start], offsets[stop], 0,
                   g->filter.newborn->columns) &&
           between(cell(g, AGE), 0, counts[TRACKS], 0, MOST_COUNTED) &&
           between(cell(g, MISSES), 0, counts[TRACKS], 0, MOST_COUNTED);
}

/* The numbers of a call, after its arrays. */
static int settings_of(PyObject *const *given, Py_ssize_t *start, Py_ssize_t *stop, Group *g) {
    g->matching = given[7];
    return whole_number(given[0], start) && whole_number(given[1], stop) &&
           whole_number(given[2], &g->patience) &&
           whole_number(given[3], &g->patience_unconfirmed) &&
           whole_number(given[4], &g->max_coasted) && number(given[5], &g->most.stretch) &&
           number(given[6], &g->most.threshold);
}

/* Steps from `step` on, until there is no room; where that is. Python waits for nothing meanwhile,
 * unless it is asked for pairs. */
static Py_ssize_t run(Group *g, Py_ssize_t step, Py_ssize_t stop) {
    End end = DONE;
    int64_t *scratch = malloc(sizeof(int64_t) * 6 * (size_t)(g->room + 1));
    if (!scratch) return PyErr_NoMemory(), -1;
    Py_ssize_t length = g->room + 1;
    g->frames = scratch, g->order = scratch + length, g->from = scratch + 2 * length;
    g->to = scratch + 3 * length;
    g->shares = (double *)(scratch + 4 * length), g->spare = (double *)(scratch + 5 * length);
    PyThreadState *thread = g->matching == Py_None ? PyEval_SaveThread() : NULL;
    while (step < stop && (end = one_step(g, step)) == DONE) step++;
    if (thread) PyEval_RestoreThread(thread);
    free(scratch);
    memcpy(whole(g, COUNTS), g->counts, sizeof(g->counts));
    if (end == NO_MEMORY) PyErr_NoMemory();
    if (end == NO_FIT) refuse("steps: frames or pairs do not agree");
    return end == DONE || end == NO_ROOM ? step : -1;
}

/* steps(..., start, stop, patience, patience_unconfirmed, max_coasted, stretch, threshold, matching)
 * -> the step that there was no room for, or stop. */
PyObject *steps(PyObject *module, PyObject *const *given, Py_ssize_t count) {
    (void)module;
    Array a[ALL_ARRAYS];
    Group g = {.arrays = a};
    Py_ssize_t start, stop, reached = -1;
    int taken = take(a, given, count, KINDS_OF_ARRAYS, 8);
    if (taken < 0) return NULL;
    if (settings_of(given + taken, &start, &stop, &g)) {
        if (shapes_agree(&g) && numbers_agree(&g, start, stop)) reached = run(&g, start, stop);
        else refuse("steps: shapes do not agree");
    }
    release(a, taken);
    return reached < 0 ? NULL : PyLong_FromSsize_t(reached);
}
