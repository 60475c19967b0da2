/* Matrix multiplication in single precision. */
#pragma once

#include "vectors.h"

/* Vectors of columns that one pass computes: with 6 rows, as many sums as fit into the registers. */
#ifdef __AVX512F__
#define PANEL_VECTORS 4
#else
#define PANEL_VECTORS 2
#endif
#define PANEL_COLUMNS (PANEL_VECTORS * LANES)
#define PACKED_PANELS (8 / PANEL_VECTORS) /* panels of the right factor that are packed together */
#define PACKED_DEPTH 512 /* rows of a packed panel: all panels together fit into the second-level cache */

/* out (N, PANEL_COLUMNS) = left (N, depth) right (depth, PANEL_COLUMNS), added to out if `add`. */
#define MULTIPLY_PANEL(N)                                                                                              \
    INLINE void multiply_panel_##N(const float *left, long row_stride, long column_stride, const vec *right,            \
                                   float *out, long out_stride, int depth, int add) {                                  \
        vec sum[N][PANEL_VECTORS];                                                                                     \
        UNROLL for (int n = 0; n < N; n++) UNROLL for (int i = 0; i < PANEL_VECTORS; i++)                              \
            __builtin_prefetch(out + n * out_stride + i * LANES, 1);                                                   \
        UNROLL for (int n = 0; n < N; n++) UNROLL for (int i = 0; i < PANEL_VECTORS; i++)                              \
            sum[n][i] = add ? *(const unaligned_vec *)(out + n * out_stride + i * LANES) : (vec){0};                   \
        for (int d = 0; d < depth; d++, left += column_stride, right += PANEL_VECTORS)                                 \
            UNROLL for (int n = 0; n < N; n++) UNROLL for (int i = 0; i < PANEL_VECTORS; i++)                          \
                sum[n][i] += left[n * row_stride] * right[i];                                                          \
        UNROLL for (int n = 0; n < N; n++) UNROLL for (int i = 0; i < PANEL_VECTORS; i++)                              \
            *(unaligned_vec *)(out + n * out_stride + i * LANES) = sum[n][i];                                          \
    }

MULTIPLY_PANEL(6)
MULTIPLY_PANEL(1)

int panel_columns(void) { return PANEL_COLUMNS; }

/* out (rows, columns) = left (rows, depth) right (depth, columns).
 *
 * left[m * row_stride + d * column_stride]; rows of right and out are contiguous, right_stride and out_stride apart.
 * columns must be at least panel_columns(): the last panel ends at the last column and may overlap the previous one.
 * Several panels of the right factor are packed at once: longer pieces of its rows are read faster, and rows of the left
 * factor, which come from memory, are used for all panels while they are in the first-level cache.
 */
void matmul(const float *left, long row_stride, long column_stride, const float *right, long right_stride, float *out,
            long out_stride, int rows, int depth, int columns) {
    vec packed[PACKED_PANELS][PACKED_DEPTH * PANEL_VECTORS];
    for (int x = 0, end; x < columns; x = end) {
        /* An overlapping panel is processed alone: panels that accumulate must not share columns. */
        int full = (columns - x) / PANEL_COLUMNS, count = full ? min(PACKED_PANELS, full) : 1, first[PACKED_PANELS];
        end = x + count * PANEL_COLUMNS;
        for (int i = 0; i < count; i++) first[i] = min(x + i * PANEL_COLUMNS, columns - PANEL_COLUMNS);
        for (int d = 0; d < depth; d += PACKED_DEPTH) {
            int packed_depth = min(PACKED_DEPTH, depth - d);
            for (int y = 0; y < packed_depth; y++)
                for (int i = 0; i < count; i++) {
                    const float *source = right + (d + y) * right_stride + first[i];
                    UNROLL for (int j = 0; j < PANEL_VECTORS; j++)
                        packed[i][y * PANEL_VECTORS + j] = *(const unaligned_vec *)(source + j * LANES);
                }
            const float *factor = left + d * column_stride;
            int m = 0;
            for (; m + 6 <= rows; m += 6)
                for (int i = 0; i < count; i++)
                    multiply_panel_6(factor + m * row_stride, row_stride, column_stride, packed[i],
                                     out + m * out_stride + first[i], out_stride, packed_depth, d > 0);
            for (; m < rows; m++)
                for (int i = 0; i < count; i++)
                    multiply_panel_1(factor + m * row_stride, row_stride, column_stride, packed[i],
                                     out + m * out_stride + first[i], out_stride, packed_depth, d > 0);
        }
    }
}
