/* What convolutions work on: values on the sides of layers, a group of images in the lanes of each vector. */
#pragma once

#include <stdint.h>

#ifdef __AVX512F__
#include <immintrin.h>
#define LANES 16
#else
#define LANES 8
#endif

typedef float vec __attribute__((vector_size(4 * LANES)));
typedef float loose_vec __attribute__((vector_size(4 * LANES), aligned(4)));
typedef int32_t mask __attribute__((vector_size(4 * LANES)));

#ifdef __OPTIMIZE__
#define INLINE static inline __attribute__((always_inline))
#else /* a copy for each call would only take the compiler's time */
#define INLINE static inline
#endif
#define UNROLL _Pragma("GCC unroll 32")

/* Have a vector loaded once into a register; the compiler would rather read it from memory in each product. */
#ifdef __AVX512F__
#define LOAD(name, from)                                                                                               \
    vec name = from;                                                                                                   \
    __asm__("" : "+v"(name))
#else
#define LOAD(name, from) vec name = from
#endif

/* sum += value factor, the factor from memory: the compiler would rather keep factors in registers, which are for sums. */
#ifdef __AVX512F__
#define ADD_PRODUCT(sum, value, factor)                                                                                \
    __asm__("vfmadd231ps %2%{1to16%}, %1, %0" : "+v"(sum) : "v"(value), "m"(factor))
#else
#define ADD_PRODUCT(sum, value, factor) sum += value * factor
#endif

/* Values on one side of a layer. Of its rows only `kept` are in memory, row y in place y & places: all of them with
 * places = -1, the last few in a ring with places = kept - 1, kept a power of two. */
typedef struct {
    vec *values;
    int channels, rows, columns, kept, places;
} side;

/* What happens to a value before it is stored: relu keeps what is positive, gate what is positive there (the gradient of
 * relu). totals, if wanted: sums (channels) of what is stored. */
typedef struct {
    const float *bias;
    int relu;
    const side *gate;
    vec *totals;
} finish;

/* From a channel to the next. */
INLINE long plane_of(const side *s) { return (long)s->kept * s->columns; }

INLINE vec *row(const side *s, int channel, int y) {
    return s->values + ((long)channel * s->kept + (y & s->places)) * s->columns;
}

INLINE int least(int a, int b) { return a < b ? a : b; }

/* NaN passes, so that a network that has diverged shows it. */
INLINE vec positive(vec value, vec where) { return (vec)((mask)value & ~(mask)(where <= 0.0f)); }
