/* Peak rate of multiply-adds: independent chains in registers, no memory access. */
#ifdef __AVX512F__
#define LANES 16
#else
#define LANES 8
#endif
#define CHAINS 12

typedef float vec __attribute__((vector_size(4 * LANES)));

static volatile float seen;

/* Run `count` rounds and return the number of floating-point operations. */
double multiply_and_add(int count) {
    vec chain[CHAINS], factor = (vec){0} + 0.9999f, increment = (vec){0} + 1e-9f;
    for (int i = 0; i < CHAINS; i++) chain[i] = factor * (float)(i + 1);
    for (int n = 0; n < count; n++)
        _Pragma("GCC unroll 12") for (int i = 0; i < CHAINS; i++) chain[i] = chain[i] * factor + increment;
    vec total = {0};
    for (int i = 0; i < CHAINS; i++) total += chain[i];
    seen = total[0];
    return 2.0 * LANES * CHAINS * (double)count;
}
