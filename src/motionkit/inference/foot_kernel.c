/* Feet held still, one character at a time: FootLock of foot_lock.py, where each step is explained. */

#include "frame_kernel.h"

typedef struct {
    Vec3 hip, knee, ankle, toe, target;
    float thigh, shin;
} Leg;

/* Raises a toe that is too low for its way along the ground in this frame. */
static float raised(const Feet *f, float lift, float height, float way, float scale) {
    const float clear = f->clearance * way, most = f->max_clearance * scale;
    float missing = f->toe_height * scale + (clear < most ? clear : most) - height;
    missing = missing > 0.0f ? missing : 0.0f;
    lift += (missing > lift ? f->lift_rise : f->lift_fall) * (missing - lift);
    return lift > f->least_drop ? lift : 0.0f;
}

/* How far a foot has to move, and what it remembers. */
static Vec3 foot_shift(const Feet *f, int64_t foot, Vec3 toe, float level, float scale) {
    float *anchor = f->anchor + 2 * foot, *shift = f->shift + 2 * foot, *released = f->released + 2 * foot;
    float *before = f->before + 2 * foot, *age = f->age + foot;
    const float place[2] = {toe.x, toe.z};
    const float dx = anchor[0] - place[0], dz = anchor[1] - place[1];
    const int first = *age < 0.0f, locked = f->locked[foot];
    const int slid = locked && sqrtf(dx * dx + dz * dz) > f->max_slide * scale;
    const int eased = *age >= f->ease || (released[0] == 0.0f && released[1] == 0.0f);
    const int caught = !locked && level > f->contact_on && eased;
    const int let_go = locked && (level < f->contact_off || slid);
    *age = caught || let_go ? 0.0f : *age + 1.0f;
    f->locked[foot] = (locked || caught) && !let_go;
    /* A caught toe goes on with what is left of its speed while it is braked. */
    const float speed = clip(1.0f - *age / f->brake, 0.0f, 1.0f), rest = clip(1.0f - (*age + 1.0f) / f->ease, 0.0f, 1.0f);
    float way[2];
    for (int i = 0; i < 2; i++) {
        const float shown = before[i] + shift[i];
        anchor[i] = caught ? place[i] + shift[i] : anchor[i] + speed * (place[i] - before[i]);
        if (let_go) released[i] = shift[i];
        shift[i] = f->locked[foot] ? anchor[i] - place[i] : released[i] * (rest * rest * (3.0f - 2.0f * rest));
        way[i] = first ? 0.0f : place[i] + shift[i] - shown;
        before[i] = place[i];
    }
    float *lift = f->lift + foot;
    *lift = raised(f, *lift, toe.y, sqrtf(way[0] * way[0] + way[1] * way[1]), scale);
    return (Vec3){shift[0], *lift, shift[1]};
}

/* How far the hips have to come down for a leg. A leg that was straight before stays so. */
static float needed_drop(const Feet *f, const Leg *leg, float scale) {
    const Vec3 reach = minus(leg->target, leg->hip);
    const float straight = f->max_reach * (leg->thigh + leg->shin), now = length(minus(leg->ankle, leg->hip));
    const float allowed = straight > now ? straight : now;
    const float below = allowed * allowed - (reach.x * reach.x + reach.z * reach.z);
    return clip(-reach.y - sqrtf(below > 0.0f ? below : 0.0f), 0.0f, f->max_drop * scale);
}

/* The angle between sides a and b of a triangle. */
static float interior_angle(float a, float b, float opposite) {
    return acosf(clip((a * a + b * b - opposite * opposite) / (2.0f * a * b), -1.0f, 1.0f));
}

/* The axis about which a knee bends; a straight leg has no plane, its knee bends about the thigh's own side. */
static Vec3 knee_axis(const Leg *leg, const Mat3 *thigh_frame) {
    const Vec3 down = minus(leg->ankle, leg->knee);
    Vec3 axis = cross(minus(leg->hip, leg->knee), down);
    if (length(axis) < 1e-2f * leg->thigh * leg->shin) {
        const Vec3 along = times(1.0f / leg->shin, down);
        axis = matrix_vector(thigh_frame, (Vec3){-1.0f, 0.0f, 0.0f});
        axis = minus(axis, times(dot(axis, along), along));
    }
    const float size = length(axis);
    return times(1.0f / (size > 1e-9f ? size : 1e-9f), axis);
}

/* The smallest rotation that turns source onto target, which are never opposite here. */
static Quat between(Vec3 source, Vec3 target) {
    const Vec3 axis = cross(source, target);
    const float w = length(source) * length(target) + dot(source, target);
    const float size = sqrtf(w * w + dot(axis, axis)), share = 1.0f / (size > 1e-9f ? size : 1e-9f);
    return (Quat){share * w, share * axis.x, share * axis.y, share * axis.z};
}

/* A world rotation as seen from a frame. */
static Quat inside(const Mat3 *frame, Quat q) {
    const Vec3 axis = transposed_vector(frame, (Vec3){q.x, q.y, q.z});
    return (Quat){q.w, axis.x, axis.y, axis.z};
}

/* How far a knee opens for its ankle to come as far from the hip as the target is. */
static Quat opened_knee(const Feet *f, const Leg *leg, const Mat3 *thigh_frame) {
    const float shortest = fabsf(leg->thigh - leg->shin) + 0.5f, longest = (leg->thigh + leg->shin) * f->max_reach;
    const float now = length(minus(leg->ankle, leg->hip));
    float then = length(minus(leg->target, leg->hip));
    then = then < shortest ? shortest : then;
    then = then > longest ? longest : then;
    float opening = interior_angle(leg->thigh, leg->shin, then) - interior_angle(leg->thigh, leg->shin, now);
    /* A leg that is longer than max_reach and stays where it is must not be bent by the limit. */
    if (length(minus(leg->target, leg->ankle)) < 1e-3f) opening = 0.0f;
    const Vec3 axis = times(sinf(0.5f * opening), knee_axis(leg, thigh_frame));
    return (Quat){cosf(0.5f * opening), axis.x, axis.y, axis.z};
}

/* Turn thigh and shin so that the ankle comes to its target; the foot keeps its orientation. */
static void bend(const Feet *f, int side, const Leg *leg, const Mat3 *world, Quat *rotations, Vec3 *positions) {
    const int64_t hip = f->hip[side], knee = f->knee[side], ankle = f->ankle[side];
    const Quat opened = opened_knee(f, leg, &world[hip]);
    const Vec3 bent = minus(plus(leg->knee, turned(opened, minus(leg->ankle, leg->knee))), leg->hip);
    const Quat swing = between(bent, minus(leg->target, leg->hip));
    rotations[hip] = quat_product(inside(&world[0], swing), rotations[hip]);
    rotations[knee] = quat_product(inside(&world[hip], opened), rotations[knee]);
    rotations[ankle] =
        quat_product(inside(&world[knee], inverse(quat_product(swing, opened))), rotations[ankle]);
    const Vec3 moved = plus(turned(swing, bent), leg->hip);
    positions[knee] = plus(leg->hip, turned(swing, minus(leg->knee, leg->hip)));
    positions[ankle] = moved;
    positions[f->toe[side]] = minus(plus(leg->toe, moved), leg->ankle);
}

void lock_feet(const Feet *f, int64_t row, const float *contacts, float scale, const Mat3 *world, Quat *rotations,
               Vec3 *positions) {
    Leg legs[2];
    float *drop = f->drop + row, need = 0.0f;
    int still = *drop <= f->least_drop;
    for (int side = 0; side < 2; side++) {
        const float foot = contacts[2 * side], toe = contacts[2 * side + 1];
        Leg *leg = legs + side;
        *leg = (Leg){positions[f->hip[side]], positions[f->knee[side]], positions[f->ankle[side]], positions[f->toe[side]],
                     {0}, 0, 0};
        const Vec3 shift = foot_shift(f, 2 * row + side, leg->toe, foot > toe ? foot : toe, scale);
        leg->target = plus(leg->ankle, shift);
        leg->thigh = length(minus(leg->knee, leg->hip)), leg->shin = length(minus(leg->ankle, leg->knee));
        if (shift.x != 0.0f || shift.y != 0.0f || shift.z != 0.0f) still = 0;
        const float needed = needed_drop(f, leg, scale);
        need = needed > need ? needed : need;
    }
    if (still) {
        *drop = 0.0f;
        return;
    }
    *drop = need > f->hip_return * *drop ? need : f->hip_return * *drop;
    for (int64_t j = 0; j < JOINTS; j++) positions[j].y -= *drop;
    for (int side = 0; side < 2; side++) {
        Leg *leg = legs + side;
        leg->hip.y -= *drop, leg->knee.y -= *drop, leg->ankle.y -= *drop, leg->toe.y -= *drop;
        bend(f, side, leg, world, rotations, positions);
    }
}
