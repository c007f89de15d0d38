/* The two networks (packed.network) on a block of tracks, so that what lies between two layers stays
 * in the cache. Weights come in tiles of TILE_ROWS outputs: a row with their biases, then one for
 * each input.
 */
#ifndef HBBATCH_NETWORK_H
#define HBBATCH_NETWORK_H

#include "state.h"

enum { TILE_ROWS = 8, WIDEST = 16 };
enum { MOST_ROWS = 1024, LINE = 64 }; /* packed.network */

/* Scratch for all rows of a network, on the stack: nothing is allocated in a step. Registers that
 * lie across two lines of the cache are loaded at half the speed, so it begins with one. */
#define SCRATCH(name) _Alignas(LINE) float name[MOST_ROWS * BLOCK]

/* Outputs are whole tiles; there may be none. */
typedef struct {
    const float *weights;
    Py_ssize_t inputs, outputs;
} Layer;

/* How one kind of processor computes the networks, given rows of inputs with room after them. */
typedef struct {
    /* Encoder, hidden layer and output of all heads; where the rates are. */
    const float *(*residual)(const Layer *layer, float *in, int step);
    /* Gates, what is remembered, candidate and read-out of a gated recurrent unit: its memory, the
     * first rows, is replaced; where what it says of noise is. */
    const float *(*gain)(const Layer *layer, float *in, int step);
} Machine;

const Machine *this_machine(void);

/* Layers of so many arrays; each takes the inputs that are given with it, or else the outputs of
 * the one before it, the first one `inputs`. Whether they fit, and into the scratch. */
int layers_of(const Array *weights, int count, Py_ssize_t inputs, Layer *layers);

/* Length of rows of n columns that are whole registers. */
static inline int whole_registers(int n) { return (n + WIDEST - 1) / WIDEST * WIDEST; }

/* Zeros beyond the first n columns of so many rows. */
void fill_up(float *rows, Py_ssize_t count, int n);

#endif
