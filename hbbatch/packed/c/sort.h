/* Sorting by merging, compiled for a type and an order. */
#ifndef HBBATCH_SORT_H
#define HBBATCH_SORT_H

/* So many items are sorted by insertion. */
enum { SHORT_RUN = 12 };

/* name(items, spare, n): sort items, equal ones as they are; `spare` is room for them, and
 * `before(a, b)` whether one belongs before another. */
#define DEFINE_SORT(name, Item, before)                                              \
    static void name(Item *items, Item *spare, Py_ssize_t n) {                       \
        for (Py_ssize_t start = 0; start < n; start += SHORT_RUN)                    \
            for (Py_ssize_t i = start + 1; i < LEAST(start + SHORT_RUN, n); i++) {   \
                Item item = items[i];                                                \
                Py_ssize_t to = i;                                                   \
                for (; to > start && before(&item, items + to - 1); to--)            \
                    items[to] = items[to - 1];                                       \
                items[to] = item;                                                    \
            }                                                                        \
        for (Py_ssize_t run = SHORT_RUN; run < n; run *= 2)                          \
            for (Py_ssize_t start = 0; start + run < n; start += 2 * run) {          \
                Item *first = spare, *end = spare + run, *to = items + start;        \
                Item *second = to + run, *stop = items + LEAST(start + 2 * run, n);  \
                memcpy(first, to, sizeof(Item) * (size_t)run);                       \
                while (first < end)                                                  \
                    *to++ = second < stop && before(second, first) ? *second++       \
                                                                   : *first++;       \
            }                                                                        \
    }

#endif
