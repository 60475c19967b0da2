/* Conversion of 8-bit images to feature maps, and comparison of feature maps with images. */
#pragma once

#include <string.h>

#include "vectors.h"

/* Up to LANES images (rows, columns, channels), each stored anywhere. */
typedef struct {
    const uint8_t *const *images;
    int count, rows, columns, channels;
} image_group;

typedef uint8_t bytes16 __attribute__((vector_size(16)));
#ifdef __clang__
#define SHUFFLE(a, b, ...) __builtin_shufflevector(a, b, __VA_ARGS__)
#else
#define SHUFFLE(a, b, ...) __builtin_shuffle(a, b, (bytes16){__VA_ARGS__})
#endif

/* Transpose 16 consecutive bytes of `count` rows, one per image: (LANES, 16) -> (16, LANES). */
INLINE void transpose_bytes(const uint8_t *const *rows, int count, long offset, uint8_t *out) {
    bytes16 parts[LANES];
    UNROLL for (int n = 0; n < LANES; n++) {
        parts[n] = (bytes16){0};
        if (n < count) memcpy(&parts[n], rows[n] + offset, 16);
    }
    for (int round = 1; round < LANES; round *= 2) { /* each round interleaves the first half with the second */
        bytes16 next[LANES];
        UNROLL for (int i = 0; i < LANES / 2; i++) {
            bytes16 a = parts[i], b = parts[i + LANES / 2];
            next[2 * i] = SHUFFLE(a, b, 0, 16, 1, 17, 2, 18, 3, 19, 4, 20, 5, 21, 6, 22, 7, 23);
            next[2 * i + 1] = SHUFFLE(a, b, 8, 24, 9, 25, 10, 26, 11, 27, 12, 28, 13, 29, 14, 30, 15, 31);
        }
        UNROLL for (int i = 0; i < LANES; i++) parts[i] = next[i];
    }
    memcpy(out, parts, 16 * LANES);
}
#undef SHUFFLE

/* Row y of the images as (columns * channels, LANES) bytes; missing images are zero. */
static void read_byte_row(const image_group *g, int y, uint8_t *out) {
    int length = g->columns * g->channels;
    const uint8_t *rows[LANES];
    for (int lane = 0; lane < g->count; lane++) rows[lane] = g->images[lane] + (long)y * length;
    int i = 0;
    for (; i + 16 <= length; i += 16) transpose_bytes(rows, g->count, i, out + (long)i * LANES);
    for (; i < length; i++)
        for (int lane = 0; lane < LANES; lane++) out[(long)i * LANES + lane] = lane < g->count ? rows[lane][i] : 0;
}

/* One value in [0, 1] per image. */
INLINE vec pixel(const uint8_t *bytes, long index) {
#if defined __AVX512F__ /* GCC does not find these conversions */
    vec value = _mm512_cvtepi32_ps(_mm512_cvtepu8_epi32(_mm_loadu_si128((const __m128i *)(bytes + index * LANES))));
#elif defined __AVX2__
    vec value = _mm256_cvtepi32_ps(_mm256_cvtepu8_epi32(_mm_loadl_epi64((const __m128i *)(bytes + index * LANES))));
#else
    vec value;
    for (int lane = 0; lane < LANES; lane++) value[lane] = bytes[index * LANES + lane];
#endif
    return value * (1.0f / 255.0f);
}

/* Copy rows [from, to) of the images into a feature map. row_buffer: a byte row of all images. */
static void read_rows(const image_group *g, const feature_map *map, uint8_t *row_buffer, int from, int to) {
    for (int y = from; y < to; y++) {
        read_byte_row(g, y, row_buffer);
        for (int c = 0; c < g->channels; c++) {
            vec *out = row(map, c, y);
            for (int x = 0; x < g->columns; x++) out[x] = pixel(row_buffer, x * g->channels + c);
        }
    }
}

/* Replace rows [from, to) of decoded images by the gradient of their error, scale (decoded - image).
 *
 * Adds the squared differences to squared_errors (LANES) and the gradients to channel_sums (channels). */
static void error_gradient_rows(const feature_map *decoded, const image_group *g, vec scale, double *squared_errors,
                                vec *channel_sums, uint8_t *row_buffer, int from, int to) {
    for (int y = from; y < to; y++) {
        read_byte_row(g, y, row_buffer);
        vec squares = {0};
        for (int c = 0; c < g->channels; c++) {
            vec *value = row(decoded, c, y), sum = {0};
            for (int x = 0; x < g->columns; x++) {
                vec difference = value[x] - pixel(row_buffer, x * g->channels + c);
                squares += difference * difference;
                value[x] = difference * scale;
                sum += value[x];
            }
            channel_sums[c] += sum;
        }
        for (int lane = 0; lane < LANES; lane++) squared_errors[lane] += squares[lane];
    }
}
