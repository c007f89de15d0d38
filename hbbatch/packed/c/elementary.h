/* Elementary functions without branches: the compiler makes loops of them that compute several at
 * once, where those of the C library are called for one after the other.
 */
#ifndef HBBATCH_ELEMENTARY_H
#define HBBATCH_ELEMENTARY_H

#include <stdint.h>
#include <string.h>

#define PI 3.14159265358979323846
#define HALF_PI_HIGH 1.5707963267341256 /* 33 bits: times a whole number it is exact */
#define HALF_PI_LOW 6.077100506506192e-11
#define WHOLE 6755399441055744.0 /* 1.5 * 2^52: doubles that large are whole */
#define LN2_HIGH 0.693359375f
#define LN2_LOW -2.12194440e-4f

static inline double with_sign(double value, uint64_t negative) {
    uint64_t bits;
    memcpy(&bits, &value, sizeof(bits));
    bits ^= negative << 63;
    memcpy(&value, &bits, sizeof(value));
    return value;
}

/* Within 1e-15 for angles up to some millions, in rad: by quarter turns, and Taylor's series for
 * what is left, which is at most an eighth. */
static inline void cosine_and_sine(double angle, double *cosine, double *sine) {
    double shifted = angle * (2.0 / PI) + WHOLE, quarters = shifted - WHOLE;
    double x = (angle - quarters * HALF_PI_HIGH) - quarters * HALF_PI_LOW, z = x * x;
    double c = 1.0 / 20922789888000.0, s = -1.0 / 1307674368000.0;
    c = c * z - 1.0 / 87178291200.0, s = s * z + 1.0 / 6227020800.0;
    c = c * z + 1.0 / 479001600.0, s = s * z - 1.0 / 39916800.0;
    c = c * z - 1.0 / 3628800.0, s = s * z + 1.0 / 362880.0;
    c = c * z + 1.0 / 40320.0, s = s * z - 1.0 / 5040.0;
    c = c * z - 1.0 / 720.0, s = s * z + 1.0 / 120.0;
    c = c * z + 1.0 / 24.0, s = s * z - 1.0 / 6.0;
    c = c * z - 0.5, s = s * z * x + x;
    c = c * z + 1.0;
    uint64_t quarter;
    memcpy(&quarter, &shifted, sizeof(quarter));
    *cosine = with_sign(quarter & 1 ? s : c, (quarter + 1) >> 1 & 1);
    *sine = with_sign(quarter & 1 ? c : s, quarter >> 1 & 1);
}

/* Of positive numbers, within 1e-7 or a few units in the last place; -88 of zero. Of others nothing
 * is said but that what is not a number stays none. */
static inline float logarithm(float x) {
    uint32_t bits;
    memcpy(&bits, &x, sizeof(bits));
    /* x is 2^power times m, which lies between the roots of 1/2 and 2. */
    uint32_t above = bits - 0x3f3504f3u, power = above & 0xff800000u;
    float m, times = (float)((int32_t)power / (1 << 23));
    bits -= power;
    memcpy(&m, &bits, sizeof(m));
    float s = (m - 1.0f) / (m + 1.0f), z = s * s;
    float series = 1.0f / 9.0f;
    series = series * z + 1.0f / 7.0f;
    series = series * z + 1.0f / 5.0f;
    series = series * z + 1.0f / 3.0f;
    series = 2.0f * (s * z * series + s);
    return times * LN2_HIGH + (times * LN2_LOW + series) + (x - x);
}

/* How many whole periods there are below a value. */
static inline double whole_periods(double value, double period) {
    double shifted = value / period + WHOLE, nearest = shifted - WHOLE;
    return nearest * period > value ? nearest - 1.0 : nearest;
}

#endif
