/* CDR messages walked by the steps of cdr_steps: what is wanted of them goes to columns. The bytes
 * are anybody's: whatever lengths they claim, nothing is read beyond a message or written beyond a
 * column, and each element that is counted takes bytes of its message, so that a walk ends.
 */
#include "buffers.h"

/* cdr_steps.Operation, and the words of a step: what, how many bytes behind the position, and
 *     ALIGN    a multiple to go on to
 *     TAKE     a type, how many numbers, the column of the first
 *     TEXT     a column, its vocabulary; both -1 where it is not wanted
 *     NUMBERS  their size
 *     REPEAT   how many of the steps that follow are for an element, its level, a column of counts
 */
enum { ALIGN, TAKE, TEXT, NUMBERS, REPEAT };
enum { WHAT, AHEAD, FIRST, SECOND, THIRD, WORDS };
enum { I1, U1, I2, U2, I4, U4, I8, F4, F8, TYPES }; /* cdr_steps.TYPES */
enum { LENGTH = 4, HEAD = 4, DEEPEST = 32, REMEMBERED = 1024 };

static const int64_t SIZES[TYPES] = {1, 1, 2, 2, 4, 4, 8, 4, 8};
static const int64_t FARTHEST = INT64_C(1) << 40;

/* A text met before, and its code in a vocabulary. Its first and last letters tell all of it, unless
 * it is longer than both together. */
enum { TOLD = 16 };
typedef struct {
    const uint8_t *letters;
    uint64_t first, last;
    int64_t length, vocabulary, code;
} Known;

typedef struct {
    const int64_t *steps, *columns, *room; /* room: rows that a level may have */
    int64_t count, width, levels, *used, *cells, size;
    PyObject *vocabularies;
    Known known[REMEMBERED];
} Walk;

typedef struct {
    const uint8_t *bytes; /* behind the encapsulation, from where positions count */
    int64_t size, at;
} Message;

static uint32_t word(const uint8_t *b) {
    return b[0] | (uint32_t)b[1] << 8 | (uint32_t)b[2] << 16 | (uint32_t)b[3] << 24;
}

static uint64_t long_word(const uint8_t *b) { return word(b) | (uint64_t)word(b + 4) << 32; }

static int64_t bits_of(double value) {
    int64_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits;
}

static int64_t single(const uint8_t *b) {
    uint32_t bits = word(b);
    float value;
    memcpy(&value, &bits, sizeof value);
    return bits_of(value);
}

/* Numbers that lie side by side, each to its column. */
static void keep(const Walk *w, const int64_t *step, const uint8_t *b, int64_t row) {
    const int64_t *column = w->columns + step[THIRD], n = step[SECOND];
    int64_t *to = w->cells + row;
    switch (step[FIRST]) {
    case I1: for (int64_t i = 0; i < n; i++) to[column[i]] = (int8_t)b[i]; break;
    case U1: for (int64_t i = 0; i < n; i++) to[column[i]] = b[i]; break;
    case I2:
        for (int64_t i = 0; i < n; i++) to[column[i]] = (int16_t)(b[2 * i] | b[2 * i + 1] << 8);
        break;
    case U2: for (int64_t i = 0; i < n; i++) to[column[i]] = b[2 * i] | b[2 * i + 1] << 8; break;
    case I4: for (int64_t i = 0; i < n; i++) to[column[i]] = (int32_t)word(b + 4 * i); break;
    case U4: for (int64_t i = 0; i < n; i++) to[column[i]] = word(b + 4 * i); break;
    case F4: for (int64_t i = 0; i < n; i++) to[column[i]] = single(b + 4 * i); break;
    default: for (int64_t i = 0; i < n; i++) to[column[i]] = (int64_t)long_word(b + 8 * i);
    }
}

/* The code of a text that is not remembered; -1 with an exception set. */
static int64_t look_up(const Walk *w, int64_t vocabulary, const uint8_t *letters, int64_t length) {
    PyObject *texts = PyList_GetItem(w->vocabularies, (Py_ssize_t)vocabulary);
    PyObject *text = PyUnicode_DecodeUTF8((const char *)letters, (Py_ssize_t)length, NULL);
    if (!text) return -1;
    PyObject *found = PyDict_GetItemWithError(texts, text);
    int64_t code = -1;
    if (found) {
        code = PyLong_AsLongLong(found);
    } else if (!PyErr_Occurred()) {
        PyObject *number = PyLong_FromSsize_t(PyDict_Size(texts));
        if (number && !PyDict_SetItem(texts, text, number)) code = PyDict_Size(texts) - 1;
        Py_XDECREF(number);
    }
    Py_DECREF(text);
    return code;
}

/* The first eight letters, or all where there are less. */
static uint64_t first_of(const uint8_t *letters, int64_t length) {
    if (length >= 8) return long_word(letters);
    if (length >= 4) return word(letters) | (uint64_t)word(letters + length - 4) << 32;
    uint64_t all = 0;
    for (int64_t i = 0; i < length; i++) all = all << 8 | letters[i];
    return all;
}

static int64_t code_of(Walk *w, int64_t vocabulary, const uint8_t *letters, int64_t length) {
    uint64_t first = first_of(letters, length);
    uint64_t last = length > 8 ? long_word(letters + length - 8) : 0;
    uint64_t mixed = (first * 31 + last + (uint64_t)(length + 7 * vocabulary)) * 0x9E3779B97F4A7C15;
    Known *known = &w->known[mixed >> 54];
    if (known->letters && known->first == first && known->last == last &&
        known->length == length && known->vocabulary == vocabulary &&
        (length <= TOLD || !memcmp(known->letters, letters, (size_t)length)))
        return known->code;
    int64_t code = look_up(w, vocabulary, letters, length);
    if (code >= 0) *known = (Known){letters, first, last, length, vocabulary, code};
    return code;
}

/* Whether letters are UTF-8; an exception is set where they are not. */
static int are_letters(const uint8_t *letters, int64_t length) {
    uint8_t high = 0;
    for (int64_t i = 0; i < length; i++) high |= letters[i];
    if (high < 128) return 1;
    PyObject *text = PyUnicode_DecodeUTF8((const char *)letters, (Py_ssize_t)length, NULL);
    Py_XDECREF(text);
    return text != NULL;
}

/* A text, to its column where it is wanted. */
static int text(Walk *w, const int64_t *step, const uint8_t *letters, int64_t length, int64_t row) {
    if (!length || letters[length - 1]) return refuse("a text without end"), 0;
    if (step[FIRST] < 0) return are_letters(letters, length - 1);
    int64_t code = code_of(w, step[SECOND], letters, length - 1);
    if (code >= 0) w->cells[w->columns[step[FIRST]] + row] = code;
    return code >= 0;
}

static int beyond(void) { return refuse("a length leads beyond a message"), 0; }

static int go(Walk *w, int64_t first, int64_t stop, Message *m, int64_t row);

/* The elements of a sequence, rows of their level. */
static int repeat(Walk *w, int64_t step, Message *m, int64_t count) {
    int64_t level = w->steps[step * WORDS + SECOND], last = step + w->steps[step * WORDS + FIRST];
    for (int64_t i = 0; i < count; i++) {
        int64_t before = m->at;
        if (w->used[level] == w->room[level]) return beyond();
        if (!go(w, step + 1, last + 1, m, w->used[level]++)) return 0;
        if (m->at == before) return refuse("elements that take no bytes"), 0;
    }
    return 1;
}

/* Take steps for a row; 0 with an exception set where the message does not fit. */
static int go(Walk *w, int64_t first, int64_t stop, Message *m, int64_t row) {
    for (int64_t i = first; i < stop; i++) {
        const int64_t *step = w->steps + i * WORDS;
        int64_t from = m->at + step[AHEAD], length = 0;
        if (step[WHAT] == TAKE) {
            if (from + step[SECOND] * SIZES[step[FIRST]] > m->size) return beyond();
            keep(w, step, m->bytes + from, row);
            continue;
        }
        if (step[WHAT] == ALIGN) {
            m->at = from & -step[FIRST];
        } else {
            if (from + LENGTH > m->size) return beyond();
            length = word(m->bytes + from);
            m->at = from + LENGTH;
        }
        if (step[WHAT] == TEXT) m->at += length;
        if (step[WHAT] == NUMBERS && length)
            m->at = ((m->at + step[FIRST] - 1) & -step[FIRST]) + length * step[FIRST];
        if (m->at > m->size) return beyond();
        if (step[WHAT] == TEXT) {
            if (!text(w, step, m->bytes + from + LENGTH, length, row)) return 0;
        } else if (step[WHAT] == REPEAT) {
            w->cells[w->columns[step[THIRD]] + row] = length;
            if (!repeat(w, i, m, length)) return 0;
            i += step[FIRST];
        }
    }
    return 1;
}

/* Whether columns, and all rows that their level may have, are there. */
static int has(const Walk *w, int64_t first, int64_t count, int64_t level) {
    if (first < 0 || count < 1 || count > w->width || first > w->width - count) return 0;
    for (int64_t i = first; i < first + count; i++)
        if (w->columns[i] < 0 || w->columns[i] > w->size - w->room[level]) return 0;
    return 1;
}

static int is_size(int64_t size) { return size == 1 || size == 2 || size == 4 || size == 8; }

/* Whether steps lead nowhere beyond what is there. */
static int sound(const Walk *w, int64_t first, int64_t stop, int64_t level, int depth) {
    if (depth > DEEPEST) return 0;
    for (int64_t i = first; i < stop; i++) {
        const int64_t *step = w->steps + i * WORDS;
        if (step[AHEAD] < 0 || step[AHEAD] > FARTHEST) return 0;
        switch (step[WHAT]) {
        case TAKE:
            if (step[FIRST] < 0 || step[FIRST] >= TYPES) return 0;
            if (!has(w, step[THIRD], step[SECOND], level)) return 0;
            break;
        case TEXT:
            if (step[FIRST] == -1) break;
            if (step[SECOND] < 0 || step[SECOND] >= PyList_Size(w->vocabularies)) return 0;
            if (!has(w, step[FIRST], 1, level)) return 0;
            break;
        case ALIGN:
        case NUMBERS:
            if (!is_size(step[FIRST])) return 0;
            break;
        case REPEAT:
            if (step[FIRST] < 0 || step[FIRST] >= stop - i) return 0;
            if (step[SECOND] < 1 || step[SECOND] >= w->levels) return 0;
            if (!has(w, step[THIRD], 1, level)) return 0;
            if (!sound(w, i + 1, i + 1 + step[FIRST], step[SECOND], depth + 1)) return 0;
            i += step[FIRST];
            break;
        default: return 0;
        }
    }
    return 1;
}

static int are_dicts(PyObject *list) {
    if (!PyList_Check(list)) return 0;
    for (Py_ssize_t i = 0; i < PyList_Size(list); i++)
        if (!PyDict_Check(PyList_GetItem(list, i))) return 0;
    return 1;
}

static int all(Walk *w, const Array *buffer, const Array *starts, const Array *ends) {
    const int64_t *start = starts->view.buf, *end = ends->view.buf;
    for (int64_t row = 0; row < starts->columns; row++) {
        if (start[row] < 0 || start[row] > end[row] || end[row] > buffer->columns)
            return refuse("walk: messages reach beyond the buffer"), 0;
        const uint8_t *head = (const uint8_t *)buffer->view.buf + start[row];
        if (end[row] - start[row] < HEAD || head[0] != 0 || head[1] != 1)
            return refuse("not plain little endian CDR"), 0;
        Message m = {head + HEAD, end[row] - start[row] - HEAD, 0};
        if (!go(w, 0, w->count, &m, row)) return 0;
        /* Writers may fill up a message to a multiple of the length of its head. */
        if (m.size - m.at >= HEAD) return refuse("a message is longer than its definition"), 0;
    }
    return 1;
}

/* walk(steps, buffer, starts, ends, columns, rows, cells, vocabularies); cdr_walk.CdrWalk.read. */
static PyObject *walk(PyObject *module, PyObject *const *given, Py_ssize_t count) {
    (void)module;
    Array a[MOST_ARRAYS];
    int taken = take(a, given, count, "l2b1l1l1l1L2L1", 1);
    if (taken < 0) return NULL;
    int64_t *rows = a[5].view.buf;
    Walk w = {
        .steps = a[0].view.buf, .count = a[0].rows, .columns = a[4].view.buf, .width = a[4].columns,
        .room = rows, .used = rows + a[5].columns, .levels = a[5].columns, .cells = a[6].view.buf,
        .size = a[6].columns, .vocabularies = given[7],
    };
    int fits = a[0].columns == WORDS && a[2].columns == a[3].columns && a[5].rows == 2 &&
               w.levels > 0 && w.room[0] >= a[2].columns && are_dicts(w.vocabularies);
    for (int64_t level = 0; fits && level < w.levels; level++) {
        fits = w.room[level] >= 0 && w.room[level] <= w.size;
        w.used[level] = level ? 0 : a[2].columns;
    }
    if (!fits || !sound(&w, 0, w.count, 0, 0))
        return release(a, taken), refuse("walk: arguments do not agree");
    int done = all(&w, a + 1, a + 2, a + 3);
    release(a, taken);
    if (!done) return NULL;
    Py_RETURN_NONE;
}

static PyMethodDef methods[] = {METHOD(walk), {NULL, NULL, 0, NULL}};

static PyModuleDef_Slot slots[] = {{0, NULL}};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "_cdr", NULL, 0, methods, slots, NULL, NULL, NULL,
};

PyMODINIT_FUNC PyInit__cdr(void) { return PyModuleDef_Init(&definition); }
