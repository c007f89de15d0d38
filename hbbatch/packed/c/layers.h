/* The networks on a block of tracks, for one kind of processor. network.c takes this in once for
 * each, with NAME(x), TARGET, a REGISTER of LANES floats, how many of them lie ACROSS what is added
 * up at a time, for how many OUTPUTS, and ADD(a, b, c), which is a * b + c. All rows are `step`
 * columns long, whole registers.
 */

/* So many outputs of a tile for some columns: what is added up stays in registers. */
TARGET static inline __attribute__((always_inline)) void NAME(strip)(
    const float *weights, Py_ssize_t inputs, const float *in, float *out, int step,
    const int across) {
    REGISTER sum[OUTPUTS][ACROSS], value[ACROSS];
    UNROLLED for (int row = 0; row < OUTPUTS; row++)
        UNROLLED for (int a = 0; a < across; a++) sum[row][a] = weights[row] - (REGISTER){0};
    for (Py_ssize_t k = 0; k < inputs; k++, in += step) {
        weights += TILE_ROWS;
        UNROLLED for (int a = 0; a < across; a++)
            memcpy(&value[a], in + a * LANES, sizeof(REGISTER));
        UNROLLED for (int row = 0; row < OUTPUTS; row++)
            UNROLLED for (int a = 0; a < across; a++)
                sum[row][a] = ADD(weights[row] - (REGISTER){0}, value[a], sum[row][a]);
    }
    UNROLLED for (int row = 0; row < OUTPUTS; row++)
        UNROLLED for (int a = 0; a < across; a++)
            memcpy(out + row * step + a * LANES, &sum[row][a], sizeof(REGISTER));
}

/* What a layer makes of its inputs; the rows after it. */
TARGET static float *NAME(through)(const Layer *layer, const float *in, float *out, int step) {
    const float *weights = layer->weights;
    for (Py_ssize_t row = 0; row < layer->outputs; row += OUTPUTS) {
        int column = 0;
        for (; column + ACROSS * LANES <= step; column += ACROSS * LANES)
            NAME(strip)(weights, layer->inputs, in + column, out + column, step, ACROSS);
        for (; column < step; column += LANES)
            NAME(strip)(weights, layer->inputs, in + column, out + column, step, 1);
        weights += OUTPUTS, out += OUTPUTS * step;
        if ((row + OUTPUTS) % TILE_ROWS == 0) weights += TILE_ROWS * layer->inputs;
    }
    return out;
}

TARGET static void NAME(rectify)(float *x, const float *end) {
    for (; x < end; x++) *x = *x < 0.0f ? 0.0f : *x;
}

/* 1 / (1 + exp(-x)), within 2e-7. */
TARGET static void NAME(squash)(float *x, const float *end) {
    for (; x < end; x++) {
        float y = *x > LARGEST_POWER ? -LARGEST_POWER : -*x;
        y = y > LARGEST_POWER ? LARGEST_POWER : y;
        /* exp(y) is 2 to a whole number of times exp(rest); adding ROUNDER drops the fraction and has
         * the number in the last bits. What is not a number has some power, and stays none by its
         * rest. */
        float rounded = y * 1.44269504f + ROUNDER, times = rounded - ROUNDER;
        float rest = (y - times * LN2_HIGH) - times * LN2_LOW;
        float sum = 1.0f / 720.0f;
        sum = sum * rest + 1.0f / 120.0f;
        sum = sum * rest + 1.0f / 24.0f;
        sum = sum * rest + 1.0f / 6.0f;
        sum = sum * rest + 0.5f;
        sum = sum * rest + 1.0f;
        sum = sum * rest + 1.0f;
        uint32_t bits;
        float power;
        memcpy(&bits, &rounded, sizeof(bits));
        bits = (bits + 127) << 23;
        memcpy(&power, &bits, sizeof(power));
        *x = 1.0f / (1.0f + sum * power);
    }
}

/* The hyperbolic tangent of values given twice as large. */
TARGET static void NAME(squash_twice)(float *x, const float *end) {
    NAME(squash)(x, end);
    for (; x < end; x++) *x = 2.0f * *x - 1.0f;
}

/* Encoder, hidden layer and output of all heads; where the rates are. */
TARGET static const float *NAME(residual)(const Layer *layer, float *in, int step) {
    float *encoded = in + layer[0].inputs * step;
    float *hidden = NAME(through)(layer, in, encoded, step);
    NAME(rectify)(encoded, hidden);
    float *rates = NAME(through)(layer + 1, encoded, hidden, step);
    NAME(rectify)(hidden, rates);
    NAME(through)(layer + 2, hidden, rates, step);
    return rates;
}

/* A gated recurrent unit, whose memory is replaced, and what is said of noise; where that is. What
 * is remembered, the candidate and what is said come twice as large, for their tangents. */
TARGET static const float *NAME(gain)(const Layer *layer, float *memory, int step) {
    Py_ssize_t cells = layer[1].inputs * step;
    float *reset = memory + layer[0].inputs * step;
    float *keep = reset + layer[1].outputs * step;
    float *remembered = NAME(through)(layer, memory, reset, step);
    NAME(squash)(reset, remembered);
    float *candidate = NAME(through)(layer + 1, memory, remembered, step);
    float *said = NAME(through)(layer + 2, memory + cells, candidate, step);
    for (Py_ssize_t i = 0; i < cells; i++) candidate[i] += remembered[i] * reset[i];
    NAME(squash_twice)(candidate, candidate + cells);
    for (Py_ssize_t i = 0; i < cells; i++)
        memory[i] = (memory[i] - candidate[i]) * keep[i] + candidate[i];
    NAME(squash_twice)(said, NAME(through)(layer + 3, memory, said, step));
    return said;
}

static const Machine NAME(machine) = {NAME(residual), NAME(gain)};

#undef NAME
#undef TARGET
#undef REGISTER
#undef LANES
#undef ACROSS
#undef OUTPUTS
#undef ADD
