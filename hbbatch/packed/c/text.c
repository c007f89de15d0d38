/* Numbers as text: sinks.kitti. */
#include "arrays.h"

enum { DECIMALS = 10000, LONGEST_NUMBER = 22 };
static const double LARGEST = 1e9; /* Below, four decimals are exact in a double and in 64 bits. */

static char *put_whole(char *to, uint64_t value) {
    char digits[20];
    int count = 0;
    do digits[count++] = (char)('0' + value % 10);
    while (value /= 10);
    while (count) *to++ = digits[--count];
    return to;
}

static char *put_integer(char *to, int64_t value) {
    if (value < 0) *to++ = '-';
    return put_whole(to, value < 0 ? 0 - (uint64_t)value : (uint64_t)value);
}

/* Rounded to four decimals, without zeros at the end. */
static char *put_rounded(char *to, double value) {
    int64_t rounded = llrint(value * DECIMALS);
    uint64_t size = rounded < 0 ? 0 - (uint64_t)rounded : (uint64_t)rounded;
    unsigned rest = (unsigned)(size % DECIMALS);
    if (rounded < 0) *to++ = '-';
    to = put_whole(to, size / DECIMALS);
    if (!rest) return to;
    *to++ = '.';
    for (unsigned unit = DECIMALS / 10; rest; rest %= unit, unit /= 10)
        *to++ = (char)('0' + rest / unit);
    return to;
}

static int all_fit(const double *values, Py_ssize_t count) {
    int fit = 1;
    for (Py_ssize_t i = 0; i < count; i++) fit &= fabs(values[i]) < LARGEST;
    return fit;
}

/* Whether words lie one after the other in a text: word k from ends[k] to ends[k + 1]. */
static int are_words(const Array *ends, Py_ssize_t length) {
    const int64_t *end = ends->view.buf;
    if (ends->columns < 1 || end[0] < 0 || end[ends->columns - 1] > length) return 0;
    for (Py_ssize_t k = 1; k < ends->columns; k++)
        if (end[k] < end[k - 1]) return 0;
    return 1;
}

/* lines(frame, track, kind, words, ends, values, text) -> how many bytes of `text` were written, or
 * -1 where a value is not finite or too large. */
PyObject *lines(PyObject *module, PyObject *const *given, Py_ssize_t count) {
    (void)module;
    Array a[MOST_ARRAYS];
    int taken = take(a, given, count, "l1l1l1b1l1d2B1", 0);
    if (taken < 0) return NULL;
    Py_ssize_t n = a[0].columns, columns = a[5].rows, longest = 0, written = -1;
    const int64_t *frame = a[0].view.buf, *track = a[1].view.buf, *kind = a[2].view.buf;
    const int64_t *end = a[4].view.buf;
    const char *words = a[3].view.buf;
    const double *values = a[5].view.buf;
    if (a[1].columns != n || a[2].columns != n || a[5].columns != n ||
        !are_words(a + 4, a[3].columns) || !within(a + 2, a[4].columns - 1))
        return release(a, taken), refuse("lines: shapes do not agree");
    for (Py_ssize_t k = 1; k < a[4].columns; k++) longest = MOST(longest, end[k] - end[k - 1]);
    if (a[6].columns < n * (longest + LONGEST_NUMBER * (2 + columns)))
        return release(a, taken), refuse("lines: no room");
    char *start = a[6].view.buf, *to = start;
    Py_BEGIN_ALLOW_THREADS
    if (all_fit(values, n * columns)) {
        for (Py_ssize_t i = 0; i < n; i++) {
            size_t length = (size_t)(end[kind[i] + 1] - end[kind[i]]);
            to = put_integer(to, frame[i]);
            *to++ = ' ';
            to = put_integer(to, track[i]);
            *to++ = ' ';
            memcpy(to, words + end[kind[i]], length);
            to += length;
            for (Py_ssize_t column = 0; column < columns; column++) {
                *to++ = ' ';
                to = put_rounded(to, values[column * n + i]);
            }
            *to++ = '\n';
        }
        written = to - start;
    }
    Py_END_ALLOW_THREADS
    release(a, taken);
    return PyLong_FromSsize_t(written);
}
