/* Convolutions of the image encoder and decoder with their gradients, for LANES images at a time, and matrix products.
 *
 * Values are (channel, row, column, image): the images of a group are the lanes of a vector, so that every loop below is
 * an ordinary scalar convolution in which each number happens to be a vector. A convolution lies between its wide side,
 * nearer the image, and its narrow one; both ways through it and its gradient are written in rows of the narrow or the
 * wide side, so that whole layers can follow each other a few rows at a time while these are in the cache: at this size
 * memory, not arithmetic, is what takes the time. C with GCC's vector extension, so that the compiler picks the
 * instructions of the machine; the few that it does not find are written out beside what works anywhere.
 */
#include <stdlib.h>
#include <string.h>

#include "paired.h"
#include "pictures.h"
#include "product.h"
#include "sides.h"

int lanes(void) { return LANES; }

/* Weights packed for going either way, and biases of the side that is written. If paired, the weights are the taps of
 * paired.h, else (input channel, ky, kx, output channel). */
typedef struct {
    int kernel, stride, paired;
    const float *narrowing, *widening, *bias;
} layer;

INLINE int is_paired(int kernel, int stride, int columns) {
    return ((kernel == 3 && stride == 2) || (kernel == 5 && stride == 3)) && columns > 1;
}

/* Columns, and rows, of the filters that pack() makes for a narrow side of so many columns. */
int packed_taps(int kernel, int stride, int columns) {
    return is_paired(kernel, stride, columns) ? TAPS_OF(kernel, stride) : kernel;
}

static void pack_one_way(const float *weights, long along, long across, int inputs, int outputs, int k, int s,
                         int paired, float *out) {
    if (paired) pair_taps(weights, along, across, inputs, outputs, k, s, out);
    else for (int c = 0; c < inputs; c++)
        for (int tap = 0; tap < k * k; tap++)
            for (int o = 0; o < outputs; o++) *out++ = weights[c * along + o * across + tap];
}

/* Weights (narrow channel, wide channel, ky, kx) as narrowing and widening of a layer -> whether it is paired. */
int pack(const float *weights, int narrow, int wide, int kernel, int stride, int columns, float *narrowing,
          float *widening) {
    int paired = is_paired(kernel, stride, columns), area = kernel * kernel;
    pack_one_way(weights, area, (long)wide * area, wide, narrow, kernel, stride, paired, narrowing);
    pack_one_way(weights, (long)wide * area, area, narrow, wide, kernel, stride, paired, widening);
    return paired;
}

/* Numbers of some images outside of groups: number i of image n at first[n * across + i * along]. */
typedef struct {
    float *first;
    long across, along;
} numbers;

INLINE long size_of(const side *s) { return (long)s->channels * s->rows * s->columns; }

#define BLOCK_OF_NUMBERS 16

/* The numbers of `count` images as values of a group, zero for the images that it lacks. */
static void to_group(const numbers *in, int count, const side *out) {
    long size = size_of(out);
    if (in->across == 1 && count == LANES)
        for (long i = 0; i < size; i++) out->values[i] = *(const loose_vec *)(in->first + i * in->along);
    else for (long from = 0; from < size; from += BLOCK_OF_NUMBERS)
        for (int n = 0; n < LANES; n++)
            for (long i = from; i < size && i < from + BLOCK_OF_NUMBERS; i++)
                ((float *)(out->values + i))[n] = n < count ? in->first[n * in->across + i * in->along] : 0.0f;
}

static void from_group(const side *in, int count, const numbers *out) {
    long size = size_of(in);
    if (out->across == 1 && count == LANES)
        for (long i = 0; i < size; i++) *(loose_vec *)(out->first + i * out->along) = in->values[i];
    else for (long from = 0; from < size; from += BLOCK_OF_NUMBERS)
        for (int n = 0; n < count; n++)
            for (long i = from; i < size && i < from + BLOCK_OF_NUMBERS; i++)
                out->first[n * out->across + i * out->along] = ((const float *)(in->values + i))[n];
}

#define START(N, P)                                                                                                    \
    vec sum[P][N];                                                                                                     \
    UNROLL for (int p = 0; p < P; p++) UNROLL for (int n = 0; n < N; n++)                                              \
        sum[p][n] = (vec){0} + (f->bias ? f->bias[o + n] : 0.0f);

#define STORE(N, P, STEP)                                                                                              \
    UNROLL for (int n = 0; n < N; n++) {                                                                               \
        vec *line = row(out, o + n, y) + x, total = {0};                                                               \
        const vec *gate = f->gate ? row(f->gate, o + n, y) + x : 0;                                                    \
        UNROLL for (int p = 0; p < P; p++) {                                                                           \
            vec value = sum[p][n];                                                                                     \
            if (f->relu) value = positive(value, value);                                                               \
            if (gate) value = positive(value, gate[p * STEP]);                                                         \
            line[p * STEP] = value;                                                                                    \
            total += value;                                                                                            \
        }                                                                                                              \
        if (f->totals) f->totals[o + n] += total;                                                                      \
    }

/* N channels of P neighbouring columns of the narrow side. */
#define NARROW(N, P)                                                                                                   \
    INLINE void narrow_##N##_##P(const side *in, const side *out, const layer *l, int k, int s, const finish *f,       \
                                 int o, int y, int x) {                                                                \
        int O = out->channels;                                                                                         \
        START(N, P)                                                                                                    \
        for (int c = 0; c < in->channels; c++)                                                                         \
            for (int ky = 0; ky < k; ky++) {                                                                           \
                const vec *value = row(in, c, y * s + ky) + x * s;                                                     \
                const float *weight = l->narrowing + (long)(c * k + ky) * k * O + o;                                   \
                for (int kx = 0; kx < k; kx++, weight += O)                                                            \
                    UNROLL for (int p = 0; p < P; p++) {                                                               \
                        LOAD(one, value[kx + p * s]);                                                                  \
                        UNROLL for (int n = 0; n < N; n++) sum[p][n] += one * weight[n];                               \
                    }                                                                                                  \
            }                                                                                                          \
        STORE(N, P, 1)                                                                                                 \
    }

/* N channels of P columns of the wide side, x, x + s, ..., x = first s + phase: column first - t of the narrow side
 * reaches the first of them with kernel column phase + s t. */
#define WIDEN(N, P)                                                                                                    \
    INLINE void widen_##N##_##P(const side *in, const side *out, const layer *l, int k, int s, const finish *f,        \
                                int o, int y, int first, int phase) {                                                  \
        int O = out->channels, x = first * s + phase;                                                                  \
        long plane = (long)in->kept * in->columns;                                                                     \
        START(N, P)                                                                                                    \
        for (int ky = y % s, iy = y / s; ky < k && iy >= 0; ky += s, iy--) {                                           \
            if (iy >= in->rows) continue;                                                                              \
            for (int kx = phase, ix = first; kx < k && ix >= 0; kx += s, ix--) {                                       \
                if (P == 1 && ix >= in->columns) continue;                                                             \
                const vec *value = row(in, 0, iy) + ix;                                                                \
                const float *weight = l->widening + (long)(ky * k + kx) * O + o;                                       \
                for (int c = 0; c < in->channels; c++, value += plane, weight += (long)k * k * O)                      \
                    UNROLL for (int p = 0; p < P; p++) {                                                               \
                        LOAD(one, value[p]);                                                                           \
                        UNROLL for (int n = 0; n < N; n++) sum[p][n] += one * weight[n];                               \
                    }                                                                                                  \
            }                                                                                                          \
        }                                                                                                              \
        STORE(N, P, s)                                                                                                 \
    }

#define TILES(KIND) KIND(5, 4) KIND(5, 1) KIND(3, 4) KIND(3, 1) KIND(1, 4) KIND(1, 1)

TILES(NARROW)
TILES(WIDEN)
WIDEN(3, 8)

/* All channels of P columns before the next columns: what they are made of stays in the first cache meanwhile. */
#define CHANNELS(KIND, P, ...)                                                                                         \
    for (int o = 0; o < out->channels;) {                                                                              \
        int left = out->channels - o;                                                                                  \
        if (left >= 5) KIND##_5_##P(in, out, l, k, s, f, o, y, __VA_ARGS__), o += 5;                                   \
        else if (left >= 3) KIND##_3_##P(in, out, l, k, s, f, o, y, __VA_ARGS__), o += 3;                              \
        else KIND##_1_##P(in, out, l, k, s, f, o, y, __VA_ARGS__), o += 1;                                             \
    }

INLINE void widen_any(const side *in, const side *out, const layer *l, int k, int s, const finish *f, int from,
                      int to) {
    int taps = (k + s - 1) / s, tiles = least(in->columns, out->columns / s);
    for (int y = from; y < to; y++)
        for (int first = 0, next; first * s < out->columns; first = next) {
            /* Tiles only where all four columns of all taps lie inside the input. */
            int fit = first < taps - 1 ? 0 : tiles - first;
            int tile = fit >= 8 && out->channels == 3 ? 8 : fit >= 4 ? 4 : 0;
            next = first + (tile ? tile : 1);
            UNROLL for (int phase = 0; phase < s; phase++) {
                if (tile == 8) widen_3_8(in, out, l, k, s, f, 0, y, first, phase);
                else if (tile) CHANNELS(widen, 4, first, phase)
                else if (first * s + phase < out->columns) CHANNELS(widen, 1, first, phase)
            }
        }
}

/* Rows from .. to of the narrow side (out): convolution without padding. */
static void narrow_rows(const side *in, const side *out, const layer *l, const finish *f, int from, int to) {
    int k = l->kernel, s = l->stride;
    if (l->paired && k == 3) narrow_paired(in, out, l->narrowing, 3, 2, f, from, to);
    else if (l->paired) narrow_paired(in, out, l->narrowing, 5, 3, f, from, to);
    else for (int y = from; y < to; y++) {
        int x = 0;
        for (; x + 4 <= out->columns; x += 4) CHANNELS(narrow, 4, x)
        for (; x < out->columns; x++) CHANNELS(narrow, 1, x)
    }
}

/* Rows from .. to of the wide side (out): transposed convolution. */
static void widen_rows(const side *in, const side *out, const layer *l, const finish *f, int from, int to) {
    if (l->paired && l->kernel == 3) widen_paired(in, out, l->widening, 3, 2, f, from, to);
    else if (l->paired) widen_paired(in, out, l->widening, 5, 3, f, from, to);
    else widen_any(in, out, l, l->kernel, l->stride, f, from, to);
}

/* Rows and columns that a gradient of weights takes together: few enough to stay in the first cache. */
#define BLOCK_ROWS 2
#define BLOCK_COLUMNS 16

#define CORRELATE(N, K)                                                                                                \
    INLINE void correlate_##N##_##K(const side *narrow, const side *wide, int s, int a, int b, int ky, int kx, int y,   \
                                    int rows, int x, int columns, vec *out, long step) {                               \
        vec sum[N][K];                                                                                                 \
        UNROLL for (int n = 0; n < N; n++) UNROLL for (int i = 0; i < K; i++) sum[n][i] = out[n * step + i];           \
        long plane = (long)narrow->kept * narrow->columns;                                                             \
        for (int end = y + rows; y < end; y++) {                                                                       \
            const vec *left = row(narrow, a, y) + x, *right = row(wide, b, y * s + ky) + x * s + kx;                   \
            for (int count = columns; count > 0; count--, left++, right += s) {                                        \
                vec value[K];                                                                                          \
                UNROLL for (int i = 0; i < K; i++) {                                                                   \
                    LOAD(one, right[i]);                                                                               \
                    value[i] = one;                                                                                    \
                }                                                                                                      \
                UNROLL for (int n = 0; n < N; n++) {                                                                   \
                    LOAD(one, left[n * plane]);                                                                        \
                    UNROLL for (int i = 0; i < K; i++) sum[n][i] += one * value[i];                                    \
                }                                                                                                      \
            }                                                                                                          \
        }                                                                                                              \
        UNROLL for (int n = 0; n < N; n++) UNROLL for (int i = 0; i < K; i++) out[n * step + i] = sum[n][i];           \
    }

CORRELATE(5, 5)
CORRELATE(5, 3)
CORRELATE(5, 1)
CORRELATE(1, 5)
CORRELATE(1, 3)
CORRELATE(1, 1)

#define TAPS(N)                                                                                                        \
    for (int kx = 0; kx < k;) {                                                                                        \
        vec *out = sums + (((long)a * wide->channels + b) * k + ky) * k + kx;                                          \
        if (k - kx >= 5) correlate_##N##_5(narrow, wide, s, a, b, ky, kx, y, rows, x, columns, out, step), kx += 5;    \
        else if (k - kx >= 3) correlate_##N##_3(narrow, wide, s, a, b, ky, kx, y, rows, x, columns, out, step), kx += 3; \
        else correlate_##N##_1(narrow, wide, s, a, b, ky, kx, y, rows, x, columns, out, step), kx += 1;                \
    }

INLINE void correlate_any(const side *narrow, const side *wide, int k, int s, vec *sums, int from, int to) {
    long step = (long)wide->channels * k * k;
    for (int y = from; y < to; y += BLOCK_ROWS)
        for (int x = 0; x < narrow->columns; x += BLOCK_COLUMNS) {
            int rows = least(to - y, BLOCK_ROWS), columns = least(narrow->columns - x, BLOCK_COLUMNS);
            for (int a = 0, N; a < narrow->channels; a += N) {
                N = narrow->channels - a >= 5 ? 5 : 1;
                for (int b = 0; b < wide->channels; b++)
                    for (int ky = 0; ky < k; ky++) {
                        if (N == 5) TAPS(5)
                        else TAPS(1)
                    }
            }
        }
}

/* Columns, and rows, of what a gradient of weights is summed up in. With kernel 5 its own are as fast as paired taps. */
INLINE int taps_of(const layer *l) { return l->paired && l->kernel == 3 ? TAPS_OF(3, 2) : l->kernel; }

/* sums[a][b][ky][kx] += narrow[a][y][x] wide[b][y s + ky][x s + kx] over rows from .. to of the narrow side. */
static void correlate_rows(const side *narrow, const side *wide, const layer *l, vec *sums, int from, int to) {
    if (taps_of(l) > l->kernel) correlate_paired(narrow, wide, sums, 3, 2, from, to);
    else correlate_any(narrow, wide, l->kernel, l->stride, sums, from, to);
}

/* out[i] = sum of the lanes of sums[i]. */
static void add_lanes(const vec *sums, long count, float *out) {
    for (long i = 0; i < count; i++) {
        float total = 0.0f;
        for (int lane = 0; lane < LANES; lane++) total += sums[i][lane];
        out[i] = total;
    }
}

static long weights(const side *narrow, const side *wide, const layer *l) {
    return (long)narrow->channels * wide->channels * taps_of(l) * taps_of(l);
}

/* The gradient of the weights (narrow channel, wide channel, ky, kx) that correlate_rows has summed up. */
static void take_gradient(const side *narrow, const side *wide, const layer *l, const vec *sums, float *out) {
    int count = taps_of(l) * taps_of(l);
    float taps[TAPS_OF(3, 2) * TAPS_OF(3, 2)];
    if (taps_of(l) == l->kernel) add_lanes(sums, weights(narrow, wide, l), out);
    else for (long i = 0; i < (long)narrow->channels * wide->channels; i++) {
        add_lanes(sums + i * count, count, taps);
        unpair_taps(taps, 3, 2, out + i * 3 * 3);
    }
}

static vec *zeros(long count) {
    vec *room = aligned_alloc(sizeof(vec), sizeof(vec) * count);
    if (room) memset(room, 0, sizeof(vec) * count);
    return room;
}

/* The same side with the last `rows` rows in memory, and room for them. */
static side ring(const side *s, int rows) {
    int kept = 1;
    while (kept < rows) kept *= 2;
    side few = {0, s->channels, s->rows, s->columns, kept, kept - 1};
    few.values = aligned_alloc(sizeof(vec), sizeof(vec) * few.channels * kept * few.columns);
    return few;
}

typedef void rows_of(const side *in, const side *out, const layer *l, const finish *f, int from, int to);

static int whole(rows_of *rows, const side *in, const side *out, const layer *l, int relu, const side *gate,
                 float *totals) {
    vec *sums = zeros(out->channels);
    int failed = !sums;
    finish f = {l->bias, relu, gate, totals ? sums : 0};
    if (!failed) rows(in, out, l, &f, 0, out->rows);
    if (!failed && totals) add_lanes(sums, out->channels, totals);
    free(sums);
    return -failed;
}

/* The narrow side = convolution of the wide one. Returns 0, or -1 when memory has run out. */
static int narrow(const side *wide, const side *narrow, const layer *l, int relu, const side *gate, float *totals) {
    return whole(narrow_rows, wide, narrow, l, relu, gate, totals);
}

/* The wide side = transposed convolution of the narrow one. Returns 0, or -1 when memory has run out. */
static int widen(const side *narrow, const side *wide, const layer *l, int relu, const side *gate, float *totals) {
    return whole(widen_rows, narrow, wide, l, relu, gate, totals);
}

/* Gradient of a weight: out[a][b][ky][kx] = sum narrow[a][y][x] wide[b][y s + ky][x s + kx]. Returns 0 or -1. */
static int correlate(const side *narrow, const side *wide, const layer *l, float *out) {
    vec *sums = zeros(weights(narrow, wide, l));
    if (!sums) return -1;
    correlate_rows(narrow, wide, l, sums, 0, narrow->rows);
    take_gradient(narrow, wide, l, sums, out);
    free(sums);
    return 0;
}

/* out[c] = sum over rows, columns and images. */
static void channel_sums(const side *s, float *out) {
    long plane = (long)s->rows * s->columns;
    for (int c = 0; c < s->channels; c++) {
        vec sum = {0};
        for (long i = 0; i < plane; i++) sum += s->values[c * plane + i];
        add_lanes(&sum, 1, out + c);
    }
}

/* Rows of the narrow side of the layer next to the image that are worked off together. The layer behind it takes as many
 * of its narrow side, or twice as many of its wide side: the rows of a pair must be there. */
#define STRIP 2
#define WIDE_STRIP (2 * STRIP)

/* Rows of the wide side that the narrow side's rows up to `to` reach. */
INLINE int reach(const side *narrow, const side *wide, const layer *l, int to) {
    return to < narrow->rows ? (to - 1) * l->stride + l->kernel : wide->rows;
}

/* Rows of the narrow side whose reach lies within the wide side's rows up to `to`. */
INLINE int within(const side *narrow, const side *wide, const layer *l, int to) {
    if (to >= wide->rows) return narrow->rows;
    return to < l->kernel ? 0 : (to - l->kernel) / l->stride + 1;
}

static side image_of(const pictures *p) {
    return (side){0, p->channels, p->rows, p->columns, p->rows, -1};
}

static uint8_t *line_of(const pictures *p) { return malloc((long)p->columns * p->channels * LANES); }

/* The first two convolutions, from the pictures to values and further to out, with relu behind the first, and behind
 * the second if relu. Without a second one (second->kernel = 0) values are the end, with relu if relu. Returns 0, or -1
 * without memory.
 */
static int look(const pictures *p, const layer *first, const layer *second, const side *values, const side *out,
                int relu) {
    int two = second->kernel != 0;
    side all = image_of(p);
    side image = ring(&all, (STRIP - 1) * first->stride + first->kernel);
    uint8_t *line = line_of(p);
    int failed = !image.values || !line;
    finish f = {first->bias, two || relu, 0, 0}, last = {second->bias, relu, 0, 0};
    for (int from = 0, done = 0, made = 0; from < values->rows && !failed; from += STRIP) {
        int to = least(from + STRIP, values->rows), end = (to - 1) * first->stride + first->kernel;
        read_rows(p, &image, line, done, end);
        done = end;
        narrow_rows(&image, values, first, &f, from, to);
        if (two) {
            int ready = within(out, values, second, to);
            if (ready - made < STRIP && ready < out->rows) continue;
            narrow_rows(values, out, second, &last, made, ready);
            made = ready;
        }
    }
    free(image.values);
    free(line);
    return -failed;
}

/* Gradients of the first two convolutions: of the weights of both, and of the bias of the first.
 *
 * values: between the two; slopes: behind the second. Without a second one (values->values = 0) slopes are behind the
 * first, and its bias is left alone. Returns 0, or -1 without memory.
 */
static int look_back(const pictures *p, const layer *first, const layer *second, const side *values, const side *slopes,
              float *first_weight, float *first_bias, float *second_weight) {
    int two = values->values != 0;
    const side *middle = two ? values : slopes;
    side all = image_of(p);
    side image = ring(&all, (STRIP - 1) * first->stride + first->kernel);
    side inner = two ? ring(values, WIDE_STRIP) : *slopes;
    long counts[2] = {weights(middle, &image, first), two ? weights(slopes, values, second) : 0};
    vec *sums = zeros(counts[0] + counts[1] + middle->channels);
    uint8_t *line = line_of(p);
    int failed = !image.values || !inner.values || !sums || !line;
    finish f = {0, 0, values, sums ? sums + counts[0] + counts[1] : 0};
    for (int from = 0, done = 0, seen = 0; from < middle->rows && !failed; from += STRIP) {
        int to = least(from + STRIP, middle->rows), end = (to - 1) * first->stride + first->kernel;
        read_rows(p, &image, line, done, end);
        done = end;
        if (two) {
            int ready = within(slopes, values, second, to);
            if (ready - seen >= STRIP || ready == slopes->rows) {
                correlate_rows(slopes, values, second, sums + counts[0], seen, ready);
                seen = ready;
            }
            if (from % WIDE_STRIP == 0)
                widen_rows(slopes, &inner, second, &f, from, least(from + WIDE_STRIP, middle->rows));
        }
        correlate_rows(&inner, &image, first, sums, from, to);
    }
    if (!failed) {
        take_gradient(middle, &image, first, sums, first_weight);
        if (two) take_gradient(slopes, values, second, sums + counts[0], second_weight);
        if (two) add_lanes(f.totals, middle->channels, first_bias);
    }
    if (two) free(inner.values);
    free(image.values);
    free(sums);
    free(line);
    return -failed;
}

/* The gradients that reconstruct leaves behind. */
struct gradients {
    float *errors;                                                /* (LANES) sums of squared differences */
    float *last_weight, *last_bias, *before_weight, *before_bias; /* of the last two layers */
    float *totals;                                                /* (channels) of slopes, where they are wanted */
    const side *slopes;                                           /* where values came in */
};

/* The decoder's last two layers and back: values -> image, compared with pictures.
 *
 * Leaves behind, for sum scale[lane] errors[lane] / 2, all gradients; at the values they came from zero where these are
 * not positive, if relu. Without a layer before the last one (before->kernel = 0) values are the last layer's input.
 * Returns 0, or -1 without memory.
 */
static int reconstruct(const side *values, const layer *last, const layer *before, const side *behind, const pictures *p,
                const float *scale, int relu, const struct gradients *g) {
    int two = before->kernel != 0;
    const side *middle = two ? behind : values;
    side all = image_of(p);
    /* A kernel smaller than its stride leaves rows between the strips, and behind the last. */
    int high = STRIP * last->stride + (last->kernel > last->stride ? last->kernel : last->stride) - 1;
    int deep = ((STRIP - 1) * last->stride + last->kernel - 1) / last->stride + 1;
    side image = ring(&all, high);
    side inner = two ? ring(middle, deep + WIDE_STRIP - 1) : *values;
    side flow = two ? ring(middle, STRIP + before->kernel + before->stride) : *g->slopes;
    long counts[2] = {weights(middle, &image, last), two ? weights(values, middle, before) : 0};
    vec *sums = zeros(counts[0] + counts[1] + p->channels + middle->channels + values->channels);
    uint8_t *line = line_of(p);
    int failed = !image.values || !inner.values || !flow.values || !sums || !line;
    vec *image_totals = sums + counts[0] + counts[1];
    vec *middle_totals = image_totals + p->channels, *totals = middle_totals + middle->channels;
    double errors[LANES] = {0};
    vec factor;
    memcpy(&factor, scale, sizeof(vec));
    finish plain = {last->bias, 0, 0, 0}, rising = {before->bias, 1, 0, 0};
    finish falling = {0, 0, two || relu ? &inner : 0, middle_totals}, ending = {0, 0, relu ? values : 0, totals};
    for (int from = 0, done = 0, made = 0, seen = 0; from < middle->rows && !failed; from += STRIP) {
        int to = least(from + STRIP, middle->rows), end = reach(middle, &image, last, to);
        if (two) {
            int needed = least((end - 1) / last->stride + 1, middle->rows);
            if (made < needed) {
                int more = least(made + WIDE_STRIP > needed ? made + WIDE_STRIP : needed, middle->rows);
                widen_rows(values, &inner, before, &rising, made, more);
                made = more;
            }
        }
        widen_rows(&inner, &image, last, &plain, done, end);
        compare_rows(&image, p, factor, errors, image_totals, line, done, end);
        done = end;
        correlate_rows(&inner, &image, last, sums, from, to);
        narrow_rows(&image, &flow, last, &falling, from, to);
        if (two) {
            int ready = within(values, middle, before, to);
            if (ready - seen < STRIP && ready < values->rows) continue;
            correlate_rows(values, &flow, before, sums + counts[0], seen, ready);
            narrow_rows(&flow, g->slopes, before, &ending, seen, ready);
            seen = ready;
        }
    }
    if (!failed) {
        for (int lane = 0; lane < LANES; lane++) g->errors[lane] = (float)errors[lane];
        take_gradient(middle, &image, last, sums, g->last_weight);
        add_lanes(image_totals, p->channels, g->last_bias);
        if (two) take_gradient(values, middle, before, sums + counts[0], g->before_weight);
        if (two) add_lanes(middle_totals, middle->channels, g->before_bias);
        if (g->totals) add_lanes(two ? totals : middle_totals, values->channels, g->totals);
    }
    if (two) free(inner.values);
    if (two) free(flow.values);
    free(image.values);
    free(sums);
    free(line);
    return -failed;
}

/* What Python calls for one group of images: the whole encoder or decoder, there or back.
 *
 * layers: count of them, from the image inwards. sides: count + 1 of them; that of the image, and behind each layer.
 * gradients: of weight, bias, weight, ... from the image inwards. All return 0, or -1 when memory has run out.
 */

#define NEAR 2 /* layers next to the image that are worked off together */

int near_layers(void) { return NEAR; }

static const layer NONE = {0, 0, 0, 0, 0, 0};

static const layer *second_of(const layer *layers, int count) { return count > 1 ? layers + 1 : &NONE; }

static layer without_bias(const layer *l) {
    layer other = *l;
    other.bias = 0;
    return other;
}

/* Pictures -> values on all sides, the last ones also as numbers, in each of `copies` places. */
int encode(const pictures *p, const layer *layers, const side *sides, int count, const numbers *out, int copies) {
    int near = least(count, NEAR);
    int failed = look(p, layers, second_of(layers, count), sides + 1, sides + near, count > near);
    for (int i = near; i < count && !failed; i++)
        failed = narrow(sides + i, sides + i + 1, layers + i, i + 1 < count, 0, 0);
    for (int i = 0; i < copies && !failed; i++) from_group(sides + count, p->count, out + i);
    return failed;
}

/* Slopes at what encode() has left -> gradients. flow: room for the slopes on the sides from NEAR on. */
int encode_back(const pictures *p, const layer *layers, const side *sides, const side *flow, int count,
                const numbers *slopes, float *const *gradients) {
    int near = least(count, NEAR), failed = 0;
    to_group(slopes, p->count, flow + count);
    channel_sums(flow + count, gradients[2 * count - 1]);
    for (int i = count - 1; i >= near && !failed; i--) {
        layer back = without_bias(layers + i);
        failed = correlate(flow + i + 1, sides + i, layers + i, gradients[2 * i]);
        if (!failed) failed = widen(flow + i + 1, flow + i, &back, 0, sides + i, gradients[2 * i - 1]);
    }
    if (failed) return failed;
    if (near == 1) return look_back(p, layers, &NONE, sides, flow + 1, gradients[0], 0, 0);
    return look_back(p, layers, layers + 1, sides + 1, flow + 2, gradients[0], gradients[1], gradients[2]);
}

/* Features of `images` images -> values on the sides down to `nearest`. */
int decode(const numbers *features, int images, const layer *layers, const side *sides, int count, int nearest) {
    int failed = 0;
    to_group(features, images, sides + count);
    for (int i = count - 1; i >= nearest && !failed; i--)
        failed = widen(sides + i + 1, sides + i, layers + i, i > 0, 0, 0);
    return failed;
}

/* Features -> images, compared with pictures, and back: gradients, and slopes at the features, of the sum over images of
 * scales / 2 times the squared differences, which are left in errors. sides, flow: room for values and slopes from NEAR
 * on. */
int decode_back(const numbers *features, const pictures *p, const float *scales, const layer *layers, const side *sides,
                const side *flow, int count, const numbers *slopes, float *errors, float *const *gradients) {
    int near = least(count, NEAR), deep = count > near;
    float scale[LANES] = {0}, squares[LANES];
    memcpy(scale, scales, sizeof(float) * p->count);
    struct gradients found = {squares, gradients[0], gradients[1], near > 1 ? gradients[2] : 0,
                              near > 1 ? gradients[3] : 0, deep ? gradients[2 * near + 1] : 0, flow + near};
    int failed = decode(features, p->count, layers, sides, count, near);
    if (!failed)
        failed = reconstruct(sides + near, layers, second_of(layers, count), sides + 1, p, scale, deep, &found);
    for (int i = near; i < count && !failed; i++) {
        layer back = without_bias(layers + i);
        int further = i + 1 < count;
        failed = correlate(sides + i + 1, flow + i, layers + i, gradients[2 * i]);
        if (!failed)
            failed = narrow(flow + i, flow + i + 1, &back, 0, further ? sides + i + 1 : 0,
                            further ? gradients[2 * i + 3] : 0);
    }
    if (failed) return failed;
    from_group(flow + count, p->count, slopes);
    memcpy(errors, squares, sizeof(float) * p->count);
    return 0;
}
