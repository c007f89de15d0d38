/* What a filter is made of, and how its tracks begin. */
#include "filter.h"

/* Whether a layout's parts lie within a state of so many rows, and those side by side that networks
 * see. */
static int lies_within(const Array *layout, Py_ssize_t rows, int learned) {
    const int64_t *l = layout->view.buf;
    Py_ssize_t length = layout->columns - LAYOUT_LENGTH;
    if (length < 0 || length % 2 || l[ORDER] < 2 || l[ORDER] > 3) return 0;
    for (Py_ssize_t i = LAYOUT_LENGTH; i < layout->columns; i++)
        if (l[i] < 0 || l[i] >= blocks_of(l)) return 0;
    int extent[LAYOUT_LENGTH] = {
        [VELOCITY] = AXES, [ACCELERATION] = AXES * (int)(l[ORDER] - 2),
        [SIZE_VARIANCE] = 3 + AXES, [COVARIANCE] = AXES * (int)blocks_of(l), [VOTE] = 1,
        [NOISE] = AXES, [SIZE_NOISE] = 3, [CORRECTION] = BOX, [LOG_SIZE] = 3, [ELAPSED] = 2,
        [TENTHS] = 1, [HISTORY] = BOX, [Q] = AXES, [LEARNED] = 1, [COUNTERS] = 2, [INVERSE_DT] = 1,
    };
    for (int name = VELOCITY; name < (learned ? LAYOUT_LENGTH : CORRECTION); name++)
        if (l[name] < 0 || l[name] > rows - extent[name]) return 0;
    return l[COVARIANCE] == l[SIZE_VARIANCE] + 3 &&
           (!learned || (l[TENTHS] == l[ELAPSED] + 2 && l[VELOCITY] == l[TENTHS] + 1 &&
                         l[HISTORY] == l[VELOCITY] + AXES && l[HISTORY_END] >= l[HISTORY] + BOX &&
                         (l[HISTORY_END] - l[HISTORY]) % BOX == 0 && l[HISTORY_END] <= rows));
}

/* Whether the residual predictor's layers fit to each other and to a state. */
static int predicts(const Array *weights, Filter *filter) {
    const int64_t *l = filter->layout;
    return filter->residual_limit->columns <= l[HISTORY_END] &&
           layers_of(weights, 3, l[HISTORY_END], filter->residual) &&
           filter->residual[2].outputs >= SAID;
}

/* Whether the gain network's layers do. */
static int gains(const Array *weights, Filter *filter) {
    Layer *layers = filter->gain;
    Py_ssize_t memory = filter->layout[ONE], width = filter->layout[ELAPSED] + 2 + GAIN_ROWS;
    Py_ssize_t cells = (memory + TILE_ROWS - 1) / TILE_ROWS * TILE_ROWS;
    layers[1].inputs = layers[3].inputs = memory, layers[2].inputs = width - memory;
    return memory > 0 && width > memory && filter->gain_limit->columns <= width &&
           layers_of(weights, 4, width, layers) && layers[0].outputs == 2 * cells &&
           layers[1].outputs == cells && layers[2].outputs == cells &&
           (!layers[3].outputs || layers[3].outputs >= 2 * AXES);
}

int filter_of(const Array *arrays, Filter *filter) {
    const Array *layout = arrays + LAYOUT, *newborn = arrays + NEWBORN;
    *filter = (Filter){.layout = layout->view.buf, .newborn = newborn,
                       .mixed = (layout->columns - LAYOUT_LENGTH) / 2,
                       .learned = arrays[RESIDUAL_LAYERS].rows > 0,
                       .residual_limit = arrays + RESIDUAL_LIMIT,
                       .gain_limit = arrays + GAIN_LIMIT};
    return lies_within(layout, newborn->rows, filter->learned) &&
           (!filter->learned || (predicts(arrays + RESIDUAL_LAYERS, filter) &&
                                 gains(arrays + GAIN_LAYERS, filter)));
}

Tracks some(const Filter *filter, const Columns *columns, Py_ssize_t start, Py_ssize_t all) {
    return (Tracks){filter->layout, columns->boxes + start, columns->state + start,
                    columns->box_step, columns->step, filter->mixed, blocks_of(filter->layout),
                    (int)LEAST(all - start, BLOCK)};
}

FOR_EACH_PROCESSOR void birth(const Filter *filter, const Columns *columns, const Known *known,
                              const int64_t *detections, Py_ssize_t first, Py_ssize_t n) {
    const Array *newborn = filter->newborn;
    for (Py_ssize_t start = 0; start < n; start += BLOCK) {
        Tracks t = some(filter, columns, start, n);
        const int64_t *from = detections + start;
        t.boxes += first, t.state += first;
        for (Py_ssize_t row = 0; row < newborn->rows; row++) {
            const float *value = (const float *)newborn->view.buf + row * newborn->columns;
            for (int j = 0; j < t.n; j++) t.state[row * t.step + j] = value[known->kinds[from[j]]];
        }
        for (int row = 0; row < BOX; row++) {
            for (int j = 0; j < t.n; j++)
                t.boxes[row * t.box_step + j] = known->measured[BOX * from[j] + FIELD[row]];
            of_detections(known->seen, row, from, t.n, part(&t, SIZE_VARIANCE) + row * t.step);
        }
        for (int row = 0; filter->learned && row < 3; row++)
            for (int j = 0; j < t.n; j++) {
                double size_m = MOST(t.boxes[row * t.box_step + j], SMALLEST_SIZE_M);
                part(&t, LOG_SIZE)[row * t.step + j] = logarithm((float)size_m);
            }
    }
}
