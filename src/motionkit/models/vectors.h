/* Vectors of the network's kernels: the heads of an attention layer side by side. GCC and Clang. */

#include <stdint.h>

#define HEADS 8

#define INLINE static inline __attribute__((always_inline))

/* FASTEST(name, (parameters), (arguments)) is a function that does what the inline function name_inline does. On x86-64
   it is compiled for three instruction sets, and the widest that the processor has is called. Compilers do this by
   themselves with target_clones, but not on every system, and Zig's library always takes the narrowest. */
#if defined(__x86_64__)
#include <cpuid.h>

static int x86_level = 1; /* of x86-64-v1, -v3 and -v4 */

/* Whether the processor has all of some features, and the system keeps the registers they need. */
__attribute__((constructor)) static void find_x86_level(void) {
    uint32_t a, b, c, d, kept, upper;
    const uint32_t v3_first = bit_FMA | bit_MOVBE | bit_OSXSAVE | bit_AVX | bit_F16C;
    const uint32_t v3_seventh = bit_BMI | bit_AVX2 | bit_BMI2;
    const uint32_t v4_seventh = bit_AVX512F | bit_AVX512DQ | bit_AVX512CD | bit_AVX512BW | bit_AVX512VL;
    if (!__get_cpuid(1, &a, &b, &c, &d) || (c & v3_first) != v3_first) return;
    if (!__get_cpuid(0x80000001, &a, &b, &c, &d) || !(c & bit_LZCNT)) return;
    if (!__get_cpuid_count(7, 0, &a, &b, &c, &d) || (b & v3_seventh) != v3_seventh) return;
    __asm__("xgetbv" : "=a"(kept), "=d"(upper) : "c"(0));
    if ((kept & 0x06) != 0x06) return;
    x86_level = (b & v4_seventh) == v4_seventh && (kept & 0xe6) == 0xe6 ? 4 : 3;
}

/* By name, since Zig overrules target("arch=x86-64-v3"). */
#define X86_V3 "avx,avx2,bmi,bmi2,f16c,fma,lzcnt,movbe"
#define X86_V4 X86_V3 ",avx512f,avx512dq,avx512cd,avx512bw,avx512vl"

#define FASTEST(name, parameters, arguments)                                                   \
    __attribute__((target(X86_V4))) static void name##_v4 parameters { name##_inline arguments; } \
    __attribute__((target(X86_V3))) static void name##_v3 parameters { name##_inline arguments; } \
    static void name##_v1 parameters { name##_inline arguments; }                              \
    static void name parameters {                                                              \
        if (x86_level == 4) name##_v4 arguments;                                               \
        else if (x86_level == 3) name##_v3 arguments;                                          \
        else name##_v1 arguments;                                                              \
    }
#else
#define FASTEST(name, parameters, arguments) \
    static void name parameters { name##_inline arguments; }
#endif

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
