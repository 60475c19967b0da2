/* Convolutions of the image encoder and decoder, with their gradients, for LANES images at a time.
 *
 * Values are (channel, row, column, image): the images of a group are the lanes of a vector, so that every loop below is
 * an ordinary scalar convolution in which each number happens to be a vector. Weights are packed (input, ky, kx, output).
 * Plain C with GCC's vector extension: the compiler picks the instructions of the machine it runs on.
 */
#include <stdint.h>
#include <string.h>

#ifdef __AVX512F__
#define LANES 16
#else
#define LANES 8
#endif

typedef float vec __attribute__((vector_size(4 * LANES)));
typedef uint8_t byte_vec __attribute__((vector_size(LANES)));
typedef int32_t mask __attribute__((vector_size(4 * LANES)));

#define INLINE static inline __attribute__((always_inline))
#define UNROLL _Pragma("GCC unroll 16")

int lanes(void) { return LANES; }

/* NaN passes, so that a network that has diverged shows it. */
INLINE vec positive(vec value, vec where) { return (vec)((mask)value & ~(mask)(where <= 0.0f)); }

/* relu: keep what is positive; gate: keep where gate is positive (the gradient of relu). */
INLINE vec finish(vec value, int relu, const vec *gate, long index) {
    if (relu) return positive(value, value);
    return gate ? positive(value, gate[index]) : value;
}

#define STRIDED(N, P)                                                                                                  \
    INLINE void strided_##N##_##P(const vec *in, int C, int H, int W, vec *out, int O, int OH, int OW, int k, int s,    \
                                  const float *w, const float *bias, int relu, const vec *gate, int o, int y, int x) { \
        vec acc[P][N];                                                                                                 \
        UNROLL for (int p = 0; p < P; p++) UNROLL for (int n = 0; n < N; n++) acc[p][n] = (vec){0} + (bias ? bias[o + n] : 0.0f); \
        for (int c = 0; c < C; c++)                                                                                    \
            for (int ky = 0; ky < k; ky++) {                                                                           \
                const vec *row = in + ((long)c * H + y * s + ky) * W + x * s;                                          \
                const float *weight = w + (long)(c * k + ky) * k * O + o;                                              \
                for (int kx = 0; kx < k; kx++, weight += O)                                                            \
                    UNROLL for (int p = 0; p < P; p++) {                                                               \
                        vec value = row[kx + p * s];                                                                   \
                        UNROLL for (int n = 0; n < N; n++) acc[p][n] += value * weight[n];                             \
                    }                                                                                                  \
            }                                                                                                          \
        UNROLL for (int n = 0; n < N; n++) UNROLL for (int p = 0; p < P; p++) {                                        \
            long index = ((long)(o + n) * OH + y) * OW + x + p;                                                        \
            out[index] = finish(acc[p][n], relu, gate, index);                                                         \
        }                                                                                                              \
    }

STRIDED(5, 4)
STRIDED(5, 1)
STRIDED(3, 4)
STRIDED(3, 1)
STRIDED(1, 1)

#define ARGUMENTS in, C, H, W, out, O, OH, OW, k, s, w, bias, relu, gate, o, y

#define ROW(KIND, N, P)                                                                                                \
    {                                                                                                                  \
        int x = 0;                                                                                                     \
        for (; x + P <= OW; x += P) KIND##_##N##_##P(ARGUMENTS, x);                                                    \
        for (; x < OW; x++) KIND##_##N##_1(ARGUMENTS, x);                                                              \
        o += N;                                                                                                        \
    }

static void strided_rows(const vec *in, int C, int H, int W, vec *out, int O, int OH, int OW, int k, int s,
                         const float *w, const float *bias, int relu, const vec *gate, int from, int to) {
    for (int y = from; y < to; y++)
        for (int o = 0; o < O;) {
            if (O - o >= 5) ROW(strided, 5, 4)
            else if (O - o >= 3) ROW(strided, 3, 4)
            else ROW(strided, 1, 1)
        }
}

/* Convolution of stride s, kernel k x k, no padding: in (C, H, W) -> out (O, OH, OW). */
void strided(const vec *in, int C, int H, int W, vec *out, int O, int OH, int OW, int k, int s, const float *w,
             const float *bias, int relu, const vec *gate) {
    strided_rows(in, C, H, W, out, O, OH, OW, k, s, w, bias, relu, gate, 0, OH);
}

/* P outputs of one phase: columns x, x + s, ... are reached from columns x/s - t, with kernel column x%s + s t. */
#define SPREAD(N, P)                                                                                                   \
    INLINE void spread_##N##_##P(const vec *in, int C, int H, int W, vec *out, int O, int OH, int OW, int k, int s,     \
                                 const float *w, const float *bias, int relu, const vec *gate, int o, int y, int x) {  \
        vec acc[P][N];                                                                                                 \
        UNROLL for (int p = 0; p < P; p++) UNROLL for (int n = 0; n < N; n++) acc[p][n] = (vec){0} + (bias ? bias[o + n] : 0.0f); \
        int column = x / s;                                                                                            \
        for (int ky = y % s, iy = y / s; ky < k && iy >= 0; ky += s, iy--) {                                           \
            if (iy >= H) continue;                                                                                     \
            for (int kx = x % s, ix = column; kx < k && ix >= 0; kx += s, ix--) {                                      \
                if (P == 1 && ix >= W) continue;                                                                       \
                const vec *value = in + (long)iy * W + ix;                                                             \
                const float *weight = w + (long)(ky * k + kx) * O + o;                                                 \
                for (int c = 0; c < C; c++, value += (long)H * W, weight += (long)k * k * O)                           \
                    UNROLL for (int p = 0; p < P; p++)                                                                 \
                        UNROLL for (int n = 0; n < N; n++) acc[p][n] += value[p] * weight[n];                          \
            }                                                                                                          \
        }                                                                                                              \
        UNROLL for (int n = 0; n < N; n++) UNROLL for (int p = 0; p < P; p++) {                                        \
            long index = ((long)(o + n) * OH + y) * OW + x + p * s;                                                    \
            out[index] = finish(acc[p][n], relu, gate, index);                                                         \
        }                                                                                                              \
    }

SPREAD(5, 4)
SPREAD(5, 1)
SPREAD(3, 4)
SPREAD(3, 1)
SPREAD(1, 1)

/* Tiles only where all P columns of all taps lie inside the input. */
#define PHASES(N, P)                                                                                                   \
    {                                                                                                                  \
        for (int phase = 0; phase < s; phase++) {                                                                      \
            int taps = (k - phase + s - 1) / s, x = phase;                                                             \
            while (x < OW) {                                                                                           \
                int first = x / s;                                                                                     \
                if (P > 1 && first >= taps - 1 && first + P <= W && x + (P - 1) * s < OW) {                            \
                    spread_##N##_##P(ARGUMENTS, x);                                                                    \
                    x += P * s;                                                                                        \
                } else {                                                                                               \
                    spread_##N##_1(ARGUMENTS, x);                                                                      \
                    x += s;                                                                                            \
                }                                                                                                      \
            }                                                                                                          \
        }                                                                                                              \
        o += N;                                                                                                        \
    }

static void transposed_rows(const vec *in, int C, int H, int W, vec *out, int O, int OH, int OW, int k, int s,
                            const float *w, const float *bias, int relu, const vec *gate, int from, int to) {
    for (int y = from; y < to; y++)
        for (int o = 0; o < O;) {
            if (O - o >= 5) PHASES(5, 4)
            else if (O - o >= 3) PHASES(3, 4)
            else PHASES(1, 1)
        }
}

/* Transposed convolution of stride s, kernel k x k: in (C, H, W) -> out (O, OH, OW). */
void transposed(const vec *in, int C, int H, int W, vec *out, int O, int OH, int OW, int k, int s, const float *w,
                const float *bias, int relu, const vec *gate) {
    transposed_rows(in, C, H, W, out, O, OH, OW, k, s, w, bias, relu, gate, 0, OH);
}

#define ROWS 4

#define CORRELATE(N, K)                                                                                                \
    INLINE void correlate_##N##_##K(const vec *small, int h, int w, const vec *large, int W, int s, int rows,          \
                                    vec *out, long step) {                                                             \
        vec acc[N][K];                                                                                                 \
        UNROLL for (int n = 0; n < N; n++) UNROLL for (int i = 0; i < K; i++) acc[n][i] = out[n * step + i];           \
        for (int y = 0; y < rows; y++)                                                                                 \
            for (int x = 0; x < w; x++) {                                                                              \
                const vec *right = large + (long)y * s * W + x * s, *left = small + (long)y * w + x;                   \
                UNROLL for (int n = 0; n < N; n++) {                                                                   \
                    vec value = left[(long)n * h * w];                                                                 \
                    UNROLL for (int i = 0; i < K; i++) acc[n][i] += value * right[i];                                  \
                }                                                                                                      \
            }                                                                                                          \
        UNROLL for (int n = 0; n < N; n++) UNROLL for (int i = 0; i < K; i++) out[n * step + i] = acc[n][i];           \
    }

CORRELATE(5, 5)
CORRELATE(5, 3)
CORRELATE(5, 1)
CORRELATE(1, 5)
CORRELATE(1, 3)
CORRELATE(1, 1)

#define TAPS(N)                                                                                                        \
    for (int kx = 0; kx < k;) {                                                                                        \
        vec *target = sums + (((long)a * B + b) * k + ky) * k + kx;                                                    \
        const vec *left = small + ((long)a * h + y) * w, *right = large + ((long)b * H + y * s + ky) * W + kx;         \
        if (k - kx >= 5) correlate_##N##_5(left, h, w, right, W, s, rows, target, step), kx += 5;                   \
        else if (k - kx >= 3) correlate_##N##_3(left, h, w, right, W, s, rows, target, step), kx += 3;              \
        else correlate_##N##_1(left, h, w, right, W, s, rows, target, step), kx += 1;                               \
    }

static void correlate_rows(const vec *small, int A, int h, int w, const vec *large, int B, int H, int W, int k, int s,
                           vec *sums, int from, int to) {
    long step = (long)B * k * k;
    for (int y = from; y < to; y += ROWS) {
        int rows = to - y < ROWS ? to - y : ROWS;
        for (int a = 0; a < A;) {
            int wide = A - a >= 5;
            for (int b = 0; b < B; b++)
                for (int ky = 0; ky < k; ky++) {
                    if (wide) TAPS(5)
                    else TAPS(1)
                }
            a += wide ? 5 : 1;
        }
    }
}

static void add_lanes(const vec *sums, long count, float *out) {
    for (long i = 0; i < count; i++) {
        out[i] = 0.0f;
        for (int lane = 0; lane < LANES; lane++) out[i] += sums[i][lane];
    }
}

/* Gradient of a kernel: out[a][b][ky][kx] = sum small[a][y][x] large[b][y s + ky][x s + kx]. sums: as many vectors. */
void correlate(const vec *small, int A, int h, int w, const vec *large, int B, int H, int W, int k, int s, vec *sums,
               float *out) {
    long count = (long)A * B * k * k;
    memset(sums, 0, sizeof(vec) * count);
    correlate_rows(small, A, h, w, large, B, H, W, k, s, sums, 0, h);
    add_lanes(sums, count, out);
}

/* out[c] = sum over rows, columns and images. */
void channel_sums(const vec *in, int C, int H, int W, float *out) {
    for (int c = 0; c < C; c++) {
        double total = 0.0;
        for (int y = 0; y < H; y++) {
            vec sum = {0};
            for (int x = 0; x < W; x++) sum += in[((long)c * H + y) * W + x];
            for (int lane = 0; lane < LANES; lane++) total += sum[lane];
        }
        out[c] = (float)total;
    }
}

/* Row y of images (count, H, row) of bytes, as row vectors; zero beyond count. bytes: room for as many. */
INLINE void read_row(const uint8_t *images, int count, int H, int y, int row, uint8_t *bytes) {
    memset(bytes, 0, (long)row * LANES);
    for (int lane = 0; lane < count; lane++) {
        const uint8_t *line = images + ((long)lane * H + y) * row;
        for (int i = 0; i < row; i++) bytes[(long)i * LANES + lane] = line[i];
    }
}

INLINE vec pixel(const uint8_t *bytes, long index) {
    byte_vec value;
    memcpy(&value, bytes + index * LANES, LANES);
    return __builtin_convertvector(value, vec) * (1.0f / 255.0f);
}

/* Images (count, H, W, C) of bytes -> out (C, H, W) in [0, 1]; zero beyond count. bytes: W * C * LANES. */
void pack(const uint8_t *images, int count, int H, int W, int C, vec *out, uint8_t *bytes) {
    for (int y = 0; y < H; y++) {
        read_row(images, count, H, y, W * C, bytes);
        for (int c = 0; c < C; c++)
            for (int x = 0; x < W; x++) out[((long)c * H + y) * W + x] = pixel(bytes, x * C + c);
    }
}

/* In place of rows of values (C, H, W): (values - images) times scale. Adds up squared differences and slopes. */
static void residual_rows(vec *values, const uint8_t *images, int count, int H, int W, int C, vec scale, double *errors,
                          double *slopes, uint8_t *bytes, int from, int to) {
    for (int y = from; y < to; y++) {
        read_row(images, count, H, y, W * C, bytes);
        vec squares = {0};
        for (int c = 0; c < C; c++) {
            vec sum = {0};
            for (int x = 0; x < W; x++) {
                vec *value = values + ((long)c * H + y) * W + x;
                vec difference = *value - pixel(bytes, x * C + c);
                squares += difference * difference;
                *value = difference * scale;
                sum += *value;
            }
            for (int lane = 0; lane < LANES; lane++) slopes[c] += sum[lane];
        }
        for (int lane = 0; lane < LANES; lane++) errors[lane] += squares[lane];
    }
}

#define STRIP 8
#define MAX_CHANNELS 16

/* The decoder's last layer and back: in (C, h, w) -> image (O, H, W), compared with images (count, H, W, O) of bytes.
 *
 * Leaves in errors[lane] the sum of squared differences, and of sum scale[lane] errors[lane] / 2 the gradients: of the
 * weight (C, O, k, k), of the bias (O), and of in, zero where gate is not positive. In strips of rows, so that the image
 * and its slopes need not leave the cache. sums: C * O * k * k vectors; bytes: W * O * LANES.
 */
void reconstruct(const vec *in, int C, int h, int w, vec *image, int O, int H, int W, int k, int s, const float *widening,
                 const float *narrowing, const float *bias, const vec *gate, const uint8_t *images, int count,
                 const float *scale, float *errors, float *weight_slope, float *bias_slope, vec *in_slope, vec *sums,
                 uint8_t *bytes) {
    double squares[LANES] = {0}, slopes[MAX_CHANNELS] = {0};
    long weights = (long)C * O * k * k;
    vec factor;
    memcpy(&factor, scale, sizeof(vec));
    memset(sums, 0, sizeof(vec) * weights);
    for (int from = 0, done = 0; from < h; from += STRIP) {
        int to = from + STRIP < h ? from + STRIP : h;
        int reach = to < h ? (to - 1) * s + k : H;
        transposed_rows(in, C, h, w, image, O, H, W, k, s, widening, bias, 0, 0, done, reach);
        residual_rows(image, images, count, H, W, O, factor, squares, slopes, bytes, done, reach);
        done = reach;
        correlate_rows(in, C, h, w, image, O, H, W, k, s, sums, from, to);
        strided_rows(image, O, H, W, in_slope, C, h, w, k, s, narrowing, 0, 0, gate, from, to);
    }
    add_lanes(sums, weights, weight_slope);
    for (int c = 0; c < O; c++) bias_slope[c] = (float)slopes[c];
    for (int lane = 0; lane < LANES; lane++) errors[lane] = (float)squares[lane];
}
