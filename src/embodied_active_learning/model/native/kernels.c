/* Forward and backward passes of the image encoder and image decoder for one group of LANES images.
 *
 * Each lane of a vector holds one image, so that every loop below is a plain scalar convolution on vectors. Memory, not
 * arithmetic, limits the speed of these layers: the two layers next to the image, whose feature maps are large, are
 * computed a few rows at a time while these are in the cache (the fused functions), the deeper ones as a whole.
 *
 * Plain C with GCC's vector extension. The entry functions, called from bindings.py, are at the end; all that return int
 * return 0, or -1 if memory is exhausted. */
#include <stdlib.h>
#include <string.h>

#include "conv.h"
#include "cpu_features.h"
#include "images.h"
#include "matmul.h"
#include "vectors.h"

/* Sum the lanes of each vector. */
static void reduce_lanes(const vec *sums, long count, float *out) {
    for (long i = 0; i < count; i++) {
        float total = 0.0f;
        for (int lane = 0; lane < LANES; lane++) total += sums[i][lane];
        out[i] = total;
    }
}

static long weight_count(const feature_map *inner, const feature_map *outer, const conv_layer *l) {
    return (long)inner->channels * outer->channels * l->kernel * l->kernel;
}

static vec *allocate_zeros(long count) {
    vec *values = aligned_alloc(sizeof(vec), sizeof(vec) * count);
    if (values) memset(values, 0, sizeof(vec) * count);
    return values;
}

/* The same map with a ring buffer for its last `rows` rows. */
static feature_map ring_buffer(const feature_map *m, int rows) {
    int stored = 1;
    while (stored < rows) stored *= 2;
    feature_map ring = {0, m->channels, m->rows, m->columns, stored, stored - 1};
    ring.values = aligned_alloc(sizeof(vec), sizeof(vec) * ring.channels * stored * ring.columns);
    return ring;
}

static feature_map image_shape(const image_group *g) {
    return (feature_map){0, g->channels, g->rows, g->columns, g->rows, -1};
}

static uint8_t *allocate_byte_row(const image_group *g) { return malloc((long)g->columns * g->channels * LANES); }

/* Layers of which all rows are in memory. */

typedef void compute_rows(const feature_map *, const feature_map *, const conv_layer *, const epilogue *, int, int);

/* Compute all rows of out; bias_gradient (channels), if not null, becomes their sums. */
static int compute_layer(compute_rows *rows, const feature_map *in, const feature_map *out, const conv_layer *l,
                         const float *bias, int relu, const feature_map *mask, float *bias_gradient) {
    vec *sums = bias_gradient ? allocate_zeros(out->channels) : 0;
    if (bias_gradient && !sums) return -1;
    epilogue e = {bias, relu, mask, sums};
    rows(in, out, l, &e, 0, out->rows);
    if (sums) reduce_lanes(sums, out->channels, bias_gradient);
    free(sums);
    return 0;
}

static int weight_gradient(const feature_map *inner, const feature_map *outer, const conv_layer *l, float *out) {
    long count = weight_count(inner, outer, l);
    vec *sums = allocate_zeros(count);
    if (!sums) return -1;
    weight_gradient_rows(inner, outer, l, sums, 0, inner->rows);
    reduce_lanes(sums, count, out);
    free(sums);
    return 0;
}

/* out[c] = sum over rows, columns and images. */
static void sum_channels(const feature_map *m, float *out) {
    long size = (long)m->rows * m->columns;
    for (int c = 0; c < m->channels; c++) {
        vec sum = {0};
        for (long i = 0; i < size; i++) sum += m->values[c * size + i];
        reduce_lanes(&sum, 1, out + c);
    }
}

/* Fused functions: the layer next to the image (first) and the one behind it (second, null if there is none).
 *
 * They advance in strips of rows of the inner map of the first layer. */
#define STRIP 2
#define WIDE_STRIP (2 * STRIP)

/* Rows of the outer map that rows [0, to) of the inner map depend on or contribute to. */
INLINE int rows_reached(const feature_map *inner, const feature_map *outer, const conv_layer *l, int to) {
    return to < inner->rows ? (to - 1) * l->stride + l->kernel : outer->rows;
}

/* Rows of the inner map that depend only on rows [0, to) of the outer map. */
INLINE int rows_complete(const feature_map *inner, const feature_map *outer, const conv_layer *l, int to) {
    if (to >= outer->rows) return inner->rows;
    return to < l->kernel ? 0 : (to - l->kernel) / l->stride + 1;
}

/* First two convolutions of the encoder: images -> middle -> inner, with ReLU in between, and at the end if relu. */
static int fused_encoder_forward(const image_group *g, const conv_layer *first, const conv_layer *second,
                                 const feature_map *middle, const feature_map *inner, int relu) {
    feature_map shape = image_shape(g), image = ring_buffer(&shape, (STRIP - 1) * first->stride + first->kernel);
    uint8_t *row_buffer = allocate_byte_row(g);
    int failed = !image.values || !row_buffer;
    epilogue after_first = {first->bias, second || relu, 0, 0};
    epilogue after_second = {second ? second->bias : 0, relu, 0, 0};
    for (int from = 0, read = 0, done = 0; from < middle->rows && !failed; from += STRIP) {
        int to = min(from + STRIP, middle->rows), end = (to - 1) * first->stride + first->kernel;
        read_rows(g, &image, row_buffer, read, end);
        read = end;
        conv_rows(&image, middle, first, &after_first, from, to);
        if (second) {
            int complete = rows_complete(inner, middle, second, to);
            conv_rows(middle, inner, second, &after_second, done, complete);
            done = complete;
        }
    }
    free(image.values);
    free(row_buffer);
    return -failed;
}

/* Backward pass of fused_encoder_forward: gradients of both weights and of the first bias.
 *
 * middle: as left by the forward pass; gradient: at the inner map, or at the first layer's output if there is no second
 * layer, in which case first_bias, middle and second_weight are not used. */
static int fused_encoder_backward(const image_group *g, const conv_layer *first, const conv_layer *second,
                                  const feature_map *middle, const feature_map *gradient, float *first_weight,
                                  float *first_bias, float *second_weight) {
    const feature_map *shape = second ? middle : gradient;
    feature_map image_size = image_shape(g);
    feature_map image = ring_buffer(&image_size, (STRIP - 1) * first->stride + first->kernel);
    feature_map middle_gradient = second ? ring_buffer(middle, WIDE_STRIP) : *gradient;
    long first_count = weight_count(shape, &image, first);
    long second_count = second ? weight_count(gradient, middle, second) : 0;
    vec *first_sums = allocate_zeros(first_count + second_count + shape->channels);
    vec *second_sums = first_sums + first_count, *bias_sums = second_sums + second_count;
    uint8_t *row_buffer = allocate_byte_row(g);
    int failed = !image.values || !middle_gradient.values || !first_sums || !row_buffer;
    epilogue masked = {0, 0, middle, bias_sums};
    for (int from = 0, read = 0, done = 0; from < shape->rows && !failed; from += STRIP) {
        int to = min(from + STRIP, shape->rows), end = (to - 1) * first->stride + first->kernel;
        read_rows(g, &image, row_buffer, read, end);
        read = end;
        if (second) {
            int complete = rows_complete(gradient, middle, second, to);
            weight_gradient_rows(gradient, middle, second, second_sums, done, complete);
            done = complete;
            if (from % WIDE_STRIP == 0)
                conv_transpose_rows(gradient, &middle_gradient, second, &masked, from,
                                    min(from + WIDE_STRIP, shape->rows));
        }
        weight_gradient_rows(&middle_gradient, &image, first, first_sums, from, to);
    }
    if (!failed) {
        reduce_lanes(first_sums, first_count, first_weight);
        if (second) reduce_lanes(second_sums, second_count, second_weight);
        if (second) reduce_lanes(bias_sums, shape->channels, first_bias);
    }
    if (second) free(middle_gradient.values);
    free(image.values);
    free(first_sums);
    free(row_buffer);
    return -failed;
}

/* Results of fused_decoder_backward. */
typedef struct {
    float squared_errors[LANES];
    float *first_weight, *first_bias, *second_weight, *second_bias;
    float *bias_sums;            /* (channels) sums of the gradient at the input; null if not needed */
    const feature_map *gradient; /* at the input */
} decoder_gradients;

/* Last two transposed convolutions of the decoder, the error of the decoded images, and the backward pass through all.
 *
 * inner -> middle -> images. The gradients are those of sum_i scale_i / 2 squared_errors_i. The gradient at the input is
 * masked with inner if relu. Without a second layer inner is the input of the first. */
static int fused_decoder_backward(const feature_map *inner, const conv_layer *first, const conv_layer *second,
                                  const feature_map *middle_shape, const image_group *g, const float *scale, int relu,
                                  decoder_gradients *result) {
    const feature_map *shape = second ? middle_shape : inner;
    feature_map image_size = image_shape(g);
    int middle_rows = ((STRIP - 1) * first->stride + first->kernel - 1) / first->stride + WIDE_STRIP;
    feature_map image = ring_buffer(&image_size, STRIP * first->stride + first->kernel - 1);
    feature_map middle = second ? ring_buffer(shape, middle_rows) : *inner;
    feature_map gradient = second ? ring_buffer(shape, STRIP + second->kernel + second->stride) : *result->gradient;
    long first_count = weight_count(shape, &image, first), second_count = second ? weight_count(inner, shape, second) : 0;
    vec *first_sums =
        allocate_zeros(first_count + second_count + g->channels + shape->channels + inner->channels);
    vec *second_sums = first_sums + first_count, *image_sums = second_sums + second_count;
    vec *middle_sums = image_sums + g->channels, *inner_sums = middle_sums + shape->channels;
    uint8_t *row_buffer = allocate_byte_row(g);
    int failed = !image.values || !middle.values || !gradient.values || !first_sums || !row_buffer;
    double squared_errors[LANES] = {0};
    vec scales;
    memcpy(&scales, scale, sizeof(vec));
    epilogue after_first = {first->bias, 0, 0, 0}, after_second = {second ? second->bias : 0, 1, 0, 0};
    epilogue masked_middle = {0, 0, second || relu ? &middle : 0, middle_sums};
    epilogue masked_inner = {0, 0, relu ? inner : 0, inner_sums};
    for (int from = 0, decoded = 0, computed = 0, done = 0; from < shape->rows && !failed; from += STRIP) {
        int to = min(from + STRIP, shape->rows), end = rows_reached(shape, &image, first, to);
        if (second) {
            int needed = min((end - 1) / first->stride + 1, shape->rows);
            if (computed < needed) {
                int next = min(computed + WIDE_STRIP > needed ? computed + WIDE_STRIP : needed, shape->rows);
                conv_transpose_rows(inner, &middle, second, &after_second, computed, next);
                computed = next;
            }
        }
        conv_transpose_rows(&middle, &image, first, &after_first, decoded, end);
        error_gradient_rows(&image, g, scales, squared_errors, image_sums, row_buffer, decoded, end);
        decoded = end;
        weight_gradient_rows(&middle, &image, first, first_sums, from, to);
        conv_rows(&image, &gradient, first, &masked_middle, from, to);
        if (second) {
            int complete = rows_complete(inner, shape, second, to);
            weight_gradient_rows(inner, &gradient, second, second_sums, done, complete);
            conv_rows(&gradient, result->gradient, second, &masked_inner, done, complete);
            done = complete;
        }
    }
    if (!failed) {
        for (int lane = 0; lane < LANES; lane++) result->squared_errors[lane] = (float)squared_errors[lane];
        reduce_lanes(first_sums, first_count, result->first_weight);
        reduce_lanes(image_sums, g->channels, result->first_bias);
        if (second) reduce_lanes(second_sums, second_count, result->second_weight);
        if (second) reduce_lanes(middle_sums, shape->channels, result->second_bias);
        if (result->bias_sums) reduce_lanes(second ? inner_sums : middle_sums, inner->channels, result->bias_sums);
    }
    if (second) free(middle.values);
    if (second) free(gradient.values);
    free(image.values);
    free(first_sums);
    free(row_buffer);
    return -failed;
}

/* Entry functions.
 *
 * layers: `count` of them, from the image inwards; maps: count + 1, that of the image (whose values are not stored) and
 * the inner map of each layer. gradients: of weight, bias, weight, ... from the image inwards. */

#define FUSED 2 /* layers next to the image that are fused */

/* Numbers of several images outside of feature maps: number i of image n is first[n * image_stride + i * stride]. */
typedef struct {
    float *first;
    long image_stride, stride;
} strided;

#define TRANSPOSE_BLOCK 16

/* The numbers of `count` images as a feature map; lanes without an image become zero. */
static void load_features(const strided *in, int count, const feature_map *out) {
    long size = (long)out->channels * out->rows * out->columns;
    if (in->image_stride == 1 && count == LANES)
        for (long i = 0; i < size; i++) out->values[i] = *(const unaligned_vec *)(in->first + i * in->stride);
    else for (long from = 0; from < size; from += TRANSPOSE_BLOCK)
        for (int n = 0; n < LANES; n++)
            for (long i = from; i < size && i < from + TRANSPOSE_BLOCK; i++)
                ((float *)(out->values + i))[n] = n < count ? in->first[n * in->image_stride + i * in->stride] : 0.0f;
}

static void store_features(const feature_map *in, int count, const strided *out) {
    long size = (long)in->channels * in->rows * in->columns;
    if (out->image_stride == 1 && count == LANES)
        for (long i = 0; i < size; i++) *(unaligned_vec *)(out->first + i * out->stride) = in->values[i];
    else for (long from = 0; from < size; from += TRANSPOSE_BLOCK)
        for (int n = 0; n < count; n++)
            for (long i = from; i < size && i < from + TRANSPOSE_BLOCK; i++)
                out->first[n * out->image_stride + i * out->stride] = ((const float *)(in->values + i))[n];
}

static const conv_layer *second_layer(const conv_layer *layers, int count) { return count > 1 ? layers + 1 : 0; }

int lanes(void) { return LANES; }

int fused_layers(void) { return FUSED; }

/* Images -> inner maps of all layers; the features, the last of them, are also copied to each of `copies` outputs. */
int encoder_forward(const image_group *g, const conv_layer *layers, const feature_map *maps, int count,
                    const strided *features, int copies) {
    int fused = min(count, FUSED), relu = count > fused;
    int failed = fused_encoder_forward(g, layers, second_layer(layers, count), maps + 1, maps + fused, relu);
    for (int i = fused; i < count && !failed; i++)
        failed = compute_layer(conv_rows, maps + i, maps + i + 1, layers + i, layers[i].bias, i + 1 < count, 0, 0);
    for (int i = 0; i < copies && !failed; i++) store_features(maps + count, g->count, features + i);
    return failed;
}

/* Gradient at the features -> gradients of all weights and biases.
 *
 * maps: as left by encoder_forward; gradient_maps: scratch for the maps from FUSED on. */
int encoder_backward(const image_group *g, const conv_layer *layers, const feature_map *maps,
                     const feature_map *gradient_maps, int count, const strided *feature_gradient,
                     float *const *gradients) {
    int fused = min(count, FUSED), failed = 0;
    load_features(feature_gradient, g->count, gradient_maps + count);
    sum_channels(gradient_maps + count, gradients[2 * count - 1]);
    for (int i = count - 1; i >= fused && !failed; i--) {
        failed = weight_gradient(gradient_maps + i + 1, maps + i, layers + i, gradients[2 * i]);
        if (!failed)
            failed = compute_layer(conv_transpose_rows, gradient_maps + i + 1, gradient_maps + i, layers + i, 0, 0,
                                   maps + i, gradients[2 * i - 1]);
    }
    if (failed) return failed;
    return fused_encoder_backward(g, layers, second_layer(layers, count), maps + 1, gradient_maps + fused, gradients[0],
                                  fused > 1 ? gradients[1] : 0, fused > 1 ? gradients[2] : 0);
}

/* Features of `images` images -> maps from `nearest` on (0: decoded images). */
int decoder_forward(const strided *features, int images, const conv_layer *layers, const feature_map *maps, int count,
                    int nearest) {
    int failed = 0;
    load_features(features, images, maps + count);
    for (int i = count - 1; i >= nearest && !failed; i--)
        failed = compute_layer(conv_transpose_rows, maps + i + 1, maps + i, layers + i, layers[i].bias, i > 0, 0, 0);
    return failed;
}

/* Features -> decoded images, their squared errors, and all gradients of sum_i scales_i / 2 squared_errors_i.
 *
 * maps, gradient_maps: scratch for activations and gradients from FUSED on. feature_gradient: output. */
int decoder_forward_backward(const strided *features, const image_group *g, const float *scales,
                             const conv_layer *layers, const feature_map *maps, const feature_map *gradient_maps,
                             int count, const strided *feature_gradient, float *squared_errors,
                             float *const *gradients) {
    int fused = min(count, FUSED), deeper = count > fused;
    float scale[LANES] = {0};
    memcpy(scale, scales, sizeof(float) * g->count);
    decoder_gradients result = {{0},
                                gradients[0],
                                gradients[1],
                                fused > 1 ? gradients[2] : 0,
                                fused > 1 ? gradients[3] : 0,
                                deeper ? gradients[2 * fused + 1] : 0,
                                gradient_maps + fused};
    int failed = decoder_forward(features, g->count, layers, maps, count, fused);
    if (!failed)
        failed = fused_decoder_backward(maps + fused, layers, second_layer(layers, count), maps + 1, g, scale, deeper,
                                        &result);
    for (int i = fused; i < count && !failed; i++) {
        int last = i + 1 == count;
        failed = weight_gradient(maps + i + 1, gradient_maps + i, layers + i, gradients[2 * i]);
        if (!failed)
            failed = compute_layer(conv_rows, gradient_maps + i, gradient_maps + i + 1, layers + i, 0, 0,
                                   last ? 0 : maps + i + 1, last ? 0 : gradients[2 * i + 3]);
    }
    if (failed) return failed;
    store_features(gradient_maps + count, g->count, feature_gradient);
    memcpy(squared_errors, result.squared_errors, sizeof(float) * g->count);
    return 0;
}

/* Increased with every change of the entry functions' arguments, so that an outdated library is not called. */
int interface_version(void) { return 1; }
