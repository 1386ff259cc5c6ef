/* What frame_kernel.c, foot_kernel.c and frame_kernel.py share. Rows of all arrays are characters. */

#include <stdint.h>

#include "kernel_math.h"

#define JOINTS 23

/* How a frame is drawn from the network's Gaussians and taken in. */
typedef struct {
    int64_t features, contacts, yaw, xz; /* counts, and columns of the root's velocities */
    int64_t sixd;                        /* columns of the root's rotation, if it is two matrix columns, else -1 */
    int64_t gaussian_stride, logit_stride;
    int64_t feet[4]; /* columns of the foot joints' positions */
    double floor, reaches[4], shares[4], ease, stiffness, enough, limit; /* of slip_correction.py */
    const float *mean, *log_sigma, *logits;
    const float *scaling_mean, *scaling_std; /* (features,) */
    const float *fresh;                      /* (B, features) standard normal; NULL takes the mean */
    float *noise, *smooth;                   /* (B, features), follow themselves and each other */
    const float *blended;                      /* (features,) how much of the velocity_blend each takes */
    const float *velocity_blend, *slip_correction;             /* (B,) */
    float *before;                           /* (B, features) the frame before, normalised */
    float rho, fresh_share, smoothing, noise_share, temperature, fps;
    float *x;            /* (B, features) the frame, normalised */
    float *seen;         /* (B, contacts) probabilities */
    float *denormalised; /* (B, features) */
    float *ground;       /* (B, 3) root x, z, heading */
} Draw;

/* The feet of all characters, and the numbers of motion/leg_ik.py. */
typedef struct {
    int64_t hip[2], knee[2], ankle[2], toe[2];
    float contact_on, contact_off, ease_frames, brake_frames, max_slide, max_wait, step_frames, step_height, max_reach, hip_return, max_drop, least_change;
    float standing, slack, lowest, swing, fast, rise, fall, max_pitch;
    float unsure, sure, ankle_share, ease, enough, limit, pace;
    float bent, thigh_share, alike, straightening, backwards, steep;
    float usual_roll, most_roll; /* of motion/ankles.py */
    const float *hold;                         /* (B,) */
    float *carry;                              /* (B, 2) x, z */
    float *slip;                               /* (B, 2) x, z, of the last frame */
    float *feet;                               /* (B, 4, 3) of the frame before */
    uint8_t *moving;                           /* (B,) */
    uint8_t *locked;                           /* (B, 2) */
    float *age;                                /* (B, 2) */
    float *step;                               /* (B, 2) */
    float *anchor, *shift, *released, *before; /* (B, 2, 2) x, z */
    uint8_t *stands;                           /* (B, 2) */
    float *lift;                               /* (B, 2) */
    float *drop;                               /* (B,) */
} Feet;

/* The soles of characters' meshes, and the numbers of finish/soles.py. Parts are left foot, left toes, right foot, right
   toes. */
typedef struct {
    int64_t most;                        /* points of a part */
    float near, fade, tip, pace;
    const float *points;                 /* (B, 4, most, 3) relative to the toe, or to the ankle if toes have none */
    const int64_t *counts;               /* (B, 4) points of each part; a foot without any is none */
    const float *floor;                  /* (B,) height of the floor */
    float *rise;                         /* (B, 2) of the ankle */
    float *bend;                         /* (B, 2) of the toes */
    float *drop;                         /* (B,) of the hips */
} Soles;

/* How far all characters are raised, and the numbers of height_correction.py. */
typedef struct {
    int64_t joints[4], columns[4]; /* of the foot joints, and of their heights */
    float standing[4], reach, pace, doubt, deepest, lift;
    float *rise; /* (B,) */
} HeightCorrection;

/* From a frame to a body: rotations, joints, root-height correction and held feet. */
typedef struct {
    int64_t features, root, joints, height, sixd; /* columns */
    int64_t parents[JOINTS];
    HeightCorrection height_correction;
    const float *references;                    /* (22, 4, 4) */
    const float *offsets;                       /* (B, 23, 3) */
    const float *scale;                         /* (B,) */
    const float *frame, *contacts, *ground;     /* (B, features), (B, 4), (B, 3) */
    float *rotations, *root_places, *positions; /* (B, 23, 4), (B, 3), (B, 23, 3) */
    const Feet *feet;                           /* NULL: not locked */
    const Soles *soles;
} Pose;

/* Rolls feet back that are rolled over, as ankles_in_range of motion/ankles.py. */
void roll_back(const Feet *feet, const Vec3 *offsets, Quat *rotations);

/* Locks the feet of character row, whose world rotations are given; changes rotations and positions. */
void lock_feet(const Feet *feet, int64_t row, const float *contacts, float scale, const Mat3 *world, Quat *rotations,
               Vec3 *positions);

/* Puts the soles of character row on the floor, after lock_feet; world rotations are those of its rotations. */
void plant_soles(const Soles *soles, const Feet *feet, int64_t row, const Vec3 *offsets, const Mat3 *world, Quat *rotations,
                 Vec3 *positions);
