/* Pictures of bytes as values, and values compared with them. */
#pragma once

#include <string.h>

#include "sides.h"

/* Images (rows, columns, channels) of bytes, wherever each of them lies; count at most LANES. */
typedef struct {
    const uint8_t *const *images;
    int count, rows, columns, channels;
} pictures;

/* 16 neighbouring bytes of each line -> 16 neighbouring vectors of bytes, one a line. */
#ifdef __AVX512BW__
INLINE void transpose(const uint8_t *const *line, int count, long at, uint8_t *out) {
    const __m128i none = _mm_setzero_si128();
    __m512i lines[4]; /* lines n, n + 4, n + 8 and n + 12, so that pairs of pairs are four neighbours */
    UNROLL for (int n = 0; n < 4; n++) {
#define LINE(i) (4 * i + n < count ? _mm_loadu_si128((const __m128i *)(line[4 * i + n] + at)) : none)
        lines[n] = _mm512_inserti32x4(_mm512_castsi128_si512(LINE(0)), LINE(1), 1);
        lines[n] = _mm512_inserti32x4(_mm512_inserti32x4(lines[n], LINE(2), 2), LINE(3), 3);
#undef LINE
    }
    __m512i low = _mm512_unpacklo_epi8(lines[0], lines[1]), low_too = _mm512_unpacklo_epi8(lines[2], lines[3]);
    __m512i high = _mm512_unpackhi_epi8(lines[0], lines[1]), high_too = _mm512_unpackhi_epi8(lines[2], lines[3]);
    __m512i fours[4] = {_mm512_unpacklo_epi16(low, low_too), _mm512_unpackhi_epi16(low, low_too),
                        _mm512_unpacklo_epi16(high, high_too), _mm512_unpackhi_epi16(high, high_too)};
    const __m512i order = _mm512_setr_epi32(0, 4, 8, 12, 1, 5, 9, 13, 2, 6, 10, 14, 3, 7, 11, 15);
    UNROLL for (int i = 0; i < 4; i++) _mm512_storeu_si512(out + 64 * i, _mm512_permutexvar_epi32(order, fours[i]));
}
#else
typedef uint8_t bytes16 __attribute__((vector_size(16)));
#ifdef __clang__
#define SHUFFLE(a, b, ...) __builtin_shufflevector(a, b, __VA_ARGS__)
#else
#define SHUFFLE(a, b, ...) __builtin_shuffle(a, b, (bytes16){__VA_ARGS__})
#endif

INLINE void transpose(const uint8_t *const *line, int count, long at, uint8_t *out) {
    bytes16 lines[LANES];
    UNROLL for (int n = 0; n < LANES; n++) {
        lines[n] = (bytes16){0};
        if (n < count) memcpy(&lines[n], line[n] + at, 16);
    }
    for (int round = 1; round < LANES; round *= 2) { /* interleaved again and again */
        bytes16 pairs[LANES];
        UNROLL for (int i = 0; i < LANES / 2; i++) {
            bytes16 a = lines[i], b = lines[i + LANES / 2];
            pairs[2 * i] = SHUFFLE(a, b, 0, 16, 1, 17, 2, 18, 3, 19, 4, 20, 5, 21, 6, 22, 7, 23);
            pairs[2 * i + 1] = SHUFFLE(a, b, 8, 24, 9, 25, 10, 26, 11, 27, 12, 28, 13, 29, 14, 30, 15, 31);
        }
        UNROLL for (int i = 0; i < LANES; i++) lines[i] = pairs[i];
    }
    memcpy(out, lines, 16 * LANES);
}
#undef SHUFFLE
#endif

/* Row y of the pictures as (columns * channels, LANES) bytes; zero beyond count. */
static void read_row(const pictures *p, int y, uint8_t *out) {
    int length = p->columns * p->channels;
    const uint8_t *line[LANES];
    for (int lane = 0; lane < p->count; lane++) line[lane] = p->images[lane] + (long)y * length;
    int i = 0;
    for (; i + 16 <= length; i += 16) transpose(line, p->count, i, out + (long)i * LANES);
    for (; i < length; i++)
        for (int lane = 0; lane < LANES; lane++) out[(long)i * LANES + lane] = lane < p->count ? line[lane][i] : 0;
}

/* One value in [0, 1] of each lane. */
INLINE vec pixel(const uint8_t *bytes, long index) {
    vec value;
#ifdef __AVX512F__ /* no compiler finds this by itself */
    value = _mm512_cvtepi32_ps(_mm512_cvtepu8_epi32(_mm_loadu_si128((const __m128i *)(bytes + index * LANES))));
#else
    for (int lane = 0; lane < LANES; lane++) value[lane] = bytes[index * LANES + lane];
#endif
    return value * (1.0f / 255.0f);
}

/* Rows from .. to of the pictures as values. line: room for a row of bytes. */
static void read_rows(const pictures *p, const side *image, uint8_t *line, int from, int to) {
    for (int y = from; y < to; y++) {
        read_row(p, y, line);
        for (int c = 0; c < p->channels; c++) {
            vec *out = row(image, c, y);
            for (int x = 0; x < p->columns; x++) out[x] = pixel(line, x * p->channels + c);
        }
    }
}

/* In place of rows of the image: (image - pictures) times scale. Adds up squared differences and what is left. */
static void compare_rows(const side *image, const pictures *p, vec scale, double *errors, vec *totals, uint8_t *line,
                         int from, int to) {
    for (int y = from; y < to; y++) {
        read_row(p, y, line);
        vec squares = {0};
        for (int c = 0; c < p->channels; c++) {
            vec *value = row(image, c, y), total = {0};
            for (int x = 0; x < p->columns; x++) {
                vec difference = value[x] - pixel(line, x * p->channels + c);
                squares += difference * difference;
                value[x] = difference * scale;
                total += value[x];
            }
            totals[c] += total;
        }
        for (int lane = 0; lane < LANES; lane++) errors[lane] += squares[lane];
    }
}
