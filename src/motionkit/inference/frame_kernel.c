/* A frame around the network's step for all characters: from the network's Gaussians to a frame (draw_frames), and from
   a frame to a body (pose_frames). frame_arrays.py and frame_kernel.py say what the arrays are.

   tests/oracle does the same in numpy. Operations come in the order in which numpy does them and are not fused;
   functions whose results go back into the network are taken in double precision, where both give the same digits.
   So both ways stay together for good. */

#include "frame_kernel.h"

/* Raised with every change of a struct or of what a function does; frame_kernel.py refuses other libraries. */
int64_t frame_kernel_version(void) { return 16; }

/* Exponential maps whose angle is below this are no rotation. */
#define SMALLEST 1e-12

/* Mean plus noise, of which each standard deviation takes its own; then the last movement goes on by a share. */
static void draw_pose(const Draw *d, int64_t row) {
    const float *mean = d->mean + row * d->gaussian_stride, *sigma = d->log_sigma + row * d->gaussian_stride;
    float *x = d->x + row * d->features, *out = d->denormalised + row * d->features;
    float *before = d->before + row * d->features, *noise = d->noise + row * d->features;
    float *smooth = d->smooth + row * d->features;
    const float velocity_blend = d->velocity_blend[row];
    if (d->fresh) {
        const float *fresh = d->fresh + row * d->features;
        for (int64_t n = 0; n < d->features; n++) noise[n] = noise[n] * d->rho + fresh[n] * d->fresh_share;
        for (int64_t n = 0; n < d->features; n++) smooth[n] = smooth[n] * d->smoothing + noise[n] * d->noise_share;
    }
    for (int64_t n = 0; n < d->features; n++) {
        const float drawn =
            d->fresh ? (float)exp(sigma[n]) * (smooth[n] * d->temperature) + mean[n] : mean[n];
        /* Where the last movement would go on to. */
        const float now = x[n], onwards = now + (now - before[n]);
        before[n] = now;
        x[n] = drawn + (onwards - drawn) * (velocity_blend * d->blended[n]);
        out[n] = x[n] * d->scaling_std[n] + d->scaling_mean[n];
    }
}

static void take_contacts(const Draw *d, int64_t row) {
    for (int64_t n = 0; n < d->contacts; n++)
        d->seen[row * d->contacts + n] = (float)(1.0 / (exp(-d->logits[row * d->logit_stride + n]) + 1.0));
}

/* What to add to the turn and the step of the root, so that feet on the ground stay there; see
   slip_correction.py.

   feet, before: the foot joints of a frame and of the one before, each in its heading frame, cm.
   turn: of the heading since then, radians; step: of the root along x and z of the later heading frame, cm. */
static void standing_move(const Draw *d, const float (*feet)[3], const float (*before)[3], double turn,
                          const double *step, double *out) {
    const double sine = sin(turn), cosine = cos(turn);
    double x[4], z[4], weight[4], low_sum = 0, sum = 0, mean_x = 0, mean_z = 0, arm_x = 0, arm_z = 0;
    for (int i = 0; i < 4; i++) {
        x[i] = feet[i][0] + step[0] - (cosine * before[i][0] - sine * before[i][2]);
        z[i] = feet[i][2] + step[1] - (cosine * before[i][2] + sine * before[i][0]);
        double high = (feet[i][1] - d->floor) / d->reaches[i];
        high = high < 0 ? 0 : high > 1 ? 1 : high;
        const double low = (1 - high) * d->shares[i];
        low_sum += low;
        weight[i] = low / (sqrt(x[i] * x[i] + z[i] * z[i]) + d->ease);
        sum += weight[i];
    }
    for (int i = 0; i < 4; i++) {
        weight[i] /= sum + 1e-9;
        mean_x += weight[i] * x[i], mean_z += weight[i] * z[i];
        arm_x += weight[i] * feet[i][2], arm_z += weight[i] * -feet[i][0];
    }
    double turned = 0, spread = 0;
    for (int i = 0; i < 4; i++) {
        const double about_x = feet[i][2] - arm_x, about_z = -feet[i][0] - arm_z;
        turned += weight[i] * ((x[i] - mean_x) * about_x + (z[i] - mean_z) * about_z);
        spread += weight[i] * (about_x * about_x + about_z * about_z);
    }
    const double angle = -turned / (spread + d->stiffness);
    const double back_x = -mean_x - angle * arm_x, back_z = -mean_z - angle * arm_z;
    double holds = low_sum / d->enough < 1 ? low_sum / d->enough : 1;
    holds /= 1 + sqrt(back_x * back_x + back_z * back_z) / d->limit;
    out[0] = holds * angle, out[1] = holds * back_x, out[2] = holds * back_z;
}

/* Takes out of the root's velocities, in part, what feet on the ground would slide. */
static void hold_ground(const Draw *d, int64_t row) {
    if (d->slip_correction[row] == 0) return;
    float *features = d->denormalised + row * d->features, *normalised = d->x + row * d->features;
    const float *before = d->before + row * d->features;
    float feet[4][3], feet_before[4][3];
    for (int i = 0; i < 4; i++)
        for (int k = 0; k < 3; k++) {
            const int64_t n = d->feet[i] + k;
            feet[i][k] = features[n];
            feet_before[i][k] = before[n] * d->scaling_std[n] + d->scaling_mean[n];
        }
    const float turn = features[d->yaw] / d->fps;
    const float x = features[d->xz] / d->fps, z = features[d->xz + 1] / d->fps;
    const double step[2] = {x, z};
    double move[3];
    standing_move(d, feet, feet_before, turn, step, move);
    const double share = (double)d->slip_correction[row] * (double)d->fps;
    const int64_t columns[3] = {d->yaw, d->xz, d->xz + 1};
    for (int k = 0; k < 3; k++) {
        const float by = (float)(move[k] * share);
        features[columns[k]] += by;
        normalised[columns[k]] += by / d->scaling_std[columns[k]];
    }
}

/* The root's predicted velocities add up to its place. */
static void move_root(const Draw *d, int64_t row) {
    const float *features = d->denormalised + row * d->features;
    float *ground = d->ground + 3 * row;
    ground[2] += features[d->yaw] / d->fps;
    const float sine = (float)sin(ground[2]), cosine = (float)cos(ground[2]);
    const float x = features[d->xz] / d->fps, z = features[d->xz + 1] / d->fps;
    ground[0] += cosine * x + sine * z;
    ground[1] += cosine * z - sine * x;
}

static double larger(double a, double b) { return a > b ? a : b; }

/* Two matrix columns made orthonormal (Gram-Schmidt). */
static void orthonormal(const float *sixd, double *a, double *b) {
    double along = 0;
    double size = larger(sqrt((double)sixd[0] * sixd[0] + (double)sixd[1] * sixd[1] + (double)sixd[2] * sixd[2]), 1e-8);
    for (int i = 0; i < 3; i++) a[i] = sixd[i] / size;
    for (int i = 0; i < 3; i++) along += a[i] * sixd[3 + i];
    for (int i = 0; i < 3; i++) b[i] = sixd[3 + i] - along * a[i];
    size = larger(sqrt(b[0] * b[0] + b[1] * b[1] + b[2] * b[2]), 1e-8);
    for (int i = 0; i < 3; i++) b[i] /= size;
}

/* The root's two matrix columns are made orthonormal before the network sees them, as all that it has learnt from are.
   Drawn frame by frame they shrink; where one goes through zero, the body turns over in a frame. */
static void keep_rotation(const Draw *d, int64_t row) {
    if (d->sixd < 0) return;
    float *x = d->x + row * d->features + d->sixd, *features = d->denormalised + row * d->features + d->sixd;
    const float *mean = d->scaling_mean + d->sixd, *std = d->scaling_std + d->sixd;
    double columns[6];
    orthonormal(features, columns, columns + 3);
    for (int i = 0; i < 6; i++) {
        features[i] = (float)columns[i];
        x[i] = (features[i] - mean[i]) / std[i];
    }
}

void draw_frames(const Draw *d, int64_t rows) {
    for (int64_t row = 0; row < rows; row++) {
        draw_pose(d, row);
        keep_rotation(d, row);
        take_contacts(d, row);
        hold_ground(d, row);
        move_root(d, row);
    }
}

/* The quaternion of a rotation matrix with columns a, b, c: of four forms of the same the one with the largest
   leading number, which is well-conditioned. */
static void quat_of_columns(const double *a, const double *b, const double *c, double *quat) {
    const double forms[4][4] = {
        {1 + a[0] + b[1] + c[2], b[2] - c[1], c[0] - a[2], a[1] - b[0]},
        {b[2] - c[1], 1 + a[0] - b[1] - c[2], b[0] + a[1], c[0] + a[2]},
        {c[0] - a[2], b[0] + a[1], 1 - a[0] + b[1] - c[2], c[1] + b[2]},
        {a[1] - b[0], c[0] + a[2], c[1] + b[2], 1 - a[0] - b[1] + c[2]},
    };
    int best = 0;
    for (int i = 1; i < 4; i++)
        if (forms[i][i] > forms[best][best]) best = i;
    double size = 0;
    for (int i = 0; i < 4; i++) size += forms[best][i] * forms[best][i];
    size = sqrt(size);
    for (int i = 0; i < 4; i++) quat[i] = forms[best][i] / size;
}

/* Two matrix columns, made orthonormal, as a quaternion. */
static void sixd_to_quat(const float *sixd, double *quat) {
    double a[3], b[3], c[3];
    orthonormal(sixd, a, b);
    for (int i = 0; i < 3; i++) c[i] = a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3];
    quat_of_columns(a, b, c, quat);
}

static void expmap_to_quat(const float *expmap, double *quat) {
    const double x = expmap[0], y = expmap[1], z = expmap[2];
    const double angle = larger(sqrt(x * x + y * y + z * z), SMALLEST), scale = sin(0.5 * angle) / angle;
    quat[0] = cos(0.5 * angle), quat[1] = scale * x, quat[2] = scale * y, quat[3] = scale * z;
}

/* The root's rotation: predicted in its heading frame, turned by the heading. */
static Quat root_rotation(const Pose *p, const float *features, double heading) {
    double q[4];
    (p->sixd ? sixd_to_quat : expmap_to_quat)(features + p->root, q);
    const double c = cos(0.5 * heading), s = sin(0.5 * heading);
    return (Quat){(float)(c * q[0] - s * q[2]), (float)(c * q[1] + s * q[3]), (float)(c * q[2] + s * q[0]),
                  (float)(c * q[3] - s * q[1])};
}

/* A joint's rotation: its exponential map after its reference, which comes as a matrix. */
static Quat joint_rotation(const float *expmap, const float *reference) {
    float half = 0.5f * sqrtf(expmap[0] * expmap[0] + expmap[1] * expmap[1] + expmap[2] * expmap[2]);
    if (half < (float)SMALLEST) half = (float)SMALLEST;
    const float share = sinf(half) / (2.0f * half);
    const float q[4] = {cosf(half), share * expmap[0], share * expmap[1], share * expmap[2]};
    float out[4] = {0};
    for (int i = 0; i < 4; i++)
        for (int k = 0; k < 4; k++) out[k] += q[i] * reference[4 * i + k];
    return (Quat){out[0], out[1], out[2], out[3]};
}

/* World rotations and positions of all joints. The root is added last, which keeps digits far from the origin. */
static void forward_kinematics(const Pose *p, const Quat *rotations, Vec3 root, const Vec3 *offsets, Mat3 *world,
                               Vec3 *positions) {
    world[0] = quat_to_matrix(rotations[0]);
    positions[0] = (Vec3){0, 0, 0};
    for (int64_t j = 1; j < JOINTS; j++) {
        const int64_t parent = p->parents[j];
        const Mat3 local = quat_to_matrix(rotations[j]);
        world[j] = matrix_product(&world[parent], &local);
        positions[j] = plus(positions[parent], matrix_vector(&world[parent], offsets[j]));
    }
    for (int64_t j = 0; j < JOINTS; j++) positions[j] = plus(positions[j], root);
}

/* Root-height correction: how far to raise a body whose rotations put its feet, at so many heights, lower than the
   frame says they are; see height_correction.py. */
static float rise(const HeightCorrection *f, float before, const float *features, const float *heights) {
    float said = INFINITY, shown = INFINITY;
    for (int i = 0; i < 4; i++) {
        said = fminf(said, features[f->columns[i]] - f->standing[i]);
        shown = fminf(shown, heights[i] - f->standing[i]);
    }
    said = fmaxf(said, -f->deepest);
    const float missing = said > shown ? said - shown : 0, low = 1 - clip(shown / f->reach, 0, 1);
    const float doubted = missing / f->doubt, pace = f->pace * low / (1 + doubted * doubted);
    const float risen = before + pace * (missing - before);
    return risen + f->lift * fmaxf(-f->deepest - shown - risen, 0);
}

static void raise_body(const HeightCorrection *f, int64_t row, const float *features, float scale, Vec3 *positions) {
    float heights[4];
    for (int i = 0; i < 4; i++) heights[i] = positions[f->joints[i]].y / scale;
    f->rise[row] = rise(f, f->rise[row], features, heights);
    for (int64_t j = 0; j < JOINTS; j++) positions[j].y += scale * f->rise[row];
}

/* The same for all frames of one character, whose joints are at heights (frames, 23). */
void rises(const HeightCorrection *f, int64_t frames, int64_t columns, const float *features, const float *heights,
           float *out) {
    for (int64_t t = 0; t < frames; t++) {
        float feet[4];
        for (int i = 0; i < 4; i++) feet[i] = heights[t * JOINTS + f->joints[i]];
        out[t] = rise(f, t ? out[t - 1] : *f->rise, features + t * columns, feet);
    }
}

void pose_frames(const Pose *p, int64_t rows) {
    for (int64_t row = 0; row < rows; row++) {
        const float *features = p->frame + row * p->features, *ground = p->ground + 3 * row, scale = p->scale[row];
        Quat *rotations = (Quat *)p->rotations + row * JOINTS;
        Vec3 *positions = (Vec3 *)p->positions + row * JOINTS;
        Mat3 world[JOINTS];
        rotations[0] = root_rotation(p, features, ground[2]);
        for (int64_t j = 1; j < JOINTS; j++)
            rotations[j] = joint_rotation(features + p->joints + 3 * (j - 1), p->references + 16 * (j - 1));
        const Vec3 root = {scale * ground[0], scale * features[p->height], scale * ground[1]};
        const Vec3 *offsets = (const Vec3 *)p->offsets + row * JOINTS;
        if (p->feet) roll_back(p->feet, offsets, rotations);
        forward_kinematics(p, rotations, root, offsets, world, positions);
        raise_body(&p->height_correction, row, features, scale, positions);
        if (p->feet) {
            lock_feet(p->feet, row, p->contacts + 4 * row, scale, world, rotations, positions);
            if (p->soles->counts[4 * row]) {
                forward_kinematics(p, rotations, positions[0], offsets, world, positions);
                plant_soles(p->soles, p->feet, row, offsets, world, rotations, positions);
            }
        }
        ((Vec3 *)p->root_places)[row] = positions[0];
    }
}
