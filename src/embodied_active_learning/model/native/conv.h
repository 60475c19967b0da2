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

/* The functions below compute tiles of n channels times p columns, as many sums as fit into the vector registers: 32
 * with AVX-512, 16 otherwise. They are inlined with constant n and p, so that the compiler keeps the sums there. */
#ifdef __AVX512F__
#define TILE_COLUMNS 4
#define IMAGE_TILE_COLUMNS 8 /* if there are only the three channels of an image */
#define GRADIENT_SUMS 25 /* of a tile of the weight gradient */
#else
#define TILE_COLUMNS 2
#define IMAGE_TILE_COLUMNS 3
#define GRADIENT_SUMS 12
#endif
#define MAX_CHANNELS 5
#define MAX_COLUMNS 8

typedef vec tile[MAX_COLUMNS][MAX_CHANNELS];

INLINE void start_tile(tile sum, const epilogue *e, int o, int n, int p) {
    UNROLL for (int i = 0; i < p; i++) UNROLL for (int j = 0; j < n; j++)
        sum[i][j] = (vec){0} + (e->bias ? e->bias[o + j] : 0.0f);
}

/* held[i] = from[i * step], in registers */
INLINE void hold(vec *held, const vec *from, long step, int count) {
    UNROLL for (int i = 0; i < count; i++) {
        LOAD(value, from[i * step]);
        held[i] = value;
    }
}

/* sum[i][j] += value[i * step] * weight[j]
 *
 * AVX-512 multiplies by a weight in memory. Otherwise weights need registers, of which the sums leave few: the smaller
 * of both sets of factors is held there, and the others follow one by one. */
INLINE void add_products(tile sum, const vec *value, int step, const float *weight, int n, int p) {
#ifndef __AVX512F__
    if (p < n) {
        vec held[MAX_COLUMNS];
        hold(held, value, step, p);
        UNROLL for (int j = 0; j < n; j++) {
            LOAD_BROADCAST(factor, weight[j]);
            UNROLL for (int i = 0; i < p; i++) sum[i][j] += held[i] * factor;
        }
        return;
    }
#endif
    UNROLL for (int i = 0; i < p; i++) {
        LOAD(factor, value[i * step]);
        UNROLL for (int j = 0; j < n; j++) sum[i][j] += factor * weight[j];
    }
}

/* Store output channels o to o + n - 1 of row y at columns x, x + step, ... */
INLINE void store_tile(tile sum, const feature_map *out, const epilogue *e, int o, int y, int x, int step, int n,
                       int p) {
    UNROLL for (int j = 0; j < n; j++) {
        vec *target = row(out, o + j, y) + x, channel_sum = {0};
        const vec *mask = e->mask ? row(e->mask, o + j, y) + x : 0;
        UNROLL for (int i = 0; i < p; i++) {
            vec value = sum[i][j];
            if (e->relu) value = mask_positive(value, value);
            if (mask) value = mask_positive(value, mask[i * step]);
            target[i * step] = value;
            channel_sum += value;
        }
        if (e->channel_sums) e->channel_sums[o + j] += channel_sum;
    }
}

INLINE void conv_tile(const feature_map *in, const feature_map *out, const conv_layer *l, int k, int s,
                      const epilogue *e, int o, int y, int x, int n, int p) {
    tile sum;
    start_tile(sum, e, o, n, p);
    for (int c = 0; c < in->channels; c++)
        for (int ky = 0; ky < k; ky++) {
            const vec *value = row(in, c, y * s + ky) + x * s;
            const float *weight = l->conv_weight + (long)(c * k + ky) * k * out->channels + o;
            for (int kx = 0; kx < k; kx++, weight += out->channels) add_products(sum, value + kx, s, weight, n, p);
        }
    store_tile(sum, out, e, o, y, x, 1, n, p);
}

/* Columns first * s + phase, then every s-th: inner column first - i reaches the first one with kernel column
 * phase + i s. */
INLINE void conv_transpose_tile(const feature_map *in, const feature_map *out, const conv_layer *l, int k, int s,
                                const epilogue *e, int o, int y, int first, int phase, int n, int p) {
    long stride = channel_stride(in), weight_stride = (long)k * k * out->channels;
    tile sum;
    start_tile(sum, e, o, n, p);
    for (int ky = y % s, iy = y / s; ky < k && iy >= 0; ky += s, iy--) {
        if (iy >= in->rows) continue;
        for (int kx = phase, ix = first; kx < k && ix >= 0; kx += s, ix--) {
            if (p == 1 && ix >= in->columns) continue;
            const vec *value = row(in, 0, iy) + ix;
            const float *weight = l->conv_transpose_weight + (long)(ky * k + kx) * out->channels + o;
            for (int c = 0; c < in->channels; c++, value += stride, weight += weight_stride)
                add_products(sum, value, 1, weight, n, p);
        }
    }
    store_tile(sum, out, e, o, y, first * s + phase, s, n, p);
}

/* Call a tile function for all channels of p columns, so that their inputs stay in the first-level cache. */
#define FOR_ALL_CHANNELS(TILE, p, ...)                                                                                 \
    for (int o = 0; o < out->channels;) {                                                                              \
        int left = out->channels - o;                                                                                  \
        if (left >= 5) TILE(in, out, l, k, s, e, o, y, __VA_ARGS__, 5, p), o += 5;                                     \
        else if (left >= 3) TILE(in, out, l, k, s, e, o, y, __VA_ARGS__, 3, p), o += 3;                                \
        else TILE(in, out, l, k, s, e, o, y, __VA_ARGS__, 1, p), o += 1;                                               \
    }

INLINE void conv_rows_of(const feature_map *in, const feature_map *out, const conv_layer *l, int k, int s,
                         const epilogue *e, int from, int to) {
    for (int y = from; y < to; y++) {
        int x = 0;
        for (; x + TILE_COLUMNS <= out->columns; x += TILE_COLUMNS) FOR_ALL_CHANNELS(conv_tile, TILE_COLUMNS, x)
        for (; x < out->columns; x++) FOR_ALL_CHANNELS(conv_tile, 1, x)
    }
}

INLINE void conv_transpose_rows_of(const feature_map *in, const feature_map *out, const conv_layer *l, int k, int s,
                                   const epilogue *e, int from, int to) {
    int taps = (k + s - 1) / s, columns = min(in->columns, out->columns / s), is_image = out->channels == 3;
    for (int y = from; y < to; y++)
        for (int first = 0, next; first * s < out->columns; first = next) {
            /* Wide tiles only where the input has all columns of all taps. */
            int inside = first < taps - 1 ? 0 : columns - first;
            int p = is_image && inside >= IMAGE_TILE_COLUMNS ? IMAGE_TILE_COLUMNS : inside >= TILE_COLUMNS ? TILE_COLUMNS : 1;
            next = first + p;
            UNROLL for (int phase = 0; phase < s; phase++) {
                if (p == IMAGE_TILE_COLUMNS)
                    conv_transpose_tile(in, out, l, k, s, e, 0, y, first, phase, 3, IMAGE_TILE_COLUMNS);
                else if (p > 1) FOR_ALL_CHANNELS(conv_transpose_tile, TILE_COLUMNS, first, phase)
                else if (first * s + phase < out->columns) FOR_ALL_CHANNELS(conv_transpose_tile, 1, first, phase)
            }
        }
}

/* The weight gradient is summed over blocks of the inner map that fit into the first-level cache. */
#define BLOCK_ROWS 2
#define BLOCK_COLUMNS 16

/* Gradients of p kernel columns from kx on of kernel row ky, for n inner channels from a on and outer channel b. */
INLINE void weight_gradient_tile(const feature_map *inner, const feature_map *outer, int s, int a, int b, int ky,
                                 int kx, int y, int rows, int x, int columns, vec *out, long step, int n, int p) {
    vec sum[MAX_CHANNELS][MAX_CHANNELS];
    UNROLL for (int j = 0; j < n; j++) UNROLL for (int i = 0; i < p; i++) sum[j][i] = out[j * step + i];
    long stride = channel_stride(inner);
    for (int end = y + rows; y < end; y++) {
        const vec *left = row(inner, a, y) + x, *right = row(outer, b, y * s + ky) + x * s + kx;
        for (int count = columns; count > 0; count--, left++, right += s) {
            vec held[MAX_CHANNELS];
            if (n < p) {
                hold(held, left, stride, n);
                UNROLL for (int i = 0; i < p; i++) {
                    LOAD(factor, right[i]);
                    UNROLL for (int j = 0; j < n; j++) sum[j][i] += held[j] * factor;
                }
            } else {
                hold(held, right, 1, p);
                UNROLL for (int j = 0; j < n; j++) {
                    LOAD(factor, left[j * stride]);
                    UNROLL for (int i = 0; i < p; i++) sum[j][i] += factor * held[i];
                }
            }
        }
    }
    UNROLL for (int j = 0; j < n; j++) UNROLL for (int i = 0; i < p; i++) out[j * step + i] = sum[j][i];
}

/* Gradients of kernel row ky for n inner channels. */
INLINE void kernel_row_gradient(const feature_map *inner, const feature_map *outer, int k, int s, int a, int b, int ky,
                                int y, int rows, int x, int columns, vec *sums, int n) {
    long step = (long)outer->channels * k * k;
    vec *out = sums + (((long)a * outer->channels + b) * k + ky) * k;
    int kx = 0;
    for (; k - kx >= 5; kx += 5)
        weight_gradient_tile(inner, outer, s, a, b, ky, kx, y, rows, x, columns, out + kx, step, n, 5);
    for (; k - kx >= 3; kx += 3)
        weight_gradient_tile(inner, outer, s, a, b, ky, kx, y, rows, x, columns, out + kx, step, n, 3);
    for (; k - kx >= 1; kx += 1)
        weight_gradient_tile(inner, outer, s, a, b, ky, kx, y, rows, x, columns, out + kx, step, n, 1);
}

/* Inner channels of a tile, of those left: as many as fit into the registers with all columns of a kernel row. */
INLINE int gradient_channels(int left, int k) {
    int columns = min(k, 5);
    if (left >= 5 && 5 * columns <= GRADIENT_SUMS) return 5;
    if (left >= 4 && 4 * columns <= GRADIENT_SUMS) return 4;
    return left >= 2 ? 2 : 1;
}

INLINE void weight_gradient_rows_of(const feature_map *inner, const feature_map *outer, int k, int s, vec *sums,
                                    int from, int to) {
    for (int y = from; y < to; y += BLOCK_ROWS)
        for (int x = 0; x < inner->columns; x += BLOCK_COLUMNS) {
            int rows = min(to - y, BLOCK_ROWS), columns = min(inner->columns - x, BLOCK_COLUMNS);
            for (int a = 0, n; a < inner->channels; a += n) {
                n = gradient_channels(inner->channels - a, k);
                for (int b = 0; b < outer->channels; b++)
                    for (int ky = 0; ky < k; ky++) {
                        if (n == 5) kernel_row_gradient(inner, outer, k, s, a, b, ky, y, rows, x, columns, sums, 5);
                        else if (n == 4) kernel_row_gradient(inner, outer, k, s, a, b, ky, y, rows, x, columns, sums, 4);
                        else if (n == 2) kernel_row_gradient(inner, outer, k, s, a, b, ky, y, rows, x, columns, sums, 2);
                        else kernel_row_gradient(inner, outer, k, s, a, b, ky, y, rows, x, columns, sums, 1);
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
