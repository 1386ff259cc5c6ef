/* Feet held still, one character at a time; foot_lock.py has the state, motion/leg_ik.py the numbers, and move_feet for
   whole motions. */

#include "frame_kernel.h"

typedef struct {
    Vec3 hip, knee, ankle, toe, shift; /* shift of the ankle */
    Quat pitch;                        /* of the foot, in the world */
} Leg;

static float larger(float a, float b) { return a > b ? a : b; }
static float smaller(float a, float b) { return a < b ? a : b; }

/* Moves a toe towards the height of a standing one in contact, else up to where free ones go that step so far. */
static float lifted(const Feet *f, int64_t foot, float height, float step, float contact, float scale) {
    uint8_t *stands = f->stands + foot;
    float *lift = f->lift + foot;
    *stands = contact > f->contact_on || (*stands && contact >= f->contact_off);
    const float low = f->standing * scale - f->slack * scale, high = f->standing * scale + f->slack * scale;
    const float least = (f->lowest + (f->swing - f->lowest) * smaller(step / (f->fast * scale), 1.0f)) * scale;
    const float missing = *stands ? clip(height, low, high) - height : larger(least - height, 0.0f);
    *lift += (missing > *lift ? f->rise : f->fall) * (missing - *lift);
    if (fabsf(*lift) <= f->least_change) *lift = 0.0f;
    return *lift;
}

/* How far a toe has to move, and what its foot remembers. */
static Vec3 toe_shift(const Feet *f, int64_t foot, Vec3 toe, const float *contacts, float scale, int known) {
    float *anchor = f->anchor + 2 * foot, *shift = f->shift + 2 * foot, *released = f->released + 2 * foot;
    float *before = f->before + 2 * foot, *age = f->age + foot;
    const float place[2] = {toe.x, toe.z}, level = larger(contacts[0], contacts[1]);
    const float dx = anchor[0] - place[0], dz = anchor[1] - place[1];
    float *stepping = f->step + foot;
    const int locked = f->locked[foot];
    const int eased = *age >= (*stepping > 0.0f ? f->step_frames : f->ease_frames) || (released[0] == 0.0f && released[1] == 0.0f);
    const float far = sqrtf(dx * dx + dz * dz), limit = f->max_slide * scale;
    const int waits = f->step[foot ^ 1] > 0.0f && far <= f->max_wait * limit;
    const int slid = locked && far > limit && !waits;
    const int caught = !locked && level > f->contact_on && eased;
    const int let_go = locked && (level < f->contact_off || slid);
    if (caught || let_go || eased) *stepping = 0.0f;
    if (slid) *stepping = f->step_height * scale * smaller(sqrtf(shift[0] * shift[0] + shift[1] * shift[1]) / limit, 1.0f);
    *age = caught || let_go ? 0.0f : *age + 1.0f;
    f->locked[foot] = (locked || caught) && !let_go;
    /* A caught toe goes on with what is left of its speed while it is braked. */
    const float speed = clip(1.0f - *age / f->brake_frames, 0.0f, 1.0f);
    const float rest = clip(1.0f - (*age + 1.0f) / (*stepping > 0.0f ? f->step_frames : f->ease_frames), 0.0f, 1.0f);
    const float x = place[0] - before[0], z = place[1] - before[1], step = known ? sqrtf(x * x + z * z) : 0.0f;
    for (int i = 0; i < 2; i++) {
        anchor[i] = caught ? place[i] + shift[i] : anchor[i] + speed * (place[i] - before[i]);
        if (let_go) released[i] = shift[i];
        shift[i] = f->locked[foot] ? anchor[i] - place[i] : released[i] * (rest * rest * (3.0f - 2.0f * rest));
        before[i] = place[i];
    }
    const float wave = sinf(3.14159265f * rest);
    return (Vec3){shift[0], lifted(f, foot, toe.y, step, contacts[1], scale) + *stepping * wave, shift[1]};
}

/* Moves the root over the ground, so that feet in contact stay where they are: root_slip in motion/leg_ik.py. */
static void carry(const Feet *f, int64_t row, const float *contacts, float scale, Vec3 *positions) {
    float *before = f->feet + 12 * row, *carried = f->carry + 2 * row, *slip = f->slip + 2 * row;
    float mean_x = 0, mean_z = 0, sum = 0, held = 0;
    for (int i = 0; i < 4; i++) {
        const Vec3 foot = positions[i % 2 ? f->toe[i / 2] : f->ankle[i / 2]];
        const float x = foot.x - before[3 * i], z = foot.z - before[3 * i + 2];
        const float certain = clip((contacts[i] - f->unsure) / (f->sure - f->unsure), 0.0f, 1.0f);
        const float holds = (i % 2 ? 1.0f : f->ankle_share) * certain;
        const float weight = holds / (sqrtf(x * x + z * z) + f->ease * scale);
        mean_x += weight * x, mean_z += weight * z, sum += weight, held += holds;
        before[3 * i] = foot.x, before[3 * i + 1] = foot.y, before[3 * i + 2] = foot.z;
    }
    mean_x /= sum + 1e-9f, mean_z /= sum + 1e-9f;
    const float far = sqrtf(mean_x * mean_x + mean_z * mean_z) / (f->limit * scale);
    const float hold = f->moving[row] ? f->hold[row] : 0.0f;
    const float strength = hold * smaller(held / f->enough, 1.0f) / (1.0f + far * far);
    slip[0] += f->pace * (strength * mean_x - slip[0]), slip[1] += f->pace * (strength * mean_z - slip[1]);
    carried[0] -= slip[0], carried[1] -= slip[1];
    f->moving[row] = 1;
    for (int64_t j = 0; j < JOINTS; j++) positions[j].x += carried[0], positions[j].z += carried[1];
}

/* How far the hips have to come down for a leg. A leg that was straight before stays so. */
static float needed_drop(const Feet *f, const Leg *leg, float scale) {
    const Vec3 reach = minus(plus(leg->ankle, leg->shift), leg->hip);
    const float whole = length(minus(leg->knee, leg->hip)) + length(minus(leg->ankle, leg->knee));
    const float allowed = larger(f->max_reach * whole, length(minus(leg->ankle, leg->hip)));
    const float below = allowed * allowed - (reach.x * reach.x + reach.z * reach.z);
    return clip(-reach.y - sqrtf(larger(below, 0.0f)), 0.0f, f->max_drop * scale);
}

static Quat about(Vec3 axis, float angle) {
    const Vec3 half = times(sinf(0.5f * angle), axis);
    return (Quat){cosf(0.5f * angle), half.x, half.y, half.z};
}

/* The smallest rotation that turns source onto target, which are never opposite here. */
static Quat between(Vec3 source, Vec3 target) {
    const Vec3 axis = cross(source, target);
    const float w = length(source) * length(target) + dot(source, target);
    const float size = sqrtf(w * w + dot(axis, axis)), share = 1.0f / larger(size, 1e-9f);
    return (Quat){share * w, share * axis.x, share * axis.y, share * axis.z};
}

/* A world rotation as seen from a frame. */
static Quat inside(const Mat3 *frame, Quat q) {
    const Vec3 axis = transposed_vector(frame, (Vec3){q.x, q.y, q.z});
    return (Quat){q.w, axis.x, axis.y, axis.z};
}

/* Turns a foot so that its toe rises against its ankle, within limits. */
static Quat pitched(const Feet *f, Vec3 foot, float rise) {
    const float size = larger(length(foot), 1e-6f), flat = sqrtf(foot.x * foot.x + foot.z * foot.z);
    const float now = asinf(clip(foot.y / size, -1.0f, 1.0f)), then = asinf(clip((foot.y + rise) / size, -1.0f, 1.0f));
    const float angle = clip(then - now, -f->max_pitch, f->max_pitch) * clip(flat / (f->steep * size), 0.0f, 1.0f);
    return about(times(1.0f / larger(flat, 1e-6f), (Vec3){-foot.z, 0.0f, foot.x}), angle);
}

/* The axis about which a knee stretches: of the plane it is bent in; of a straight leg the thigh's own side. */
static Vec3 knee_axis(const Feet *f, Vec3 thigh, Vec3 shin, Vec3 side) {
    Vec3 axis = cross(times(1.0f / length(shin), shin), times(1.0f / length(thigh), thigh));
    axis = times(clip(dot(axis, side) / larger(length(axis), 1e-9f) / f->alike, -1.0f, 1.0f), axis);
    axis = plus(axis, times(f->thigh_share * clip(1.0f - length(axis) / f->bent, 0.0f, 1.0f), side));
    return times(1.0f / larger(length(axis), 1e-12f), axis);
}

/* How a shin turns for the leg to reach so far. */
static Quat opened_knee(const Feet *f, Vec3 thigh, Vec3 shin, Vec3 side, float wanted_reach) {
    const float thigh_length = length(thigh), shin_length = length(shin);
    const Vec3 axis = knee_axis(f, thigh, shin, side);
    const float longest = larger(f->max_reach * (thigh_length + shin_length), length(plus(thigh, shin)));
    const float reach = smaller(larger(wanted_reach, fabsf(thigh_length - shin_length) + 0.5f), longest);
    const float on_axis = dot(thigh, axis) * dot(shin, axis);
    const float b = dot(thigh, shin) - on_axis, c = dot(thigh, cross(axis, shin));
    const float along = thigh_length * thigh_length + shin_length * shin_length + 2.0f * on_axis;
    const float flexed = atan2f(c, b), size = larger(sqrtf(b * b + c * c), 1e-9f);
    const float wanted = acosf(clip((reach * reach - along) / (2.0f * size), -1.0f, 1.0f));
    const float eased = clip(flexed + f->straightening * (wanted + flexed), 0.0f, wanted);
    return about(axis, flexed - (flexed < 0.0f ? eased : wanted));
}

/* The thigh's own side in the world: _SIDE in motion/leg_ik.py. */
static Vec3 side_of(const Mat3 *thigh) { return matrix_vector(thigh, (Vec3){-1.0f, 0.0f, 0.0f}); }

static int bent_backwards(const Feet *f, const Leg *leg, const Mat3 *thigh_frame) {
    const Vec3 thigh = minus(leg->knee, leg->hip), shin = minus(leg->ankle, leg->knee);
    return dot(cross(shin, thigh), side_of(thigh_frame)) < -f->backwards * length(thigh) * length(shin);
}

/* Turn thigh, shin and foot so that the ankle moves by its shift. */
static void move_foot(const Feet *f, int side, const Leg *leg, const Mat3 *world, Quat *rotations, Vec3 *positions) {
    const int64_t hip = f->hip[side], knee = f->knee[side], ankle = f->ankle[side];
    const Vec3 foot = minus(leg->toe, leg->ankle), thigh = minus(leg->knee, leg->hip), shin = minus(leg->ankle, leg->knee);
    const Vec3 target = plus(leg->ankle, leg->shift);
    Quat swing = {1, 0, 0, 0}, opened = {1, 0, 0, 0};
    if (length(minus(target, leg->ankle)) >= 1e-3f || bent_backwards(f, leg, &world[hip])) {
        const Vec3 to_target = minus(target, leg->hip);
        opened = opened_knee(f, thigh, shin, side_of(&world[hip]), length(to_target));
        swing = between(plus(thigh, turned(opened, shin)), to_target);
    }
    rotations[hip] = quat_product(inside(&world[0], swing), rotations[hip]);
    rotations[knee] = quat_product(inside(&world[hip], opened), rotations[knee]);
    const Quat back = quat_product(inverse(quat_product(swing, opened)), leg->pitch);
    rotations[ankle] = quat_product(inside(&world[knee], back), rotations[ankle]);
    positions[knee] = plus(leg->hip, turned(swing, thigh));
    positions[ankle] = plus(leg->hip, turned(swing, plus(turned(opened, shin), thigh)));
    positions[f->toe[side]] = plus(positions[ankle], turned(leg->pitch, foot));
}

/* Moves both ankles by their shifts, with the hips lower by `drop`, which is at least `need` and fades. */
static void move_feet(const Feet *f, Leg *legs, float *drop, float need, const Mat3 *world, Quat *rotations, Vec3 *positions) {
    *drop = larger(need, f->hip_return * *drop);
    for (int64_t j = 0; j < JOINTS; j++) positions[j].y -= *drop;
    for (int side = 0; side < 2; side++) {
        Leg *leg = legs + side;
        leg->hip.y -= *drop, leg->knee.y -= *drop, leg->ankle.y -= *drop, leg->toe.y -= *drop;
        leg->shift.y += *drop;
        move_foot(f, side, leg, world, rotations, positions);
    }
}

static Leg leg_of(const Feet *f, int side, const Vec3 *positions) {
    return (Leg){positions[f->hip[side]], positions[f->knee[side]], positions[f->ankle[side]], positions[f->toe[side]],
                 {0, 0, 0}, {1, 0, 0, 0}};
}

void roll_back(const Feet *f, const Vec3 *offsets, Quat *rotations) {
    const float pi = 3.14159265f;
    for (int side = 0; side < 2; side++) {
        const Vec3 toe = offsets[f->toe[side]], along = times(1.0f / larger(length(toe), 1e-9f), toe);
        Quat *foot = rotations + f->ankle[side];
        float roll = 2.0f * atan2f(dot((Vec3){foot->x, foot->y, foot->z}, along), foot->w);
        if (roll > pi) roll -= 2.0f * pi;
        if (roll < -pi) roll += 2.0f * pi;
        const float size = fabsf(roll);
        if (size <= f->usual_roll) continue;
        const float left = f->usual_roll * clip((f->most_roll - size) / (f->most_roll - f->usual_roll), 0.0f, 1.0f);
        *foot = quat_product(*foot, about(along, roll > 0.0f ? left - size : size - left));
    }
}

void lock_feet(const Feet *f, int64_t row, const float *contacts, float scale, const Mat3 *world, Quat *rotations,
               Vec3 *positions) {
    const int known = f->moving[row];
    carry(f, row, contacts, scale, positions);
    Leg legs[2];
    float *drop = f->drop + row, need = 0.0f;
    int still = *drop <= f->least_change;
    for (int side = 0; side < 2; side++) {
        Leg *leg = legs + side;
        *leg = leg_of(f, side, positions);
        const Vec3 shift = toe_shift(f, 2 * row + side, leg->toe, contacts + 2 * side, scale, known);
        if (shift.x != 0.0f || shift.y != 0.0f || shift.z != 0.0f || bent_backwards(f, leg, &world[f->hip[side]])) still = 0;
        const Vec3 foot = minus(leg->toe, leg->ankle);
        leg->pitch = pitched(f, foot, shift.y);
        leg->shift = minus(plus(shift, foot), turned(leg->pitch, foot));
        need = larger(need, needed_drop(f, leg, scale));
    }
    if (still)
        *drop = 0.0f;
    else
        move_feet(f, legs, drop, need, world, rotations, positions);
}

/* How toes bend upwards: about an axis, until they are level at `most`. */
typedef struct {
    Vec3 axis;
    float most;
} Hinge;

static Hinge hinge_of(const Mat3 *toe, Vec3 ahead) {
    const Vec3 axis = matrix_vector(toe, cross(ahead, (Vec3){0, 1, 0})), way = matrix_vector(toe, ahead);
    return (Hinge){axis, larger(-atan2f(way.y, cross(axis, way).y), 0.0f)};
}

/* The height of the lowest points of a part over their joint, turned by a matrix and then by a rotation. */
static float lowest(const Soles *s, int64_t part, const Mat3 *world, Quat bend) {
    float least = INFINITY;
    for (int64_t n = 0; n < s->counts[part]; n++) {
        const Vec3 point = matrix_vector(world, ((const Vec3 *)s->points)[part * s->most + n]);
        least = smaller(least, turned(bend, point).y);
    }
    return least;
}

/* The height of a sole's joint at which the foot stands; toes bend where they are below the rest of it. */
static float standing_sole(const Soles *s, int64_t part, const Mat3 *foot, const Mat3 *toe, Vec3 ahead) {
    const Quat none = {1, 0, 0, 0};
    const float deep = -lowest(s, part, foot, none);
    if (!s->counts[part + 1]) return deep;
    const Hinge hinge = hinge_of(toe, ahead);
    const float level = lowest(s, part + 1, toe, about(hinge.axis, hinge.most));
    return larger(deep, -larger(lowest(s, part + 1, toe, none), level));
}

/* By how much toes have to bend for none of their tips to be below a height over their joint. */
static float needed_bend(const Soles *s, int64_t part, const Mat3 *toe, Vec3 ahead, Vec3 axis, float floor) {
    const Vec3 *points = (const Vec3 *)s->points + part * s->most;
    float furthest = 0.0f, bend = 0.0f;
    for (int64_t n = 0; n < s->counts[part]; n++) furthest = larger(furthest, dot(points[n], ahead));
    for (int64_t n = 0; n < s->counts[part]; n++) {
        if (dot(points[n], ahead) <= s->tip * furthest) continue;
        /* Bent by an angle, a point is still + size sin(angle + now) above the joint. */
        const Vec3 point = matrix_vector(toe, points[n]);
        const float still = dot(point, axis) * axis.y, up = point.y - still, before = cross(axis, point).y;
        const float size = larger(sqrtf(up * up + before * before), 1e-6f);
        if (point.y < floor) bend = larger(bend, asinf(clip((floor - still) / size, -1.0f, 1.0f)) - atan2f(up, before));
    }
    return bend;
}

static Vec3 ahead_of(Vec3 toe) {
    toe.y = 0.0f;
    return times(1.0f / larger(length(toe), 1e-12f), toe);
}

void plant_soles(const Soles *s, const Feet *f, int64_t row, const Vec3 *offsets, const Mat3 *world, Quat *rotations,
                 Vec3 *positions) {
    const int toes = s->counts[4 * row + 1] && s->counts[4 * row + 3];
    Leg legs[2];
    float need = 0.0f;
    for (int side = 0; side < 2; side++) {
        const int64_t foot = 2 * row + side, ankle = f->ankle[side], toe = f->toe[side];
        const Vec3 ahead = ahead_of(offsets[toe]);
        const float height = s->floor[row] + standing_sole(s, 2 * foot, &world[ankle], &world[toe], ahead);
        const float missing = height - positions[toes ? toe : ankle].y;
        const float near = clip(1.0f - (-missing - s->near) / s->fade, 0.0f, 1.0f);
        float *rise = s->rise + foot;
        *rise = larger(*rise + s->pace * (f->stands[foot] * near * missing - *rise), missing);
        legs[side] = leg_of(f, side, positions);
        legs[side].shift.y = *rise;
        need = larger(need, needed_drop(f, &legs[side], 1.0f));
    }
    move_feet(f, legs, s->drop + row, need, world, rotations, positions);
    for (int side = 0; side < 2; side++) {
        const int64_t foot = 2 * row + side, ankle = f->ankle[side], toe = f->toe[side];
        if (!toes) continue;
        const Hinge hinge = hinge_of(&world[toe], ahead_of(offsets[toe]));
        const float floor = s->floor[row] - positions[toe].y;
        const float needed = needed_bend(s, 2 * foot + 1, &world[toe], ahead_of(offsets[toe]), hinge.axis, floor);
        s->bend[foot] = smaller(larger(needed, (1.0f - s->pace) * s->bend[foot]), hinge.most);
        const Quat bend = inside(&world[ankle], about(hinge.axis, s->bend[foot]));
        rotations[toe] = quat_product(bend, rotations[toe]);
    }
}
