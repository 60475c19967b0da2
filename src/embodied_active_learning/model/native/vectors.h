/* Vector types, and feature maps that hold one image of a group in each lane of every vector. */
#pragma once

#include <stdint.h>

#ifdef __AVX__
#include <immintrin.h>
#endif

#if defined __AVX512F__
#define LANES 16
#elif defined __AVX__
#define LANES 8
#else
#define LANES 4
#endif

typedef float vec __attribute__((vector_size(4 * LANES)));
typedef float unaligned_vec __attribute__((vector_size(4 * LANES), aligned(4)));
typedef int32_t int_vec __attribute__((vector_size(4 * LANES)));

#ifdef __OPTIMIZE__
#define INLINE static inline __attribute__((always_inline))
#else /* inlining everything only slows down an unoptimised build */
#define INLINE static inline
#endif
#define UNROLL _Pragma("GCC unroll 32")

/* Load a vector, or a number into all lanes, into a register and keep it there: GCC would otherwise load it again for each
 * product, or load the factors of later products early and run out of registers. */
#if defined __AVX512F__
#define LOAD(name, from)                                                                                               \
    vec name = from;                                                                                                   \
    __asm__("" : "+v"(name))
#define LOAD_BROADCAST(name, from) LOAD(name, broadcast(from))
#elif defined __AVX__
#define LOAD(name, from)                                                                                               \
    vec name;                                                                                                          \
    __asm__("vmovaps %1, %0" : "=x"(name) : "m"(from))
#define LOAD_BROADCAST(name, from)                                                                                     \
    vec name;                                                                                                          \
    __asm__("vbroadcastss %1, %0" : "=x"(name) : "m"(from))
#else
#define LOAD(name, from) vec name = from
#define LOAD_BROADCAST(name, from) vec name = broadcast(from)
#endif

/* Activations or gradients (channels, rows, columns, LANES). Only the last stored_rows rows are in memory: row y at
 * position y & row_mask. row_mask is -1 if all rows are stored, else stored_rows - 1 with stored_rows a power of two. */
typedef struct {
    vec *values;
    int channels, rows, columns, stored_rows, row_mask;
} feature_map;

INLINE long channel_stride(const feature_map *m) { return (long)m->stored_rows * m->columns; }

INLINE vec *row(const feature_map *m, int channel, int y) {
    return m->values + ((long)channel * m->stored_rows + (y & m->row_mask)) * m->columns;
}

INLINE vec broadcast(float value) { return value - (vec){0}; } /* + would make 0 of -0, which costs an instruction */

INLINE int min(int a, int b) { return a < b ? a : b; }

/* value where `where` is positive, else 0. NaN is kept, so that a diverged network is noticed. */
INLINE vec mask_positive(vec value, vec where) { return (vec)((int_vec)value & ~(int_vec)(where <= 0.0f)); }
