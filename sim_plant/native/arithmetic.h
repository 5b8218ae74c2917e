/* Functions of numbers, operation by operation as in exact_trigonometry.py, number.py and noise.py of
 * sim_plant/physics: IEEE 754 then gives the same bits. */
#include <fenv.h>
#include <math.h>
#include <stdint.h>

#ifdef __FAST_MATH__
#error "-ffast-math changes the bits"
#endif
#if !defined(__FLT_EVAL_METHOD__) || __FLT_EVAL_METHOD__ != 0
#error "doubles must be rounded to double after every operation"
#endif

#define TURN 6.283185307179586
#define TO_INTEGER 6755399441055744.0

typedef struct {
    double first, inner, last; /* at the beginning, in the middle and at the end of a step */
} triple;

static inline double greater(double a, double b) { return a > b ? a : b; }
static inline double direction(double value) { return copysign(1.0, value); }

static inline double sine_of(double angle) {
    double x2 = angle * angle;
    double series = -7.647163731819816e-13 + x2 * 2.8114572543455206e-15;
    series = 1.6059043836821613e-10 + x2 * series;
    series = -2.505210838544172e-08 + x2 * series;
    series = 2.7557319223985893e-06 + x2 * series;
    series = -0.0001984126984126984 + x2 * series;
    series = 0.008333333333333333 + x2 * series;
    series = -0.16666666666666666 + x2 * series;
    return angle + angle * (x2 * series);
}

static inline double cosine_of(double angle) {
    double x2 = angle * angle;
    double series = 4.779477332387385e-14 + x2 * -1.5619206968586225e-16;
    series = -1.1470745597729725e-11 + x2 * series;
    series = 2.08767569878681e-09 + x2 * series;
    series = -2.755731922398589e-07 + x2 * series;
    series = 2.48015873015873e-05 + x2 * series;
    series = -0.001388888888888889 + x2 * series;
    series = 0.041666666666666664 + x2 * series;
    return 1.0 + x2 * (x2 * series - 0.5);
}

static inline void sincos_turns(double turns, double *sine, double *cosine) {
    double fraction = turns - (turns + TO_INTEGER - TO_INTEGER);
    double quarter = 4.0 * fraction + TO_INTEGER - TO_INTEGER;
    double angle = (fraction - 0.25 * quarter) * TURN;
    double s = sine_of(angle), c = cosine_of(angle);
    if (quarter == 0.0) {
        *sine = s, *cosine = c;
    } else if (quarter == 1.0) {
        *sine = c, *cosine = -s;
    } else if (quarter == -1.0) {
        *sine = -c, *cosine = s;
    } else {
        *sine = -s, *cosine = -c;
    }
}

static inline double decay(double a) {
    double quarter = 1.0 / (1.0 + a * (0.25 + a * (0.03125 + a * (0.0026041666666666665 + a * 0.00016276041666666666))));
    double square = quarter * quarter;
    return square * square;
}

static inline double decay_with_mean(double a, double *mean) {
    double rising = 0.25 + a * (0.03125 + a * (0.0026041666666666665 + a * 0.00016276041666666666));
    double quarter = 1.0 / (1.0 + a * rising);
    double square = quarter * quarter;
    *mean = rising * quarter * (1.0 + quarter) * (1.0 + square);
    return square * square;
}

static inline uint64_t mixed(uint64_t z) {
    z = (z ^ z >> 30) * UINT64_C(0xBF58476D1CE4E5B9);
    z = (z ^ z >> 27) * UINT64_C(0x94D049BB133111EB);
    return z ^ z >> 31;
}

/* The count-th number of a stream: mean 0, variance 1. */
static double normal(uint64_t key, uint64_t count) {
    uint64_t place = key + count * UINT64_C(0x9E3779B97F4A7C15);
    uint64_t ones = mixed(place), more = mixed(~place);
    double number = (double)__builtin_popcountll(ones) - 32.0 + ((double)(more >> 11) * 0x1p-53 - 0.5);
    return number * 0.24935149047701485;
}
