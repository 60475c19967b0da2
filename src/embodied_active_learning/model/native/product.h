/* Products of matrices. */
#pragma once

#include "sides.h"

#define PANEL 4                /* vectors of columns that are worked off together */
#define WIDTH_OF_PANEL (PANEL * LANES)
#define PANELS 2               /* of the right factor that are packed at once */
#define DEPTH 512              /* rows of it that stay in the second cache meanwhile */

#define PRODUCT(N)                                                                                                     \
    INLINE void product_##N(const float *left, long across, long along, const vec *right, float *out, long out_pitch,   \
                            int depth, int add) {                                                                      \
        vec sum[N][PANEL];                                                                                             \
        UNROLL for (int n = 0; n < N; n++) UNROLL for (int i = 0; i < PANEL; i++)                                      \
            __builtin_prefetch(out + n * out_pitch + i * LANES, 1);                                                    \
        UNROLL for (int n = 0; n < N; n++) UNROLL for (int i = 0; i < PANEL; i++)                                      \
            sum[n][i] = add ? *(const loose_vec *)(out + n * out_pitch + i * LANES) : (vec){0};                        \
        for (int d = 0; d < depth; d++, left += along, right += PANEL)                                                 \
            UNROLL for (int n = 0; n < N; n++) UNROLL for (int i = 0; i < PANEL; i++)                                  \
                sum[n][i] += left[n * across] * right[i];                                                              \
        UNROLL for (int n = 0; n < N; n++) UNROLL for (int i = 0; i < PANEL; i++)                                      \
            *(loose_vec *)(out + n * out_pitch + i * LANES) = sum[n][i];                                               \
    }

PRODUCT(6)
PRODUCT(1)

int panel(void) { return WIDTH_OF_PANEL; }

/* out (rows, columns) = left (rows, depth) right (depth, columns).
 *
 * left[m * across + d * along]; rows of right and out lie pitch and out_pitch apart. columns: at least panel(). The last
 * panel ends with the last column and may overlap the one before. Panels of the right factor are packed, two at once:
 * longer pieces of its rows are read from memory sooner.
 */
void multiply(const float *left, long across, long along, const float *right, long pitch, float *out, long out_pitch,
              int rows, int depth, int columns) {
    vec packed[PANELS][DEPTH * PANEL];
    for (int x = 0, end; x < columns; x = end) {
        /* A panel that overlaps another one comes alone: until its end, each adds to what it has. */
        int full = (columns - x) / WIDTH_OF_PANEL, count = full ? least(PANELS, full) : 1, begin[PANELS];
        end = x + count * WIDTH_OF_PANEL;
        for (int i = 0; i < count; i++) begin[i] = least(x + i * WIDTH_OF_PANEL, columns - WIDTH_OF_PANEL);
        for (int d = 0; d < depth; d += DEPTH) {
            int deep = least(DEPTH, depth - d);
            for (int row = 0; row < deep; row++)
                for (int i = 0; i < count; i++) {
                    const float *from = right + (d + row) * pitch + begin[i];
                    UNROLL for (int j = 0; j < PANEL; j++)
                        packed[i][row * PANEL + j] = *(const loose_vec *)(from + j * LANES);
                }
            for (int i = 0; i < count; i++) {
                int m = 0;
                for (; m + 6 <= rows; m += 6)
                    product_6(left + m * across + d * along, across, along, packed[i], out + m * out_pitch + begin[i],
                              out_pitch, deep, d > 0);
                for (; m < rows; m++)
                    product_1(left + m * across + d * along, across, along, packed[i], out + m * out_pitch + begin[i],
                              out_pitch, deep, d > 0);
            }
        }
    }
}
