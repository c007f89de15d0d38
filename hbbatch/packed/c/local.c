/* Local least squares: tracking.local_fit. */
#include "arrays.h"

enum { MOST_COLUMNS = 8 };
static const double RIDGE = 1e-8; /* Keeps what too few neighbours tell solvable: no slope. */

/* Weighted sums over the neighbours of a row, itself included. */
typedef struct {
    double of_time[5];
    double of_values[3][MOST_COLUMNS];
} Moments;

static inline void add_neighbour(Moments *sums, double apart, double weight, const double *value,
                                 const double *middle, int columns) {
    double inside = 1.0 - apart * apart, power = weight * inside * inside;
    double first = power * apart, second = first * apart;
    sums->of_time[0] += power;
    sums->of_time[1] += first;
    sums->of_time[2] += second;
    sums->of_time[3] += second * apart;
    sums->of_time[4] += second * apart * apart;
    for (int c = 0; c < columns; c++) {
        double step = value[c] - middle[c];
        sums->of_values[0][c] += power * step;
        sums->of_values[1][c] += first * step;
        sums->of_values[2][c] += second * step;
    }
}

/* The parabola of least squares where the row itself is, by elimination. */
static inline void solve(const Moments *sums, const double *middle, double *fitted, int columns) {
    const double *m = sums->of_time;
    double ridge = RIDGE * m[0], a = m[1] / m[0], b = m[2] / m[0];
    double slope = m[2] + ridge - a * m[1], c = (m[3] - a * m[2]) / slope;
    double bend = m[4] + ridge - b * m[2] - c * (m[3] - a * m[2]);
    for (int k = 0; k < columns; k++) {
        double level = sums->of_values[0][k];
        double second = sums->of_values[1][k] - a * level;
        double third = (sums->of_values[2][k] - b * level - c * second) / bend;
        second = second / slope - c * third;
        fitted[k] = middle[k] + level / m[0] - a * second - b * third;
    }
}

static inline void fit(const int64_t *owner, const double *time, const double *values,
                       const double *weight, double *fitted, Py_ssize_t rows, int columns,
                       double reach) {
    double per_s = 1.0 / reach;
    for (Py_ssize_t i = 0; i < rows; i++) {
        const double *middle = values + i * columns;
        Moments sums = {{0.0}, {{0.0}}};
        add_neighbour(&sums, 0.0, weight[i], middle, middle, columns);
        for (int side = -1; side <= 1; side += 2)
            for (Py_ssize_t j = i + side; j >= 0 && j < rows && owner[j] == owner[i]; j += side) {
                double apart = (time[j] - time[i]) * per_s;
                if (!(fabs(apart) < 1.0)) break;
                add_neighbour(&sums, apart, weight[j], values + j * columns, middle, columns);
            }
        solve(&sums, middle, fitted + i * columns, columns);
    }
}

/* local_fit(owner, time_s, values, weights, fitted, reach_s) -> None */
FOR_EACH_PROCESSOR PyObject *local_fit(PyObject *module, PyObject *const *given, Py_ssize_t count) {
    (void)module;
    Array a[MOST_ARRAYS];
    int taken = take(a, given, count, "l1d1d2d1D2", 1);
    if (taken < 0) return NULL;
    double reach;
    if (!number(given[taken], &reach)) return release(a, taken), NULL;
    Py_ssize_t n = a[0].columns, columns = a[2].columns;
    if (a[1].columns != n || a[2].rows != n || a[3].columns != n || a[4].rows != n ||
        a[4].columns != columns || columns > MOST_COLUMNS || !(reach > 0.0))
        return release(a, taken), refuse("local_fit: shapes do not agree");
    const int64_t *owner = a[0].view.buf;
    const double *time = a[1].view.buf, *values = a[2].view.buf, *weight = a[3].view.buf;
    double *fitted = a[4].view.buf;
    Py_BEGIN_ALLOW_THREADS
    /* The number of columns is known where it matters, so that the loops over them are unrolled. */
    if (columns == 5) fit(owner, time, values, weight, fitted, n, 5, reach);
    else if (columns == 3) fit(owner, time, values, weight, fitted, n, 3, reach);
    else fit(owner, time, values, weight, fitted, n, (int)columns, reach);
    Py_END_ALLOW_THREADS
    release(a, taken);
    Py_RETURN_NONE;
}
