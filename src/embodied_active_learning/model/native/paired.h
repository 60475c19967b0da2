#pragma once

#include "sides.h"

/* Convolutions with fewer products, for kernel 3 with stride 2 and kernel 5 with stride 3.
 *
 * Two neighbours on the narrow side, y0 and y1, meet three values of the wide side, d0, d1 and d2, in two taps of the
 * filter, u and w, that lie a stride apart: a pair. Three products do what four do, both ways and in the gradient
 * (Winograd's F(2, 2)):
 *
 *     y0 = u d0 + w d1 = u (d0 - d1) + (u + w) d1          narrowing; in widening d and y change places, and u and w
 *     y1 = u d1 + w d2 = (u + w) d1 + w (d2 - d1)
 *
 *     u = d0 y0 + d1 y1 = (d0 - d1) y0 + d1 (y0 + y1)      gradient of the taps
 *     w = d1 y0 + d2 y1 = d1 (y0 + y1) + (d2 - d1) y1
 *
 * Along rows and columns that leaves 25 products of 36 for kernel 3, and 64 of 100 for kernel 5. The sums u + w are made
 * once: a filter has further taps behind its own, k + phase for the pair of taps phase and phase + s. The other additions
 * cost little: the processor has units for them that the products leave idle.
 *
 * Two rows that share products are made in three parts: what is in BOTH, and what the FIRST and the SECOND have besides.
 * A row without a partner is made ALONE. Along columns, two neighbours on the narrow side and what belongs to them on the
 * wide side are a tile; the last tile may overlap the one before.
 */
enum { BOTH, FIRST, SECOND, ALONE };

/* Taps in one direction, and the rows of the wide side that a pair of rows reaches. */
#define TAPS_OF(k, s) (2 * (k) - (s))
#define MOST_TAPS TAPS_OF(5, 3)
#define MOST_ROWS (5 + 3)
#define MOST_STRIDE 3
#define IS_PAIR(phase) ((phase) + s < k)

#define WIDTH 5 /* most channels that are worked off together */
#define AHEAD 8 /* columns by which memory is asked for before it is written */

INLINE int width(int channels) { return channels >= 5 ? 5 : channels >= 3 ? 3 : 1; }

/* Taps of the channels from o on: (input channel, row of taps, column of taps, channel). */
INLINE long taps_before(int o, int inputs, int k, int s) { return (long)o * inputs * TAPS_OF(k, s) * TAPS_OF(k, s); }

/* A value of a row, or of the difference of two rows. */
#define VALUE(name, i)                                                                                                 \
    LOAD(name, plus[i]);                                                                                               \
    if (is_difference) name -= minus[i]

#define PRODUCTS(m, value, column)                                                                                     \
    UNROLL for (int i = 0; i < n; i++) ADD_PRODUCT(sum[m][i], value, tap[(column) * n + i])

/* Store one value. */
INLINE vec deliver(const finish *f, vec *to, const vec *gate, float bias, vec value) {
    value += bias;
    if (f->relu) value = positive(value, value);
    if (f->gate) {
        value = positive(value, *gate);
        __builtin_prefetch(gate + AHEAD);
    }
    __builtin_prefetch(to + AHEAD, 1);
    *to = value;
    return value;
}

/* One input channel of one row: sum[0] + sum[1] is the left column of the tile, sum[1] + sum[2] the right one. */
INLINE void narrow_line(vec (*sum)[WIDTH], const vec *plus, int is_difference, const vec *minus, const float *tap,
                        int k, int s, int n) {
    UNROLL for (int phase = 0; phase < s; phase++) {
        VALUE(left, phase);
        VALUE(middle, phase + s);
        if (IS_PAIR(phase)) {
            VALUE(right, phase + 2 * s);
            PRODUCTS(1, middle, k + phase);
            left -= middle;
            PRODUCTS(0, left, phase);
            right -= middle;
            PRODUCTS(2, right, phase + s);
        } else {
            PRODUCTS(0, left, phase);
            PRODUCTS(2, middle, phase);
        }
    }
}

/* n channels of one part of a tile. */
INLINE void narrow_part(vec (*sum)[WIDTH], const vec *const *rows, long plane, int channels, const float *tap, int k,
                        int s, int n, int part) {
    const int taps = TAPS_OF(k, s);
    UNROLL for (int m = 0; m < 3; m++) UNROLL for (int i = 0; i < n; i++) sum[m][i] = (vec){0};
    for (long c = 0, at = 0; c < channels; c++, at += plane, tap += taps * taps * n) {
#define LINE(y, is_difference, v)                                                                                      \
    narrow_line(sum, rows[y] + at, is_difference, rows[(is_difference) ? phase + s : phase] + at,   \
                tap + (v) * taps * n, k, s, n)
        if (part == ALONE) UNROLL for (int phase = 0; phase < k; phase++) LINE(phase, 0, phase);
        if (part == BOTH) UNROLL for (int phase = 0; phase < k - s; phase++) LINE(phase + s, 0, k + phase);
        if (part == FIRST) UNROLL for (int phase = 0; phase < s; phase++) LINE(phase, IS_PAIR(phase), phase);
        if (part == SECOND)
            UNROLL for (int phase = 0; phase < s; phase++) {
                if (IS_PAIR(phase)) LINE(phase + 2 * s, 1, phase + s);
                else LINE(phase + s, 0, phase);
            }
#undef LINE
    }
}

/* What is done on the way forward, in such a form that the compiler knows of neither gate nor totals. */
INLINE finish forward(const finish *f) { return (finish){f->bias, f->relu, 0, 0}; }

INLINE int is_forward(const finish *f) { return !f->gate && !f->totals; }

/* n channels from o on of a tile: columns x and x + 1 of row y, or of two rows. Those before `done` are in the totals
 * already. lines: the rows of the wide side that are needed. */
INLINE void narrow_tile(const side *in, const vec *const *lines, const side *out, const float *taps, const finish *f,
                        int k, int s, int n, int o, int y, int height, int x, int done) {
    long plane = plane_of(in), out_plane = plane_of(out), gate_plane = f->gate ? plane_of(f->gate) : 0;
    const vec *rows[MOST_ROWS];
    for (int i = 0; i < k + (height - 1) * s; i++) rows[i] = lines[i] + x * s;
    const float *tap = taps + taps_before(o, in->channels, k, s);
    vec sum[3][WIDTH], room[2][WIDTH], (*both)[WIDTH] = room;
    __asm__("" : "+r"(both) : : "memory"); /* registers are for the sums */
    if (height == 2) {
        narrow_part(sum, rows, plane, in->channels, tap, k, s, n, BOTH);
        UNROLL for (int p = 0; p < 2; p++) UNROLL for (int i = 0; i < n; i++) both[p][i] = sum[1][i] + sum[2 * p][i];
    } else UNROLL for (int p = 0; p < 2; p++) UNROLL for (int i = 0; i < n; i++) both[p][i] = (vec){0};
    for (int line = 0; line < height; line++) {
        if (height == 1) narrow_part(sum, rows, plane, in->channels, tap, k, s, n, ALONE);
        else if (line == 0) narrow_part(sum, rows, plane, in->channels, tap, k, s, n, FIRST);
        else narrow_part(sum, rows, plane, in->channels, tap, k, s, n, SECOND);
        vec *to = row(out, o, y + line) + x;
        const vec *gate = f->gate ? row(f->gate, o, y + line) + x : to;
        UNROLL for (int i = 0; i < n; i++, to += out_plane, gate += gate_plane) {
            float bias = f->bias ? f->bias[o + i] : 0.0f;
            vec left = deliver(f, to, gate, bias, sum[1][i] + sum[0][i] + both[0][i]);
            vec right = deliver(f, to + 1, gate + 1, bias, sum[1][i] + sum[2][i] + both[1][i]);
            if (f->totals) f->totals[o + i] += done > x ? right : left + right;
        }
    }
}

/* Columns for which some channels are made before the next ones: few, so that the wide side stays in the first cache, or
 * all where the taps would not. */
#define BLOCK 16
#define FEW_TAPS 4096

INLINE int block_of(const side *in, const side *out, int columns, int k, int s) {
    return taps_before(out->channels, in->channels, k, s) > FEW_TAPS ? columns : BLOCK;
}

/* Rows from .. to of the narrow side, which has two columns at least. */
INLINE void narrow_paired(const side *in, const side *out, const float *taps, int k, int s, const finish *f, int from,
                          int to) {
    int block = block_of(in, out, out->columns, k, s);
    const finish simple = forward(f);
    for (int y = from, height; y < to; y += height) {
        height = least(2, to - y);
        const vec *lines[MOST_ROWS];
        for (int i = 0; i < k + (height - 1) * s; i++) lines[i] = row(in, 0, y * s + i);
        for (int begin = 0; begin < out->columns; begin += block)
            for (int o = 0, n; o < out->channels; o += n) {
                n = width(out->channels - o);
                for (int done = begin; done < begin + block && done < out->columns; done += 2) {
                    int x = least(done, out->columns - 2); /* the last tile may overlap the one before */
                    if (n == 5 && is_forward(f))
                        narrow_tile(in, lines, out, taps, &simple, k, s, 5, o, y, height, x, done);
                    else if (n == 5) narrow_tile(in, lines, out, taps, f, k, s, 5, o, y, height, x, done);
                    else if (n == 3) narrow_tile(in, lines, out, taps, f, k, s, 3, o, y, height, x, done);
                    else narrow_tile(in, lines, out, taps, f, k, s, 1, o, y, height, x, done);
                }
            }
    }
}

/* One input channel of one row, phases from begin to end. Columns of the tile: with a pair of taps of the phase they are
 * sum[phase] + sum[s + phase] and, a stride further, sum[s + phase] + sum[2 s + phase]; otherwise sum[phase] and
 * sum[2 s + phase]. Only a tile inside has all its neighbours x - 1, x and x + 1 among the columns. */
INLINE void widen_line(vec (*sum)[WIDTH], const vec *plus, int is_difference, const vec *minus, const float *tap,
                       int k, int s, int n, int begin, int end, int inside, int x, int columns) {
    vec left = {0}, middle = {0}, right = {0};
    if (inside || (x > 0 && x <= columns)) {
        VALUE(value, -1);
        left = value;
    }
    if (inside || x < columns) {
        VALUE(value, 0);
        middle = value;
    }
    if (inside || x + 1 < columns) {
        VALUE(value, 1);
        right = value;
    }
    vec before = left - middle, behind = right - middle;
    UNROLL for (int phase = begin; phase < end; phase++) {
        if (IS_PAIR(phase)) {
            PRODUCTS(s + phase, middle, k + phase);
            PRODUCTS(phase, before, phase + s);
            PRODUCTS(2 * s + phase, behind, phase);
        } else {
            PRODUCTS(phase, middle, phase);
            PRODUCTS(2 * s + phase, right, phase);
        }
    }
}

/* A row of the narrow side, or a difference of two, and the row of taps that it goes through. */
typedef struct {
    const vec *plus, *minus;
    int taps;
} source;

INLINE void widen_part(vec (*sum)[WIDTH], const source *from, int count, long plane, int channels, const float *tap,
                       int k, int s, int n, int begin, int end, int inside, int x, int columns) {
    const int taps = TAPS_OF(k, s);
    UNROLL for (int m = 0; m < 3 * s; m++) UNROLL for (int i = 0; i < n; i++) sum[m][i] = (vec){0};
    for (int t = 0; t < count; t++) {
        const vec *plus = from[t].plus + x, *minus = from[t].minus ? from[t].minus + x : 0;
        const float *now = tap + from[t].taps * taps * n;
        if (minus)
            for (long c = 0, at = 0; c < channels; c++, at += plane, now += taps * taps * n)
                widen_line(sum, plus + at, 1, minus + at, now, k, s, n, begin, end, inside, x, columns);
        else
            for (long c = 0, at = 0; c < channels; c++, at += plane, now += taps * taps * n)
                widen_line(sum, plus + at, 0, 0, now, k, s, n, begin, end, inside, x, columns);
    }
}

/* What row y of the wide side is made of; or y and y + s, and behind them what both share. */
typedef struct {
    int y, height, count[3];
    source of[3][2];
} recipe;

/* n channels from o on of a tile: columns x s + phase and (x + 1) s + phase. Those before `done` s are in the totals
 * already. */
INLINE void widen_tile(const side *in, const side *out, const float *taps, const finish *f, const recipe *r, int k,
                       int s, int n, int begin, int end, int inside, int o, int x, int done) {
    long plane = plane_of(in), out_plane = plane_of(out), gate_plane = f->gate ? plane_of(f->gate) : 0;
    const float *tap = taps + taps_before(o, in->channels, k, s);
    vec sum[3 * MOST_STRIDE][WIDTH], room[2 * MOST_STRIDE][WIDTH], (*both)[WIDTH] = room;
    __asm__("" : "+r"(both) : : "memory"); /* registers are for the sums */
    if (r->height == 2) {
        widen_part(sum, r->of[2], 1, plane, in->channels, tap, k, s, n, begin, end, inside, x, in->columns);
        UNROLL for (int phase = begin; phase < end; phase++) UNROLL for (int i = 0; i < n; i++) {
            vec shared = IS_PAIR(phase) ? sum[s + phase][i] : (vec){0};
            both[phase][i] = sum[phase][i] + shared;
            both[s + phase][i] = sum[2 * s + phase][i] + shared;
        }
    }
    for (int line = 0; line < r->height; line++) {
        widen_part(sum, r->of[line], r->count[line], plane, in->channels, tap, k, s, n, begin, end, inside, x,
                   in->columns);
        int y = r->y + line * s;
        vec *to = row(out, o, y) + x * s;
        const vec *gate = f->gate ? row(f->gate, o, y) + x * s : to;
        UNROLL for (int i = 0; i < n; i++, to += out_plane, gate += gate_plane) {
            float bias = f->bias ? f->bias[o + i] : 0.0f;
            vec total = {0};
            UNROLL for (int phase = begin; phase < end; phase++) {
                vec shared = IS_PAIR(phase) ? sum[s + phase][i] : (vec){0};
                vec left = sum[phase][i] + shared, right = sum[2 * s + phase][i] + shared;
                if (r->height == 2) left += both[phase][i], right += both[s + phase][i];
                if (inside || x * s + phase < out->columns) {
                    left = deliver(f, to + phase, gate + phase, bias, left);
                    if (x >= done) total += left;
                }
                if (inside || (x + 1) * s + phase < out->columns)
                    total += deliver(f, to + s + phase, gate + s + phase, bias, right);
            }
            if (f->totals) f->totals[o + i] += total;
        }
    }
}

INLINE void widen_tiles(const side *in, const side *out, const float *taps, const finish *f, const recipe *r, int k,
                        int s, int n, int begin, int end, int o, int from, int to) {
    int last = (out->columns + s - 1) / s - 2;
    const finish simple = forward(f);
    for (int done = from; done < to; done += 2) {
        int x = least(done, last); /* the last tile may overlap the one before */
        int inside = x > 0 && x + 1 < in->columns && (x + 2) * s <= out->columns;
        if (inside && is_forward(f)) widen_tile(in, out, taps, &simple, r, k, s, n, begin, end, 1, o, x, done);
        else if (inside) widen_tile(in, out, taps, f, r, k, s, n, begin, end, 1, o, x, done);
        else widen_tile(in, out, taps, f, r, k, s, n, begin, end, 0, o, x, done);
    }
}

/* All channels and columns of a row or a pair of rows. */
INLINE void widen_recipe(const side *in, const side *out, const float *taps, const finish *f, const recipe *r, int k,
                         int s) {
    int columns = (out->columns + s - 1) / s, block = block_of(in, out, columns, k, s);
    int middle = s > 2 ? 1 : s; /* more phases at once have more sums than there are registers */
    for (int from = 0; from < columns; from += block)
        for (int o = 0, n; o < out->channels; o += n) {
            n = width(out->channels - o);
            int to = least(from + block, columns);
#define EACH(N)                                                                                                        \
    if (n == N) {                                                                                                      \
        widen_tiles(in, out, taps, f, r, k, s, N, 0, middle, o, from, to);                                             \
        if (middle < s) widen_tiles(in, out, taps, f, r, k, s, N, middle, s, o, from, to);                             \
    }
            EACH(5)
            EACH(3)
            EACH(1)
#undef EACH
        }
}

/* Rows from .. to of the wide side. */
INLINE void widen_paired(const side *in, const side *out, const float *taps, int k, int s, const finish *f, int from,
                         int to) {
    int next[MOST_STRIDE] = {from, from, from};
    for (int y = from; y < to; y++) {
        int phase = y % s, at = y / s;
        if (y < next[phase]) continue;
        recipe r = {y, 1, {0, 0, 0}, {{{0, 0, 0}}}};
        if (IS_PAIR(phase) && y + s < to && at > 0 && at + 1 < in->rows) {
            const vec *middle = row(in, 0, at);
            r = (recipe){y, 2, {1, 1, 1}, {{{row(in, 0, at - 1), middle, phase + s}},
                                           {{row(in, 0, at + 1), middle, phase}},
                                           {{middle, 0, k + phase}}}};
        } else {
            if (at < in->rows) r.of[0][r.count[0]++] = (source){row(in, 0, at), 0, phase};
            if (IS_PAIR(phase) && at > 0 && at <= in->rows)
                r.of[0][r.count[0]++] = (source){row(in, 0, at - 1), 0, phase + s};
        }
        next[phase] = y + r.height * s;
        widen_recipe(in, out, taps, f, &r, k, s);
    }
}

/* One channel of the wide side along a line: sum[h] += what this line gives to the column h of taps. */
INLINE void correlate_line(vec (*sum)[WIDTH], const vec *first, int is_sum, const vec *second, long plane,
                           const vec *plus, int is_difference, const vec *minus, int columns, int k, int s, int n) {
    long at = 0, wide_at = 0;
    for (; columns > 1; columns -= 2, at += 2, wide_at += 2 * s) {
        vec wide[MOST_TAPS];
        UNROLL for (int phase = 0; phase < s; phase++) {
            VALUE(left, wide_at + phase);
            VALUE(middle, wide_at + phase + s);
            if (IS_PAIR(phase)) {
                VALUE(right, wide_at + phase + 2 * s);
                left -= middle;
                right -= middle;
                wide[phase + 2 * s] = right;
            }
            wide[phase] = left;
            wide[phase + s] = middle;
        }
        UNROLL for (int i = 0; i < n; i++) {
            LOAD(left, first[at + i * plane]);
            LOAD(right, first[at + i * plane + 1]);
            if (is_sum) left += second[at + i * plane], right += second[at + i * plane + 1];
            vec both = left + right;
            UNROLL for (int phase = 0; phase < s; phase++) {
                sum[phase][i] += wide[phase] * left;
                if (IS_PAIR(phase)) {
                    sum[k + phase][i] += wide[phase + s] * both;
                    sum[phase + s][i] += wide[phase + 2 * s] * right;
                } else sum[phase][i] += wide[phase + s] * right;
            }
        }
    }
    if (columns == 1)
        UNROLL for (int i = 0; i < n; i++) {
            vec only = first[at + i * plane];
            if (is_sum) only += second[at + i * plane];
            UNROLL for (int kx = 0; kx < k; kx++) {
                VALUE(value, wide_at + kx);
                sum[kx][i] += value * only;
            }
        }
}

/* Rows of a part, first and second of the narrow side, upper and lower of the wide side, and the row of taps for it. */
INLINE void correlate_part(vec *sums, long step, const vec *first, const vec *second, long plane, const vec *upper,
                           const vec *lower, int columns, int k, int s, int n, int part) {
    vec sum[MOST_TAPS][WIDTH];
    UNROLL for (int h = 0; h < TAPS_OF(k, s); h++) UNROLL for (int i = 0; i < n; i++) sum[h][i] = sums[i * step + h];
    if (part == BOTH) correlate_line(sum, first, 1, second, plane, upper, 0, 0, columns, k, s, n);
    if (part == FIRST) correlate_line(sum, first, 0, 0, plane, upper, 1, lower, columns, k, s, n);
    if (part == SECOND) correlate_line(sum, second, 0, 0, plane, lower, 1, upper, columns, k, s, n);
    if (part == ALONE) correlate_line(sum, first, 0, 0, plane, upper, 0, 0, columns, k, s, n);
    UNROLL for (int h = 0; h < TAPS_OF(k, s); h++) UNROLL for (int i = 0; i < n; i++) sums[i * step + h] = sum[h][i];
}

/* n channels of the narrow side from a on, one of the wide side, columns of one row or of two. */
INLINE void correlate_block(const side *narrow, const side *wide, vec *sums, int k, int s, int n, int a, int b, int y,
                            int height, int x, int columns) {
    const int taps = TAPS_OF(k, s);
    long step = (long)wide->channels * taps * taps, plane = plane_of(narrow);
    sums += ((long)a * wide->channels + b) * taps * taps;
    const vec *first = row(narrow, a, y) + x, *second = row(narrow, a, y + height - 1) + x, *rows[MOST_ROWS];
    for (int i = 0; i < k + (height - 1) * s; i++) rows[i] = row(wide, b, y * s + i) + x * s;
#define PART(kind, v, first, second, upper, lower)                                                                     \
    correlate_part(sums + (v) * taps, step, first, second, plane, rows[upper], rows[lower], columns, k, s, n, kind)
    for (int ky = 0; height == 1 && ky < k; ky++) PART(ALONE, ky, first, first, ky, ky);
    for (int phase = 0; height == 2 && phase < s; phase++) {
        if (IS_PAIR(phase)) {
            PART(FIRST, phase, first, second, phase, phase + s);
            PART(BOTH, k + phase, first, second, phase + s, phase + s);
            PART(SECOND, phase + s, first, second, phase + s, phase + 2 * s);
        } else {
            PART(ALONE, phase, first, first, phase, phase);
            PART(ALONE, phase, second, second, phase + s, phase + s);
        }
    }
#undef PART
}

#define SPAN 24 /* columns that a gradient of weights takes together */

/* As correlate_rows, with sums[a][b][row of taps][column of taps]. */
INLINE void correlate_paired(const side *narrow, const side *wide, vec *sums, int k, int s, int from, int to) {
    for (int y = from, height; y < to; y += height) {
        height = least(2, to - y);
        for (int x = 0; x < narrow->columns; x += SPAN) {
            int columns = least(SPAN, narrow->columns - x);
            for (int a = 0, n; a < narrow->channels; a += n) {
                n = width(narrow->channels - a);
                for (int b = 0; b < wide->channels; b++) {
                    if (n == 5) correlate_block(narrow, wide, sums, k, s, 5, a, b, y, height, x, columns);
                    else if (n == 3) correlate_block(narrow, wide, sums, k, s, 3, a, b, y, height, x, columns);
                    else correlate_block(narrow, wide, sums, k, s, 1, a, b, y, height, x, columns);
                }
            }
        }
    }
}

/* Taps, as taps_before counts them, from weights[input * along + output * across + ky k + kx]. */
static void pair_taps(const float *weights, long along, long across, int inputs, int outputs, int k, int s,
                      float *taps) {
    for (int o = 0, n; o < outputs; o += n) {
        n = width(outputs - o);
        for (int c = 0; c < inputs; c++)
            for (int v = 0; v < TAPS_OF(k, s); v++)
                for (int h = 0; h < TAPS_OF(k, s); h++, taps += n) {
                    int ky = v < k ? v : v - k, kx = h < k ? h : h - k;
                    const float *tap = weights + c * along + o * across + ky * k + kx;
                    int below = v < k ? 0 : s * k, right = h < k ? 0 : s;
                    for (int i = 0; i < n; i++, tap += across) {
                        taps[i] = tap[0];
                        if (right) taps[i] += tap[right];
                        if (below) taps[i] += tap[below];
                        if (right && below) taps[i] += tap[right + below];
                    }
                }
    }
}

/* Gradient of the weights (ky, kx) of a pair of channels from that of their taps. */
INLINE void unpair_taps(const float *taps, int k, int s, float *out) {
    const int count = TAPS_OF(k, s);
    for (int ky = 0; ky < k; ky++)
        for (int kx = 0; kx < k; kx++) {
            int below = IS_PAIR(ky % s) ? k + ky % s : 0, right = IS_PAIR(kx % s) ? k + kx % s : 0;
            float total = taps[ky * count + kx];
            if (right) total += taps[ky * count + right];
            if (below) total += taps[below * count + kx];
            if (right && below) total += taps[below * count + right];
            *out++ = total;
        }
}
