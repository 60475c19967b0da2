/* Conversion of 8-bit images to feature maps, and comparison of feature maps with images. */
#pragma once

#include <string.h>

#include "vectors.h"

/* Up to LANES images (rows, columns, channels), each stored anywhere. */
typedef struct {
    const uint8_t *const *images;
    int count, rows, columns, channels;
} image_group;

/* Transpose 16 consecutive bytes of `count` rows, one per image: (LANES, 16) -> (16, LANES). */
#ifdef __AVX512BW__
INLINE void transpose_bytes(const uint8_t *const *rows, int count, long offset, uint8_t *out) {
    const __m128i zero = _mm_setzero_si128();
    __m512i parts[4]; /* rows n, n + 4, n + 8 and n + 12, so that two interleavings yield four consecutive images */
    UNROLL for (int n = 0; n < 4; n++) {
#define ROW(i) (4 * i + n < count ? _mm_loadu_si128((const __m128i *)(rows[4 * i + n] + offset)) : zero)
        parts[n] = _mm512_inserti32x4(_mm512_castsi128_si512(ROW(0)), ROW(1), 1);
        parts[n] = _mm512_inserti32x4(_mm512_inserti32x4(parts[n], ROW(2), 2), ROW(3), 3);
#undef ROW
    }
    __m512i low[2] = {_mm512_unpacklo_epi8(parts[0], parts[1]), _mm512_unpacklo_epi8(parts[2], parts[3])};
    __m512i high[2] = {_mm512_unpackhi_epi8(parts[0], parts[1]), _mm512_unpackhi_epi8(parts[2], parts[3])};
    __m512i quads[4] = {_mm512_unpacklo_epi16(low[0], low[1]), _mm512_unpackhi_epi16(low[0], low[1]),
                        _mm512_unpacklo_epi16(high[0], high[1]), _mm512_unpackhi_epi16(high[0], high[1])};
    const __m512i order = _mm512_setr_epi32(0, 4, 8, 12, 1, 5, 9, 13, 2, 6, 10, 14, 3, 7, 11, 15);
    UNROLL for (int i = 0; i < 4; i++) _mm512_storeu_si512(out + 64 * i, _mm512_permutexvar_epi32(order, quads[i]));
}
#else
INLINE void transpose_bytes(const uint8_t *const *rows, int count, long offset, uint8_t *out) {
    memset(out, 0, 16 * LANES);
    for (int n = 0; n < count; n++)
        for (int i = 0; i < 16; i++) out[i * LANES + n] = rows[n][offset + i];
}
#endif

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
    vec value;
#ifdef __AVX512F__ /* GCC does not find this conversion */
    value = _mm512_cvtepi32_ps(_mm512_cvtepu8_epi32(_mm_loadu_si128((const __m128i *)(bytes + index * LANES))));
#else
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
