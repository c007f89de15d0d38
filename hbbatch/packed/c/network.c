/* What network.h declares. */
#include "network.h"

#define LARGEST_POWER 80.0f
#define ROUNDER 12582912.0f /* 1.5 * 2^23: floats that large are whole */

#if !defined(MOST_LANES) && defined(__x86_64__)
#define MOST_LANES 16 /* tests compile it with less */
#endif

#if MOST_LANES >= 16
#include <immintrin.h>
typedef float Sixteen __attribute__((vector_size(64)));
#define NAME(x) x##_avx512
#define TARGET __attribute__((target("avx512f,avx2,fma")))
#define REGISTER Sixteen
#define LANES 16
#define ACROSS 3
#define OUTPUTS 8
#define ADD(a, b, c) (Sixteen) _mm512_fmadd_ps((__m512)(a), (__m512)(b), (__m512)(c))
#include "layers.h"
#endif

#if MOST_LANES >= 8
#include <immintrin.h>
typedef float Eight __attribute__((vector_size(32)));
#define NAME(x) x##_avx2
#define TARGET __attribute__((target("avx2,fma")))
#define REGISTER Eight
#define LANES 8
#define ACROSS 2
#define OUTPUTS 4
#define ADD(a, b, c) (Eight) _mm256_fmadd_ps((__m256)(a), (__m256)(b), (__m256)(c))
#include "layers.h"
#endif

typedef float Four __attribute__((vector_size(16)));
#define NAME(x) x##_any
#define TARGET
#define REGISTER Four
#define LANES 4
#define ACROSS 2
#define OUTPUTS 4
#define ADD(a, b, c) ((a) * (b) + (c))
#include "layers.h"

const Machine *this_machine(void) {
#if MOST_LANES >= 16
    if (__builtin_cpu_supports("avx512f")) return &machine_avx512;
#endif
#if MOST_LANES >= 8
    if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) return &machine_avx2;
#endif
    return &machine_any;
}

int layers_of(const Array *weights, int count, Py_ssize_t inputs, Layer *layers) {
    Py_ssize_t rows = inputs;
    int fit = inputs > 0;
    for (int i = 0; fit && i < count; i++) {
        Layer *l = layers + i;
        if (l->inputs == 0) l->inputs = i ? l[-1].outputs : inputs;
        l->weights = weights[i].view.buf;
        fit = l->inputs > 0 && weights[i].columns == TILE_ROWS &&
              weights[i].rows % (1 + l->inputs) == 0;
        if (fit) rows += l->outputs = weights[i].rows / (1 + l->inputs) * TILE_ROWS;
    }
    return fit && rows <= MOST_ROWS;
}

void fill_up(float *rows, Py_ssize_t count, int n) {
    int step = whole_registers(n);
    for (Py_ssize_t row = 0; row < count && n < step; row++)
        memset(rows + row * step + n, 0, sizeof(float) * (size_t)(step - n));
}
