/* Strided convolution, transposed convolution and the gradient of their weights, on rows of feature maps.
 *
 * A layer lies between an outer feature map (nearer the image, larger) and an inner one (nearer the latents, smaller):
 * conv computes inner from outer, conv_transpose outer from inner, both with the same weights. The decoder's layers use
 * them the other way round than the encoder's, and the gradient of one by its input is the other. */
#pragma once

#include "vectors.h"

/* Weights as (input channel, ky, kx, output channel) for each direction, and the bias of the forward pass. */
typedef struct {
    int kernel, stride;
    const float *conv_weight, *conv_transpose_weight, *bias;
} conv_layer;

/* Applied to each value before it is stored: bias, ReLU, and the mask of a ReLU's output (the gradient of ReLU).
 * channel_sums (channels) accumulates the stored values: the gradient of a bias. Null pointers are skipped. */
typedef struct {
    const float *bias;
    int relu;
    const feature_map *mask;
    vec *channel_sums;
} epilogue;

/* The functions below compute tiles of N output channels, o to o + N - 1, times P columns: as many sums as there are
 * vector registers. x is the tile's first column and `step` the distance between its columns. */
#define START_TILE(N, P)                                                                                               \
    vec sum[P][N];                                                                                                     \
    UNROLL for (int p = 0; p < P; p++) UNROLL for (int n = 0; n < N; n++)                                              \
        sum[p][n] = (vec){0} + (e->bias ? e->bias[o + n] : 0.0f);

#define ADD_PRODUCTS(N, P, value, step, weight)                                                                        \
    UNROLL for (int p = 0; p < P; p++) {                                                                               \
        LOAD(factor, (value)[p * (step)]);                                                                             \
        UNROLL for (int n = 0; n < N; n++) sum[p][n] += factor * (weight)[n];                                          \
    }

#define STORE_TILE(N, P, x, step)                                                                                      \
    UNROLL for (int n = 0; n < N; n++) {                                                                               \
        vec *target = row(out, o + n, y) + (x), channel_sum = {0};                                                     \
        const vec *mask = e->mask ? row(e->mask, o + n, y) + (x) : 0;                                                  \
        UNROLL for (int p = 0; p < P; p++) {                                                                           \
            vec value = sum[p][n];                                                                                     \
            if (e->relu) value = mask_positive(value, value);                                                          \
            if (mask) value = mask_positive(value, mask[p * (step)]);                                                  \
            target[p * (step)] = value;                                                                                \
            channel_sum += value;                                                                                      \
        }                                                                                                              \
        if (e->channel_sums) e->channel_sums[o + n] += channel_sum;                                                    \
    }

#define CONV_TILE(N, P)                                                                                                \
    INLINE void conv_tile_##N##_##P(const feature_map *in, const feature_map *out, const conv_layer *l, int k, int s,   \
                                    const epilogue *e, int o, int y, int x) {                                          \
        int O = out->channels;                                                                                         \
        START_TILE(N, P)                                                                                               \
        for (int c = 0; c < in->channels; c++)                                                                         \
            for (int ky = 0; ky < k; ky++) {                                                                           \
                const vec *value = row(in, c, y * s + ky) + x * s;                                                     \
                const float *weight = l->conv_weight + (long)(c * k + ky) * k * O + o;                                 \
                for (int kx = 0; kx < k; kx++, weight += O) ADD_PRODUCTS(N, P, value + kx, s, weight)                  \
            }                                                                                                          \
        STORE_TILE(N, P, x, 1)                                                                                         \
    }

/* Columns x = first * s + phase, x + s, ...: inner column first - i reaches the first of them with kernel column
 * phase + i s. */
#define CONV_TRANSPOSE_TILE(N, P)                                                                                      \
    INLINE void conv_transpose_tile_##N##_##P(const feature_map *in, const feature_map *out, const conv_layer *l,       \
                                              int k, int s, const epilogue *e, int o, int y, int first, int phase) {   \
        int O = out->channels;                                                                                         \
        long stride = channel_stride(in);                                                                              \
        START_TILE(N, P)                                                                                               \
        for (int ky = y % s, iy = y / s; ky < k && iy >= 0; ky += s, iy--) {                                           \
            if (iy >= in->rows) continue;                                                                              \
            for (int kx = phase, ix = first; kx < k && ix >= 0; kx += s, ix--) {                                       \
                if (P == 1 && ix >= in->columns) continue;                                                             \
                const vec *value = row(in, 0, iy) + ix;                                                                \
                const float *weight = l->conv_transpose_weight + (long)(ky * k + kx) * O + o;                          \
                for (int c = 0; c < in->channels; c++, value += stride, weight += (long)k * k * O)                     \
                    ADD_PRODUCTS(N, P, value, 1, weight)                                                               \
            }                                                                                                          \
        }                                                                                                              \
        STORE_TILE(N, P, first * s + phase, s)                                                                         \
    }

#define TILES(KIND) KIND(5, 4) KIND(5, 1) KIND(3, 4) KIND(3, 1) KIND(1, 4) KIND(1, 1)

TILES(CONV_TILE)
TILES(CONV_TRANSPOSE_TILE)
CONV_TRANSPOSE_TILE(3, 8)

/* All channels of P columns, so that their inputs stay in the first-level cache. */
#define ALL_CHANNELS(KIND, P, ...)                                                                                     \
    for (int o = 0; o < out->channels;) {                                                                              \
        int left = out->channels - o;                                                                                  \
        if (left >= 5) KIND##_5_##P(in, out, l, k, s, e, o, y, __VA_ARGS__), o += 5;                                   \
        else if (left >= 3) KIND##_3_##P(in, out, l, k, s, e, o, y, __VA_ARGS__), o += 3;                              \
        else KIND##_1_##P(in, out, l, k, s, e, o, y, __VA_ARGS__), o += 1;                                             \
    }

INLINE void conv_rows_of(const feature_map *in, const feature_map *out, const conv_layer *l, int k, int s,
                         const epilogue *e, int from, int to) {
    for (int y = from; y < to; y++) {
        int x = 0;
        for (; x + 4 <= out->columns; x += 4) ALL_CHANNELS(conv_tile, 4, x)
        for (; x < out->columns; x++) ALL_CHANNELS(conv_tile, 1, x)
    }
}

INLINE void conv_transpose_rows_of(const feature_map *in, const feature_map *out, const conv_layer *l, int k, int s,
                                   const epilogue *e, int from, int to) {
    int taps = (k + s - 1) / s, columns = min(in->columns, out->columns / s);
    for (int y = from; y < to; y++)
        for (int first = 0, next; first * s < out->columns; first = next) {
            /* Wide tiles only where the input has all columns of all taps. */
            int inside = first < taps - 1 ? 0 : columns - first;
            int tile = inside >= 8 && out->channels == 3 ? 8 : inside >= 4 ? 4 : 0;
            next = first + (tile ? tile : 1);
            UNROLL for (int phase = 0; phase < s; phase++) {
                if (tile == 8) conv_transpose_tile_3_8(in, out, l, k, s, e, 0, y, first, phase);
                else if (tile) ALL_CHANNELS(conv_transpose_tile, 4, first, phase)
                else if (first * s + phase < out->columns) ALL_CHANNELS(conv_transpose_tile, 1, first, phase)
            }
        }
}

/* The weight gradient is summed over blocks of the inner map that fit into the first-level cache. */
#define BLOCK_ROWS 2
#define BLOCK_COLUMNS 16

/* Gradients of N inner channels from a on, outer channel b, kernel row ky and K kernel columns from kx on. */
#define WEIGHT_GRADIENT_TILE(N, K)                                                                                     \
    INLINE void weight_gradient_tile_##N##_##K(const feature_map *inner, const feature_map *outer, int s, int a, int b, \
                                               int ky, int kx, int y, int rows, int x, int columns, vec *out,          \
                                               long step) {                                                            \
        vec sum[N][K];                                                                                                 \
        UNROLL for (int n = 0; n < N; n++) UNROLL for (int i = 0; i < K; i++) sum[n][i] = out[n * step + i];           \
        long stride = channel_stride(inner);                                                                           \
        for (int end = y + rows; y < end; y++) {                                                                       \
            const vec *left = row(inner, a, y) + x, *right = row(outer, b, y * s + ky) + x * s + kx;                   \
            for (int count = columns; count > 0; count--, left++, right += s) {                                        \
                vec value[K];                                                                                          \
                UNROLL for (int i = 0; i < K; i++) {                                                                   \
                    LOAD(loaded, right[i]);                                                                            \
                    value[i] = loaded;                                                                                 \
                }                                                                                                      \
                UNROLL for (int n = 0; n < N; n++) {                                                                   \
                    LOAD(factor, left[n * stride]);                                                                    \
                    UNROLL for (int i = 0; i < K; i++) sum[n][i] += factor * value[i];                                 \
                }                                                                                                      \
            }                                                                                                          \
        }                                                                                                              \
        UNROLL for (int n = 0; n < N; n++) UNROLL for (int i = 0; i < K; i++) out[n * step + i] = sum[n][i];           \
    }

WEIGHT_GRADIENT_TILE(5, 5)
WEIGHT_GRADIENT_TILE(5, 3)
WEIGHT_GRADIENT_TILE(5, 1)
WEIGHT_GRADIENT_TILE(1, 5)
WEIGHT_GRADIENT_TILE(1, 3)
WEIGHT_GRADIENT_TILE(1, 1)

#define KERNEL_ROW(N)                                                                                                  \
    for (int kx = 0; kx < k;) {                                                                                        \
        vec *out = sums + (((long)a * outer->channels + b) * k + ky) * k + kx;                                         \
        if (k - kx >= 5) weight_gradient_tile_##N##_5(inner, outer, s, a, b, ky, kx, y, rows, x, columns, out, step),  \
            kx += 5;                                                                                                   \
        else if (k - kx >= 3)                                                                                          \
            weight_gradient_tile_##N##_3(inner, outer, s, a, b, ky, kx, y, rows, x, columns, out, step), kx += 3;      \
        else weight_gradient_tile_##N##_1(inner, outer, s, a, b, ky, kx, y, rows, x, columns, out, step), kx += 1;     \
    }

INLINE void weight_gradient_rows_of(const feature_map *inner, const feature_map *outer, int k, int s, vec *sums,
                                    int from, int to) {
    long step = (long)outer->channels * k * k;
    for (int y = from; y < to; y += BLOCK_ROWS)
        for (int x = 0; x < inner->columns; x += BLOCK_COLUMNS) {
            int rows = min(to - y, BLOCK_ROWS), columns = min(inner->columns - x, BLOCK_COLUMNS);
            for (int a = 0, N; a < inner->channels; a += N) {
                N = inner->channels - a >= 5 ? 5 : 1;
                for (int b = 0; b < outer->channels; b++)
                    for (int ky = 0; ky < k; ky++) {
                        if (N == 5) KERNEL_ROW(5)
                        else KERNEL_ROW(1)
                    }
            }
        }
}

/* Below, kernel and stride of the paper's layers are constants, so that the compiler can unroll their loops. */

/* Rows [from, to) of inner (out) = convolution of outer (in), without padding. */
static void conv_rows(const feature_map *in, const feature_map *out, const conv_layer *l, const epilogue *e, int from,
                      int to) {
    if (l->kernel == 3 && l->stride == 2) conv_rows_of(in, out, l, 3, 2, e, from, to);
    else if (l->kernel == 5 && l->stride == 3) conv_rows_of(in, out, l, 5, 3, e, from, to);
    else conv_rows_of(in, out, l, l->kernel, l->stride, e, from, to);
}

/* Rows [from, to) of outer (out) = transposed convolution of inner (in). */
static void conv_transpose_rows(const feature_map *in, const feature_map *out, const conv_layer *l, const epilogue *e,
                                int from, int to) {
    if (l->kernel == 3 && l->stride == 2) conv_transpose_rows_of(in, out, l, 3, 2, e, from, to);
    else if (l->kernel == 5 && l->stride == 3) conv_transpose_rows_of(in, out, l, 5, 3, e, from, to);
    else conv_transpose_rows_of(in, out, l, l->kernel, l->stride, e, from, to);
}

/* sums[a][b][ky][kx] += inner[a][y][x] outer[b][y s + ky][x s + kx] over rows [from, to) of the inner map. */
static void weight_gradient_rows(const feature_map *inner, const feature_map *outer, const conv_layer *l, vec *sums,
                                 int from, int to) {
    if (l->kernel == 3 && l->stride == 2) weight_gradient_rows_of(inner, outer, 3, 2, sums, from, to);
    else if (l->kernel == 5 && l->stride == 3) weight_gradient_rows_of(inner, outer, 5, 3, sums, from, to);
    else weight_gradient_rows_of(inner, outer, l->kernel, l->stride, sums, from, to);
}
