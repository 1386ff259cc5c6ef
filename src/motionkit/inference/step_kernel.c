/* One frame of the network for some characters, by the weights of step_weights.py; step_arrays.py has the arrays.

   Plain C with the vector extensions of GCC and Clang; no Python header, it is called through ctypes.
   Nearly all time goes into bringing the weights from the cache to the core, so they lie in the order
   in which they are read: tiles of 32 outputs, all inputs of a tile one after another. Rows of every
   buffer are padded to whole tiles. */

#include <math.h>
#include <stdint.h>
#include <string.h>

#include "../models/vectors.h"

#define LANES 16
#define TILE (2 * LANES)
#define MOST_PLACES 32 /* in a ring */
#define MOST (1 << 20) /* of any size in a program */
#define AHEAD 2048 /* bytes of weights that are asked for before they are needed */
#define BLOCK 8 /* characters that share one pass over a tile */
#define TILES_OF_ROW 2 /* that one character passes over at once */
#define PADDED(n) (((n) + TILE - 1) / TILE * TILE)

typedef float vec __attribute__((vector_size(4 * LANES), aligned(4), may_alias));
typedef int32_t ints __attribute__((vector_size(4 * LANES), aligned(4), may_alias));

/* Raised with every change of a struct, of the order of the weights or of a sum; step_kernel.py refuses other libraries. */
int64_t step_kernel_version(void) { return 4; }

/* A linear map: tiles of (inputs, TILE), bias and scale padded to whole tiles. */
typedef struct {
    const void *tiles;
    const float *scale; /* per output, of 16-bit tiles; NULL: tiles are float */
    const float *bias;  /* NULL: the product is added to what is there */
    int64_t inputs, outputs;
} Map;

typedef struct {
    int64_t parts, layers, width, hidden, heads, window, kernel, part_inputs, controls, control_width;
    int64_t control_blocks, contact_hidden, features, contacts;
    float head_leak, log_sigma_min, log_sigma_max, eps;
    const Map *maps;        /* in the order in which step() uses them */
    const int64_t *columns; /* (P, N) */
} Program;

/* State and frame of all characters; rows are characters. */
typedef struct {
    float *recent;         /* (B, K, features + contacts + 1) inputs, the newest last */
    float *keys, *values;  /* (B, 2, P, L, W, D) rings; channels of all heads beside each other */
    const int64_t *filled; /* (B,) frames seen, this one included */
    const float *controls; /* (B, C) */
    const float *position; /* (2, P, L, W, H) bias of the places in the rings at this slot */
    float *out;            /* (B, padded) mean, log sigma, scratch */
    float *contact_logits; /* (B, TILE), the first of them count */
    int64_t slot;          /* place in the rings of this frame */
} Frame;

/* The 32 weights of one input. In 16 bits, a lane of 32 holds one weight of either half: the low half comes
   by a shift, the high half as it stands, with the low bits below its last place (see StepKernel). */
INLINE void weights_at(const int small, const void *tiles, int64_t place, vec *low, vec *high) {
    __builtin_prefetch((const char *)tiles + place * (small ? 2 : 4) + AHEAD);
    if (small) {
        const ints both = *(const ints *)((const int16_t *)tiles + place);
        *low = __builtin_convertvector(both << 16, vec);
        *high = __builtin_convertvector(both, vec);
    } else {
        *low = *(const vec *)((const float *)tiles + place);
        *high = *(const vec *)((const float *)tiles + place + LANES);
    }
}

INLINE void store(const int small, const Map *map, int64_t first, vec low, vec high, float *y) {
    const float *base = map->bias ? map->bias + first : y;
    if (small) {
        low *= *(const vec *)(map->scale + first);
        high *= *(const vec *)(map->scale + first + LANES);
    }
    low += *(const vec *)base;
    high += *(const vec *)(base + LANES);
    *(vec *)y = low;
    *(vec *)(y + LANES) = high;
}

INLINE void tile_block(const int small, const Map *map, int64_t first, const float *x, int64_t ldx, float *y, int64_t ldy) {
    vec low[BLOCK] = {{0}}, high[BLOCK] = {{0}};
    int64_t place = first * map->inputs;
    for (int64_t k = 0; k < map->inputs; k++, place += TILE) {
        vec a, b;
        weights_at(small, map->tiles, place, &a, &b);
#pragma GCC unroll 8
        for (int r = 0; r < BLOCK; r++) {
            low[r] += x[r * ldx + k] * a;
            high[r] += x[r * ldx + k] * b;
        }
    }
#pragma GCC unroll 8
    for (int r = 0; r < BLOCK; r++) store(small, map, first, low[r], high[r], y + r * ldy + first);
}

/* One row, a few tiles at once, so that sums do not wait for each other. Each output is summed as tile_block sums it:
   a row's numbers do not depend on the rows beside it. */
INLINE void tiles_row(const int small, const int count, const Map *map, int64_t first, const float *x, float *y) {
    vec low[TILES_OF_ROW] = {{0}}, high[TILES_OF_ROW] = {{0}};
    const int64_t inputs = map->inputs, next = inputs * TILE;
    int64_t place = first * inputs;
    for (int64_t k = 0; k < inputs; k++, place += TILE) {
#pragma GCC unroll 8
        for (int t = 0; t < count; t++) {
            vec a, b;
            weights_at(small, map->tiles, place + t * next, &a, &b);
            low[t] += x[k] * a;
            high[t] += x[k] * b;
        }
    }
#pragma GCC unroll 8
    for (int t = 0; t < count; t++) store(small, map, first + t * TILE, low[t], high[t], y + first + t * TILE);
}

INLINE void product_of(const int small, const Map *map, int64_t rows, const float *x, int64_t ldx, float *y, int64_t ldy) {
    const int64_t blocks = rows / BLOCK * BLOCK;
    if (blocks)
        for (int64_t first = 0; first < map->outputs; first += TILE)
            for (int64_t r = 0; r < blocks; r += BLOCK) tile_block(small, map, first, x + r * ldx, ldx, y + r * ldy, ldy);
    int64_t first = 0;
    for (; blocks < rows && first + (TILES_OF_ROW - 1) * TILE < map->outputs; first += TILES_OF_ROW * TILE)
        for (int64_t r = blocks; r < rows; r++) tiles_row(small, TILES_OF_ROW, map, first, x + r * ldx, y + r * ldy);
    for (; blocks < rows && first < map->outputs; first += TILE)
        for (int64_t r = blocks; r < rows; r++) tiles_row(small, 1, map, first, x + r * ldx, y + r * ldy);
}

/* Rows y = x W + bias, or y += x W for a map without bias. */
INLINE void product_inline(const Map *map, int64_t rows, const float *x, int64_t ldx, float *y, int64_t ldy) {
    if (map->scale)
        product_of(1, map, rows, x, ldx, y, ldy);
    else
        product_of(0, map, rows, x, ldx, y, ldy);
}

FASTEST(product,
        (const Map *map, int64_t rows, const float *x, int64_t ldx, float *y, int64_t ldy),
        (map, rows, x, ldx, y, ldy))

/* Layer norm of a row without a mean, and without sqrt(D). */
INLINE void norm_inline(const float *restrict x, float *restrict y, int64_t width, float eps) {
    float sum = 0;
#pragma omp simd reduction(+ : sum)
    for (int64_t d = 0; d < width; d++) sum += x[d] * x[d];
    const float scale = 1.0f / sqrtf(sum + width * eps);
    for (int64_t d = 0; d < width; d++) y[d] = scale * x[d];
}

FASTEST(norm, (const float *restrict x, float *restrict y, int64_t width, float eps), (x, y, width, eps))

/* The numbers of up to HEADS heads side by side. */
INLINE heads_vec heads_at(const float *from, const int64_t count) {
    if (count == HEADS) return *(const heads_vec *)from;
    heads_vec out = {0};
    for (int64_t h = 0; h < count; h++) out[h] = from[h];
    return out;
}

/* Attention of one character, part and layer over its ring, for a few of H heads. Channels run (E, H): all sums
   go down, heads side by side. MotionIndex before the first frame are not allowed. */
INLINE void attend_heads(const int64_t count, int64_t H, int64_t E, int64_t W, const float *q, const float *keys,
                         const float *values, const float *position, const int64_t *allowed, float *mixed) {
    heads_vec shares[MOST_PLACES], top = (heads_vec){0} - 1e30f, total = {0};
    for (int64_t w = 0; w < W; w++) {
        if (!allowed[w]) continue;
        /* Two sums, so that they do not wait for each other. */
        heads_vec even = heads_at(position + w * H, count), odd = {0};
        const float *key = keys + w * E * H;
        int64_t e = 0;
        for (; e + 1 < E; e += 2) {
            even += heads_at(q + e * H, count) * heads_at(key + e * H, count);
            odd += heads_at(q + (e + 1) * H, count) * heads_at(key + (e + 1) * H, count);
        }
        if (e < E) even += heads_at(q + e * H, count) * heads_at(key + e * H, count);
        shares[w] = even + odd;
        top = larger(top, shares[w]);
    }
    for (int64_t w = 0; w < W; w++) {
        shares[w] = allowed[w] ? exp_negative(shares[w] - top) : (heads_vec){0};
        total += shares[w];
    }
    for (int64_t w = 0; w < W; w++) shares[w] /= total;
    for (int64_t e = 0; e < E; e++) {
        heads_vec sum = {0};
        for (int64_t w = 0; w < W; w++) sum += shares[w] * heads_at(values + (w * E + e) * H, count);
        for (int64_t h = 0; h < count; h++) mixed[e * H + h] = sum[h];
    }
}

INLINE void attend_inline(int64_t H, int64_t E, int64_t W, const float *q, const float *keys, const float *values,
                   const float *position, const int64_t *allowed, float *mixed) {
    int64_t h = 0;
    for (; h + HEADS <= H; h += HEADS)
        attend_heads(HEADS, H, E, W, q + h, keys + h, values + h, position + h, allowed, mixed + h);
    if (h < H) attend_heads(H - h, H, E, W, q + h, keys + h, values + h, position + h, allowed, mixed + h);
}

FASTEST(attend,
        (int64_t H, int64_t E, int64_t W, const float *q, const float *keys, const float *values, const float *position, const int64_t *allowed, float *mixed),
        (H, E, W, q, keys, values, position, allowed, mixed))

/* Whether a program is one that step() can run: the stack holds so many places, vectors whole heads. */
static int fits(const Program *p) {
    const int64_t sizes[] = {p->parts, p->layers, p->width, p->hidden, p->heads, p->window, p->kernel, p->part_inputs,
                             p->controls, p->control_width, p->control_blocks, p->contact_hidden, p->features,
                             p->contacts};
    for (int i = 0; i < (int)(sizeof sizes / sizeof *sizes); i++)
        if (sizes[i] < 1 || sizes[i] > MOST) return 0;
    return p->window <= MOST_PLACES && p->width % p->heads == 0 && p->control_blocks <= p->layers &&
           p->contacts <= TILE;
}

/* Floats of scratch that step() needs for so many rows; -1 for a program that it cannot run. */
int64_t scratch_size(const Program *p, int64_t rows) {
    if (!fits(p)) return -1;
    const int64_t D = PADDED(p->width);
    return rows * (p->kernel * p->part_inputs + PADDED(p->control_width) + PADDED(p->control_blocks * p->width) +
                   3 * D + PADDED(3 * p->width) + PADDED(p->hidden) + 2 * p->parts * p->width +
                   PADDED(p->contact_hidden));
}

/* The next frame of characters first to first + rows. Answers 0, or 1 for a program or slot that does not fit. */
int64_t step(const Program *p, const Frame *f, int64_t first, int64_t rows, float *scratch) {
    if (!fits(p) || f->slot < 0 || f->slot >= p->window) return 1;
    const int64_t D = p->width, P = p->parts, L = p->layers, W = p->window, N = p->part_inputs, C = p->control_blocks;
    const int64_t KN = p->kernel * N, PD = P * D, ring = 2 * P * L * W * D, PH = p->contact_hidden;
    const int64_t row_inputs = p->features + p->contacts + 1;
    /* Distances from row to row. */
    const int64_t ex = PADDED(D), eq = PADDED(3 * D), eh = PADDED(p->hidden), ec = PADDED(p->control_width);
    const int64_t ea = PADDED(C * D), ef = PADDED(PH), eo = PADDED(2 * p->features + PH);
    float *inputs = scratch, *embedded = inputs + rows * KN, *added = embedded + rows * ec;
    float *x = added + rows * ea, *y = x + rows * ex, *mixed = y + rows * ex, *qkv = mixed + rows * ex;
    float *hidden = qkv + rows * eq, *features = hidden + rows * eh, *before = features + rows * PD;
    float *feet = before + rows * PD;
    const Map *map = p->maps;
    for (int64_t module = 0; module < 2; module++) {
        for (int64_t part = 0; part < P; part++) {
            if (module == 0)
                for (int64_t r = 0; r < rows; r++)
                    for (int64_t k = 0; k < p->kernel; k++) {
                        const float *row = f->recent + ((first + r) * p->kernel + k) * row_inputs;
                        for (int64_t n = 0; n < N; n++) inputs[r * KN + k * N + n] = row[p->columns[part * N + n]];
                    }
            product(map++, rows, module ? before : inputs, module ? PD : KN, x, ex);
            product(map++, rows, f->controls + first * p->controls, p->controls, embedded, ec);
            memset(added, 0, rows * ea * sizeof(float));
            product(map++, rows, embedded, ec, added, ea);
            for (int64_t layer = 0; layer < L; layer++) {
                const int64_t index = (module * P + part) * L + layer;
                if (layer < C)
                    for (int64_t r = 0; r < rows; r++)
                        for (int64_t d = 0; d < D; d++) x[r * ex + d] += added[r * ea + layer * D + d];
                for (int64_t r = 0; r < rows; r++) norm(x + r * ex, y + r * ex, D, p->eps);
                product(map++, rows, y, ex, qkv, eq);
                for (int64_t r = 0; r < rows; r++) {
                    float *keys = f->keys + (first + r) * ring + index * W * D;
                    float *values = f->values + (first + r) * ring + index * W * D;
                    int64_t allowed[MOST_PLACES];
                    memcpy(keys + f->slot * D, qkv + r * eq + D, D * sizeof(float));
                    memcpy(values + f->slot * D, qkv + r * eq + 2 * D, D * sizeof(float));
                    for (int64_t w = 0; w < W; w++) allowed[w] = (f->slot - w + W) % W < f->filled[first + r];
                    attend(p->heads, D / p->heads, W, qkv + r * eq, keys, values,
                           f->position + index * W * p->heads, allowed, mixed + r * ex);
                }
                product(map++, rows, mixed, ex, x, ex);
                for (int64_t r = 0; r < rows; r++) norm(x + r * ex, y + r * ex, D, p->eps);
                product(map++, rows, y, ex, hidden, eh);
                for (int64_t i = 0; i < rows * eh; i++) hidden[i] = hidden[i] > 0 ? hidden[i] : 0;
                product(map++, rows, hidden, eh, x, ex);
            }
            for (int64_t r = 0; r < rows; r++) norm(x + r * ex, features + r * PD + part * D, D, p->eps);
        }
        float *swap = before;
        before = features;
        features = swap;
    }
    /* Now before holds the deep features and features the shallow ones. */
    float *out = f->out + first * eo;
    product(map++, rows, before, PD, out, eo);
    for (int64_t r = 0; r < rows; r++) {
        memset(feet + r * ef, 0, ef * sizeof(float));
        memcpy(feet + r * ef, out + r * eo + 2 * p->features, PH * sizeof(float));
    }
    product(map++, rows, features, PD, feet, ef);
    for (int64_t i = 0; i < rows * ef; i++) feet[i] = feet[i] > 0 ? feet[i] : 0;
    product(map++, rows, feet, ef, f->contact_logits + first * TILE, TILE);
    for (int64_t r = 0; r < rows; r++) {
        const float *now = f->recent + ((first + r) * p->kernel + p->kernel - 1) * row_inputs;
        float *mean = out + r * eo, *sigma = mean + p->features;
        for (int64_t n = 0; n < p->features; n++) {
            mean[n] += p->head_leak * now[n];
            sigma[n] = sigma[n] < p->log_sigma_min ? p->log_sigma_min : sigma[n];
            sigma[n] = sigma[n] > p->log_sigma_max ? p->log_sigma_max : sigma[n];
        }
    }
    return 0;
}
