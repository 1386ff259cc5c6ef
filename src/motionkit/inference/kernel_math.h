/* Vectors, quaternions (w, x, y, z) and 3 x 3 matrices. */

#include <math.h>

typedef struct { float x, y, z; } Vec3;
typedef struct { float w, x, y, z; } Quat;
typedef struct { float at[3][3]; } Mat3;

static inline float clip(float value, float low, float high) {
    return value < low ? low : value > high ? high : value;
}

static inline Vec3 plus(Vec3 a, Vec3 b) { return (Vec3){a.x + b.x, a.y + b.y, a.z + b.z}; }
static inline Vec3 minus(Vec3 a, Vec3 b) { return (Vec3){a.x - b.x, a.y - b.y, a.z - b.z}; }
static inline Vec3 times(float s, Vec3 a) { return (Vec3){s * a.x, s * a.y, s * a.z}; }
static inline float dot(Vec3 a, Vec3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
static inline float length(Vec3 a) { return sqrtf(dot(a, a)); }

static inline Vec3 cross(Vec3 a, Vec3 b) {
    return (Vec3){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

/* The product p q: rotates by q first. */
static inline Quat quat_product(Quat p, Quat q) {
    return (Quat){p.w * q.w - p.x * q.x - p.y * q.y - p.z * q.z, p.w * q.x + p.x * q.w + p.y * q.z - p.z * q.y,
                  p.w * q.y - p.x * q.z + p.y * q.w + p.z * q.x, p.w * q.z + p.x * q.y - p.y * q.x + p.z * q.w};
}

static inline Quat inverse(Quat q) { return (Quat){q.w, -q.x, -q.y, -q.z}; }

/* A vector turned by a unit quaternion. */
static inline Vec3 turned(Quat q, Vec3 v) {
    const Vec3 axis = {q.x, q.y, q.z}, twice = times(2.0f, cross(axis, v));
    return plus(plus(v, times(q.w, twice)), cross(axis, twice));
}

static inline Mat3 quat_to_matrix(Quat q) {
    const float ww = q.w * q.w, xx = q.x * q.x, yy = q.y * q.y, zz = q.z * q.z;
    const float xy = q.x * q.y, xz = q.x * q.z, yz = q.y * q.z, wx = q.w * q.x, wy = q.w * q.y, wz = q.w * q.z;
    return (Mat3){{{ww + xx - yy - zz, 2 * (xy - wz), 2 * (xz + wy)},
                   {2 * (xy + wz), ww - xx + yy - zz, 2 * (yz - wx)},
                   {2 * (xz - wy), 2 * (yz + wx), ww - xx - yy + zz}}};
}

static inline Vec3 matrix_vector(const Mat3 *m, Vec3 v) {
    return (Vec3){m->at[0][0] * v.x + m->at[0][1] * v.y + m->at[0][2] * v.z,
                  m->at[1][0] * v.x + m->at[1][1] * v.y + m->at[1][2] * v.z,
                  m->at[2][0] * v.x + m->at[2][1] * v.y + m->at[2][2] * v.z};
}

static inline Vec3 transposed_vector(const Mat3 *m, Vec3 v) {
    return (Vec3){m->at[0][0] * v.x + m->at[1][0] * v.y + m->at[2][0] * v.z,
                  m->at[0][1] * v.x + m->at[1][1] * v.y + m->at[2][1] * v.z,
                  m->at[0][2] * v.x + m->at[1][2] * v.y + m->at[2][2] * v.z};
}

static inline Mat3 matrix_product(const Mat3 *a, const Mat3 *b) {
    Mat3 out;
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++)
            out.at[i][k] = a->at[i][0] * b->at[0][k] + a->at[i][1] * b->at[1][k] + a->at[i][2] * b->at[2][k];
    return out;
}
