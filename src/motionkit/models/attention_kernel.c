/* Attention of each frame over a short window, and its gradients: the loops behind models/attention.py.

   Plain C with the vector extensions of GCC and Clang; no Python header, it is called through ctypes.
   Eight heads lie side by side, so all sums go down and nothing is transposed, padded or masked. A sequence is one
   part of one window: T frames of E channels of the eight heads. Queries, keys and values come without their bias,
   as float or as bfloat16; all sums are in float. */

#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "vectors.h"

#define MOST_PLACES 64 /* of a window */
#define USUAL 16 /* channels of a head, for which loops are unrolled */

typedef uint16_t halves __attribute__((vector_size(2 * HEADS), aligned(2), may_alias));
typedef uint32_t words __attribute__((vector_size(4 * HEADS)));

/* Raised with every change of an argument or of an order; attention_kernel.py refuses other libraries. */
int64_t attention_kernel_version(void) { return 1; }

/* What forward and backward take. Arrays are contiguous; rows of 3 E vectors are queries, keys, values. */
typedef struct {
    int64_t parts, batch, frames, channels, window;
    int64_t bfloat16;      /* whether qkv, out and their gradients are */
    float scale;           /* of the scores */
    const void *qkv;       /* (P, B, T, 3, E, H) without bias */
    const float *bias;     /* (P, 3, E, H) */
    const float *position; /* (P, W, H) added to the scores by distance in frames */
    float *shares;         /* (P, B, T, W, H) of the values, unset before the first frame: forward writes, backward reads */
    void *out;             /* (P, B, T, E, H) written by forward; the gradient of it for backward */
    void *qkv_gradient;    /* (P, B, T, 3, E, H) */
    float *bias_gradient;  /* (P, B, 3, E, H), to be summed over B */
    float *position_gradient; /* (P, B, W, H), to be summed over B */
} Attention;

INLINE heads_vec load(const int bfloat16, const void *from, int64_t place) {
    if (!bfloat16) return ((const heads_vec *)from)[place];
    const words high = __builtin_convertvector(((const halves *)from)[place], words) << 16;
    return (heads_vec)high;
}

/* To the nearest bfloat16, ties to even; infinities stay, and so do NaNs that torch makes. */
INLINE void save(const int bfloat16, void *to, int64_t place, heads_vec value) {
    if (bfloat16) {
        const words bits = (words)value;
        ((halves *)to)[place] = __builtin_convertvector((bits + 0x7fff + ((bits >> 16) & 1)) >> 16, halves);
    } else
        ((heads_vec *)to)[place] = value;
}

/* Queries (scaled), keys and values of a sequence as float, with their bias. */
INLINE void unpack(const int bfloat16, const Attention *a, int64_t part, const char *qkv, heads_vec *rows) {
    const int64_t E = a->channels;
    const heads_vec *bias = (const heads_vec *)a->bias + part * 3 * E;
    for (int64_t t = 0; t < a->frames; t++) {
        for (int64_t e = 0; e < E; e++) rows[e] = (load(bfloat16, qkv, t * 3 * E + e) + bias[e]) * a->scale;
        for (int64_t e = E; e < 3 * E; e++) rows[e] = load(bfloat16, qkv, t * 3 * E + e) + bias[e];
        rows += 3 * E;
    }
}

INLINE heads_vec product(const heads_vec *x, const heads_vec *y, int64_t E) {
    heads_vec even = {0}, odd = {0}; /* two sums, so that they do not wait for each other */
    int64_t e = 0;
    for (; e + 1 < E; e += 2) {
        even += x[e] * y[e];
        odd += x[e + 1] * y[e + 1];
    }
    if (e < E) even += x[e] * y[e];
    return even + odd;
}

INLINE void forward_of(const int bfloat16, const int64_t E, const Attention *a, int64_t sequence, heads_vec *rows) {
    const int64_t T = a->frames, W = a->window, part = sequence / a->batch;
    const int64_t size = bfloat16 ? 2 : 4, whole = T * E * HEADS * size;
    const heads_vec *position = (const heads_vec *)a->position + part * W;
    heads_vec *shares = (heads_vec *)a->shares + sequence * T * W;
    char *out = (char *)a->out + sequence * whole;
    unpack(bfloat16, a, part, (const char *)a->qkv + 3 * sequence * whole, rows);
    for (int64_t t = 0; t < T; t++, shares += W) {
        const heads_vec *now = rows + t * 3 * E, *values = now + 2 * E;
        const int64_t reach = t + 1 < W ? t + 1 : W;
        heads_vec top = (heads_vec){0} - 1e30f, total = {0};
        for (int64_t w = 0; w < reach; w++) {
            shares[w] = position[w] + product(now, now + E - w * 3 * E, E);
            top = larger(top, shares[w]);
        }
        for (int64_t w = 0; w < reach; w++) {
            shares[w] = exp_negative(shares[w] - top);
            total += shares[w];
        }
        total = 1.0f / total;
        for (int64_t w = 0; w < reach; w++) shares[w] *= total;
        for (int64_t e = 0; e < E; e++) {
            heads_vec sum = {0};
            for (int64_t w = 0; w < reach; w++) sum += shares[w] * values[e - w * 3 * E];
            save(bfloat16, out, t * E + e, sum);
        }
    }
}

INLINE void backward_of(const int bfloat16, const int64_t E, const Attention *a, int64_t sequence, heads_vec *rows) {
    const int64_t T = a->frames, W = a->window, part = sequence / a->batch;
    const int64_t size = bfloat16 ? 2 : 4, whole = T * E * HEADS * size;
    heads_vec *gradients = rows + T * 3 * E, *given = gradients + T * 3 * E;
    heads_vec *position = (heads_vec *)a->position_gradient + sequence * W;
    heads_vec *bias = (heads_vec *)a->bias_gradient + sequence * 3 * E;
    const heads_vec *shares = (const heads_vec *)a->shares + sequence * T * W;
    const char *out = (const char *)a->out + sequence * whole;
    char *qkv = (char *)a->qkv_gradient + 3 * sequence * whole;
    unpack(bfloat16, a, part, (const char *)a->qkv + 3 * sequence * whole, rows);
    memset(gradients, 0, T * 3 * E * sizeof(heads_vec));
    memset(position, 0, W * sizeof(heads_vec));
    memset(bias, 0, 3 * E * sizeof(heads_vec));
    for (int64_t t = 0; t < T; t++, shares += W) {
        const heads_vec *now = rows + t * 3 * E;
        heads_vec *query = gradients + t * 3 * E;
        const int64_t reach = t + 1 < W ? t + 1 : W;
        heads_vec of_score[MOST_PLACES], mean = {0};
        for (int64_t e = 0; e < E; e++) given[e] = load(bfloat16, out, t * E + e);
        for (int64_t w = 0; w < reach; w++) {
            of_score[w] = product(given, now + 2 * E - w * 3 * E, E);
            mean += shares[w] * of_score[w];
        }
        for (int64_t w = 0; w < reach; w++) {
            const heads_vec score = shares[w] * (of_score[w] - mean), share = shares[w];
            const heads_vec *key = now + E - w * 3 * E;
            heads_vec *to_key = query + E - w * 3 * E, *to_value = to_key + E;
            position[w] += score;
            for (int64_t e = 0; e < E; e++) {
                query[e] += score * key[e];
                to_key[e] += score * now[e];
                to_value[e] += share * given[e];
            }
        }
    }
    for (int64_t t = 0; t < T; t++)
        for (int64_t c = 0; c < 3 * E; c++) {
            const heads_vec value = gradients[t * 3 * E + c] * (c < E ? a->scale : 1.0f);
            bias[c] += value;
            save(bfloat16, qkv, t * 3 * E + c, value);
        }
}

INLINE void forward_one_inline(const Attention *a, int64_t sequence, heads_vec *rows) {
    if (a->bfloat16 && a->channels == USUAL)
        forward_of(1, USUAL, a, sequence, rows);
    else if (a->bfloat16)
        forward_of(1, a->channels, a, sequence, rows);
    else
        forward_of(0, a->channels, a, sequence, rows);
}

FASTEST(forward_one, (const Attention *a, int64_t sequence, heads_vec *rows), (a, sequence, rows))

INLINE void backward_one_inline(const Attention *a, int64_t sequence, heads_vec *rows) {
    if (a->bfloat16 && a->channels == USUAL)
        backward_of(1, USUAL, a, sequence, rows);
    else if (a->bfloat16)
        backward_of(1, a->channels, a, sequence, rows);
    else
        backward_of(0, a->channels, a, sequence, rows);
}

FASTEST(backward_one, (const Attention *a, int64_t sequence, heads_vec *rows), (a, sequence, rows))

static int64_t run(const Attention *a, int64_t first, int64_t last, int back) {
    if (a->window < 1 || a->window > MOST_PLACES || first < 0 || last > a->parts * a->batch) return 1;
    const int64_t row = 3 * a->channels * HEADS * sizeof(float);
    heads_vec *scratch = malloc((back ? 2 * a->frames + 1 : a->frames) * row + 64);
    if (!scratch) return 2;
    for (int64_t sequence = first; sequence < last; sequence++) {
        if (back)
            backward_one(a, sequence, scratch);
        else
            forward_one(a, sequence, scratch);
    }
    free(scratch);
    return 0;
}

/* Sequences first to last. Answers 0; 1 for sizes that do not fit, 2 where memory is short. */
int64_t attention_forward(const Attention *a, int64_t first, int64_t last) { return run(a, first, last, 0); }

int64_t attention_backward(const Attention *a, int64_t first, int64_t last) { return run(a, first, last, 1); }
