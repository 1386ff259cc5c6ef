/* Vectors of the network's kernels: the heads of an attention layer side by side. GCC and Clang. */

#include <stdint.h>

#define HEADS 8

/* Compiled once more for wide vectors; the fitting one is chosen when the library is loaded. */
#if defined(__x86_64__) && defined(__linux__) && defined(__GNUC__) && !defined(__clang__)
#define FASTEST __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")))
#else
#define FASTEST
#endif
#define INLINE static inline __attribute__((always_inline))

typedef float heads_vec __attribute__((vector_size(4 * HEADS), aligned(4), may_alias));
typedef int32_t heads_ints __attribute__((vector_size(4 * HEADS)));

INLINE heads_vec larger(heads_vec a, heads_vec b) {
    const heads_ints first = a > b;
    return (heads_vec)(((heads_ints)a & first) | ((heads_ints)b & ~first));
}

/* exp of x <= 0 in every lane, within a few units of the last place; nothing to speak of below -80. */
INLINE heads_vec exp_negative(heads_vec x) {
    const heads_vec y = larger(x, (heads_vec){0} - 80.0f) * 1.44269504f;
    const heads_ints whole = __builtin_convertvector(y - 0.5f, heads_ints);
    const heads_vec f = (y - __builtin_convertvector(whole, heads_vec)) * 0.693147181f;
    const heads_vec series = 1.0f + f * (1.0f + f * (0.5f + f * (0.166666667f + f * (0.0416666667f +
                             f * (0.00833333333f + f * 0.00138888889f)))));
    return series * (heads_vec)((whole + 127) << 23);
}
