/* Steering by wishes and along paths: the gait, and the trajectory of the coming second. A wish names no places, as a
   path does, so velocity and facing approach it like critically damped springs: quickly at first and without overshoot.
   steering.py and path_place.py say what the settings are; tests/oracle does the same in Python.

   A number that is not given is NaN. */

#include <math.h>
#include <stdint.h>

/* Raised with every change of a struct or of what a function does; steering_kernel.py refuses other libraries. */
int64_t steering_kernel_version(void) { return 2; }

#define WHOLE_TURN 6.283185307179586
#define SAMPLES 6      /* of a trajectory */
#define SAMPLE_FRAMES 10 /* from one to the next */

/* In the order of MotionKind. */
enum { GAIT, STANCE, PERFORMANCE, EVENTS, FREE };

/* What steering knows of a motion type. */
typedef struct {
    double speed, facing;    /* usual speed, cm/s, and angle from the heading to the way; NaN if it has none */
    double slowest, fastest; /* recorded speeds, cm/s; 0 and infinity if none are */
    int64_t kind;
} Type;

typedef struct {
    double stands_below, goes_from, run_speed, turn_cost, backwards_share, most_aside, most_aside_running;
} Choice;

typedef struct {
    double halflife, turn_halflife, anchor_halflife, measured_share, smoothing, settled_within, leave_anchor, turn_speed;
    double turn_share, turn_aside;
} Springs;

typedef struct {
    double seconds, wait, same_wish, overshoot, overshoot_seconds, least, most;
} SpeedControl;

/* One character. Places are x, z (cm) and heading (radians). */
typedef struct {
    double fps;
    Choice choice;
    Springs springs;
    SpeedControl speed_control;
    int64_t count;
    const Type *types; /* (count,) */
    double *shares;    /* (count,) of the wished speed that is requested of each gait */
    double before[3], anchor[3];
    double velocity[2], acceleration[2], measured[2]; /* of the springs, and of the body */
    double facing, turning;                           /* of the spring */
    double wish[2], overshoot;                            /* velocity of the last change of wish, and its overshoot */
    int32_t seen, anchored, gait, since;              /* flags; gait of the wish, and frames since its change */
    float trajectory[4 * SAMPLES];                    /* positions, then directions, in the heading frame */
} Steering;

static double within(double value, double low, double high) { return fmin(fmax(value, low), high); }

/* An angle wrapped to -pi to pi. */
static double nearest_turn(double angle) { return remainder(angle, WHOLE_TURN); }

/* A vector turned about Y. */
static void turn(double angle, double *vector) {
    const double sine = sin(angle), cosine = cos(angle), x = vector[0], z = vector[1];
    vector[0] = cosine * x + sine * z, vector[1] = cosine * z - sine * x;
}

static void put_sample(float *trajectory, int n, const double *place, const double *direction) {
    float *out = trajectory + 2 * n;
    out[0] = (float)place[0], out[1] = (float)place[1];
    out[2 * SAMPLES] = (float)direction[0], out[2 * SAMPLES + 1] = (float)direction[1];
}

/* ---- the choice of a gait ---- */

/* Types are taken from the first of four groups that has any: gaits, types that velocity steers, types without a phase,
   all. A wish to stand leaves out the first. */
static int belongs(int64_t kind, int group) {
    if (group == 0) return kind == GAIT;
    if (group == 1) return kind == GAIT || kind == STANCE;
    return group == 3 || (kind != PERFORMANCE && kind != EVENTS);
}

/* How far a type is from a wish in speed and, where it goes, in facing. Speeds count as square roots, so that slow types
   have narrow bands. */
static double misfit(const Choice *choice, const Type *type, double speed, double aside) {
    if (isnan(type->speed)) return INFINITY;
    const double off = fabs(sqrt(speed) - sqrt(type->speed));
    if (speed < choice->goes_from) return off;
    const double turned = fabs(nearest_turn(aside - type->facing)) + choice->backwards_share * fabs(type->facing);
    return off + choice->turn_cost * turned;
}

/* The type for a wished velocity and facing. */
int32_t steered_type(const Steering *s, double x, double z, double facing) {
    const double speed = hypot(x, z), aside = isnan(facing) ? 0 : atan2(x, z) - facing;
    int64_t best = -1;
    double least = 0;
    for (int group = speed >= s->choice.goes_from ? 0 : 1; best < 0 && group < 4; group++)
        for (int64_t n = 0; n < s->count; n++) {
            if (!belongs(s->types[n].kind, group)) continue;
            const double off = misfit(&s->choice, s->types + n, speed, aside);
            if (best < 0 || off < least) best = n, least = off;
        }
    return (int32_t)best;
}

/* ---- what a gait can do ---- */

/* Changes a wish to the nearest one at which the feet of a type do not glide: within its recorded speeds, and facing
   within a limit of its direction. */
static void keep_within_limits(const Choice *choice, const Type *type, double *wish, double *facing) {
    const double speed = hypot(wish[0], wish[1]);
    if (type->kind == STANCE) wish[0] = wish[1] = 0;
    if (speed < choice->stands_below || type->kind != GAIT || isnan(type->speed)) return;
    if (!isnan(*facing)) {
        const double own = atan2(wish[0], wish[1]) - type->facing, aside = nearest_turn(*facing - own);
        const double most = type->speed > choice->run_speed ? choice->most_aside_running : choice->most_aside;
        if (fabs(aside) > most) *facing = own + copysign(most, aside);
    }
    const double share = within(speed, type->slowest, type->fastest) / speed;
    wish[0] *= share, wish[1] *= share;
}

/* Begins to count the frames of a wish that has changed. */
static void take_wish(Steering *s, int32_t kind, const double *wish, double speed) {
    const double away = hypot(wish[0] - s->wish[0], wish[1] - s->wish[1]);
    if (kind == s->gait && away <= s->speed_control.same_wish * speed) return;
    const double change = kind == s->gait ? speed - hypot(s->wish[0], s->wish[1]) : 0;
    s->overshoot = s->speed_control.overshoot * within(change, -speed, speed);
    s->gait = kind, s->wish[0] = wish[0], s->wish[1] = wish[1], s->since = 0;
}

/* Integral controller for speed: networks miss that of a trajectory by a tenth to a quarter, and foot locking slows the
   root further. A path runs ahead of a body that lags; a wish does not, so the error is integrated while it stays the
   same. After a change of wish the requested speed overshoots for a while, because a body changes its speed slowly. The
   share of a gait is kept: a body at 0.9 of one speed reaches about 0.9 of another. */
static void control_speed(Steering *s, int32_t kind, double *wish) {
    const SpeedControl *set = &s->speed_control;
    const Type *type = s->types + kind;
    const double speed = hypot(wish[0], wish[1]);
    if (speed < s->choice.stands_below || type->kind != GAIT) {
        s->gait = -1;
        return;
    }
    take_wish(s, kind, wish, speed);
    s->since += 1;
    double share = s->shares[kind];
    const int found = s->since > set->wait * s->fps;
    if (found) {
        const double along = (s->measured[0] * wish[0] + s->measured[1] * wish[1]) / speed;
        share = within(share + (1 - along / speed) / (set->seconds * s->fps), set->least, set->most);
    }
    /* Within the recorded speeds, or up to the wanted one where that is outside them. */
    const double requested = share * speed + (s->since <= set->overshoot_seconds * s->fps ? s->overshoot : 0);
    share = fmax(fmin(requested, fmax(type->fastest, speed)), fmin(type->slowest, speed)) / speed;
    if (found) s->shares[kind] = share;
    wish[0] *= share, wish[1] *= share;
}

/* ---- springs ---- */

/* The rate y (1/s) of a critically damped spring that covers half of its distance in halflife seconds: the remaining
   share is (1 + y t) exp(-y t), which is a half at y t = 1.678. */
static double spring_rate(double halflife) { return 1.678347 / fmax(halflife, 1e-3); }

/* Distance from the goal and velocity of such a spring after t seconds. */
static void spring(double *away, double *velocity, double y, double t) {
    const double push = *velocity + *away * y, fade = exp(-y * t);
    *away = fade * (*away + push * t);
    *velocity = fade * (*velocity - y * push * t);
}

/* Its distance from the goal after t seconds. */
static double distance(double away, double velocity, double y, double t) {
    spring(&away, &velocity, y, t);
    return away;
}

/* The integral of this distance over t seconds. */
static double travel(double away, double velocity, double y, double t) {
    const double push = velocity + away * y, fade = exp(-y * t);
    return (away * (1 - fade) + push * ((1 - fade) / y - t * fade)) / y;
}

/* Measures the movement of the body, once a frame, before steer; free: nobody steers, and the springs follow it. */
void observe(Steering *s, double x, double z, double heading, int32_t free) {
    const double place[3] = {x, z, heading}, share = free ? 1 : s->springs.measured_share;
    for (int axis = 0; axis < 2; axis++) {
        const double step = s->seen ? (place[axis] - s->before[axis]) * s->fps : 0;
        s->measured[axis] += s->springs.smoothing * (step - s->measured[axis]);
        s->velocity[axis] += share * (s->measured[axis] - s->velocity[axis]);
        s->acceleration[axis] *= 1 - share;
    }
    const double facing = s->seen ? s->facing : heading;
    s->facing = heading + nearest_turn(facing - heading) * (1 - share), s->turning *= 1 - share;
    for (int n = 0; n < 3; n++) s->before[n] = place[n];
    s->seen = 1;
    if (free) s->anchored = 0;
}

/* Speed of the spring in cm/s. */
double spring_speed(const Steering *s) { return hypot(s->velocity[0], s->velocity[1]); }

/* Changes a wish to what to approach first: a body turns about where it faces, and slows down to turn back. */
static void turn_first(const Steering *s, double *wish, double *facing) {
    const Springs *set = &s->springs;
    const double off = nearest_turn(*facing - s->facing);
    /* A spring whose goal stays at distance d ahead of it moves by d * rate / 2. */
    const double most = 2 * set->turn_speed / spring_rate(set->turn_halflife);
    const double share = within(1 + cos(off), set->turn_share, 1);
    const double aside = hypot(wish[0], wish[1]) > s->choice.run_speed ? 0 : set->turn_aside;
    turn(-copysign(fmax(fabs(off) - aside, 0), off), wish);
    wish[0] *= share, wish[1] *= share;
    *facing = s->facing + within(off, -most, most);
}

/* Whether a standing body keeps its place and heading, those where the spring has nearly stopped. */
static int hold(Steering *s) {
    const double x = s->before[0], z = s->before[1];
    const int far = hypot(s->anchor[0] - x, s->anchor[1] - z) > s->springs.leave_anchor;
    if (s->anchored && !far) return 1;
    if (spring_speed(s) > s->choice.stands_below) return 0;
    s->anchor[0] = x, s->anchor[1] = z, s->anchor[2] = s->facing;
    return s->anchored = 1;
}

/* Displacement along an axis in t seconds. */
static double place_ahead(const Steering *s, int axis, double goal, int held, double t) {
    if (held) {
        const double away = s->before[axis] - s->anchor[axis];
        return distance(away, s->velocity[axis], spring_rate(s->springs.anchor_halflife), t) - away;
    }
    return goal * t + travel(s->velocity[axis] - goal, s->acceleration[axis], spring_rate(s->springs.halflife), t);
}

/* Advances the springs by one frame. */
static void advance(Steering *s, const double *goal, double wanted) {
    const double t = 1 / s->fps;
    for (int axis = 0; axis < 2; axis++) {
        double away = s->velocity[axis] - goal[axis];
        spring(&away, &s->acceleration[axis], spring_rate(s->springs.halflife), t);
        s->velocity[axis] = goal[axis] + away;
    }
    const double away = nearest_turn(s->facing - wanted);
    double off = away;
    spring(&off, &s->turning, spring_rate(s->springs.turn_halflife), t);
    s->facing = s->facing - away + off;
}

/* The trajectory for a velocity and a facing; without one the body keeps that at which it stopped, or its own. */
static void predict(Steering *s, const double *wish, double facing) {
    const double heading = s->before[2];
    const int stands = hypot(wish[0], wish[1]) < s->choice.stands_below;
    double goal[2] = {wish[0], wish[1]};
    const int given = !isnan(facing);
    if (given) turn_first(s, goal, &facing);
    if (stands) goal[0] = goal[1] = 0;
    else s->anchored = 0;
    const int held = stands && hold(s);
    const double wanted = given ? facing : held ? s->anchor[2] : heading;
    const double away = nearest_turn(s->facing - wanted), begin = nearest_turn(s->facing - heading) - away;
    for (int n = 0; n < SAMPLES; n++) {
        const double t = (n + 1) * SAMPLE_FRAMES / s->fps;
        double place[2];
        for (int axis = 0; axis < 2; axis++) place[axis] = place_ahead(s, axis, goal[axis], held, t);
        turn(-heading, place);
        const double turned = begin + distance(away, s->turning, spring_rate(s->springs.turn_halflife), t);
        put_sample(s->trajectory, n, place, (double[]){sin(turned), cos(turned)});
    }
    advance(s, goal, wanted);
}

/* How much of the root-slip correction applies, 0 to 1: little while the body lacks speed in the wished direction. */
static double settled(const Steering *s, const double *wish) {
    const double speed = hypot(wish[0], wish[1]);
    if (speed < s->choice.stands_below) return 1;
    const double along = (s->velocity[0] * wish[0] + s->velocity[1] * wish[1]) / speed;
    return within(1 - (1 - along / speed) / s->springs.settled_within, 0, 1);
}

/* Fills the trajectory of a type for a wished velocity and facing; returns the factor on the root-slip correction. */
double steer(Steering *s, int32_t kind, double x, double z, double facing) {
    const Type *type = s->types + kind;
    double wish[2] = {x, z};
    if (isnan(facing) && hypot(x, z) >= s->choice.stands_below)
        facing = atan2(x, z) - (isnan(type->speed) ? 0 : type->facing);
    keep_within_limits(&s->choice, type, wish, &facing);
    control_speed(s, kind, wish);
    const double share = settled(s, wish);
    predict(s, wish, facing);
    return share;
}

/* ---- paths ---- */

#define SPACING 2.0      /* cm between the points of a path, as path.py has it */
#define STEP 5           /* frames of one speed when looking ahead */
#define BLEND_SAMPLES 16 /* points at which types are sampled for their blend; chosen */

typedef struct {
    double usual, slowest, creep, acceleration, beside_turn, too_slow, from_rest;
} Profile;

typedef struct {
    double behind, ahead, arrived, back, no_further, beside, nearer;
} Search;

/* A part of a path. plan_path fills in end and facing. */
typedef struct {
    double requested, lateral, seconds; /* speed, acceleration into curves (cm/s^2), and length of the stop at its end */
    double end, facing;             /* arc length, and angle from the heading to the way */
    int32_t type, last;             /* the number of its last corner */
} Part;

/* A path of N points, and a character on it. Lengths are cm, speeds cm/s. */
typedef struct {
    double fps;
    Profile profile;
    Search search;
    double arc, least;    /* arc length of the character; the search never goes back beyond `least` */
    double ahead[SAMPLES]; /* arc lengths of the trajectory's places */
    Part *parts;
    const double *points, *tangents;        /* (N, 2) */
    const int32_t *part;                    /* (N,) */
    double *speeds;                         /* (N,) */
    int32_t *track;                         /* (N,) types */
    float *weights;                         /* (type_count,) of the frame */
    int32_t count, part_count, type_count;  /* N */
    int32_t blend, stand;                   /* frames of a change of type; type of standing at stops, or -1 */
    int32_t stands;                         /* whether the body stands before the path */
    int32_t stop, stood;                    /* part whose stop comes next, and frames since it was reached, or -1 */
    int32_t present, goes_on, finished;     /* part of the frame; whether a stop ends, and whether the path does */
    float trajectory[4 * SAMPLES];          /* as of Steering */
} Path;

static double mix(double a, double b, double share) { return a * (1 - share) + b * share; }

static double dot(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1]; }

static void normalise(double *vector) {
    const double size = fmax(sqrt(dot(vector, vector)), 1e-12);
    vector[0] /= size, vector[1] /= size;
}

/* The distance of a corner from the one before. */
static double step_of(const double *corner) {
    const double step[2] = {corner[0] - corner[-2], corner[1] - corner[-1]};
    return sqrt(dot(step, step));
}

/* How many points a path along corners (x, z) has; 0 if it is too short for one. */
int32_t path_points(const double *corners, int32_t count) {
    double total = 0;
    for (int32_t n = 1; n < count; n++) total += step_of(corners + 2 * n);
    return total < 2 * SPACING ? 0 : (int32_t)fmin(fmax(floor(total / SPACING) + 1, 3), INT32_MAX);
}

/* Fills count points, evenly spaced along the corners, with their directions and parts. */
void even_points(const double *corners, const Part *parts, int32_t part_count, int32_t count, double *points,
                 double *tangents, int32_t *part) {
    double from = 0, size = step_of(corners + 2); /* arc length of the corner before `corner`, and their distance */
    for (int32_t n = 0, of = 0, corner = 1; n < count; n++) {
        while (corner < parts[part_count - 1].last && from + size < n * SPACING)
            from += size, corner++, size = step_of(corners + 2 * corner);
        while (of < part_count - 1 && parts[of].last < corner) of++;
        const double share = size > 0 ? within((n * SPACING - from) / size, 0, 1) : 0, *end = corners + 2 * corner;
        for (int k = 0; k < 2; k++) points[2 * n + k] = mix(end[k - 2], end[k], share);
        part[n] = of;
    }
    for (int32_t n = 0; n < count; n++) {
        const double *before = points + 2 * (n ? n - 1 : 0), *after = points + 2 * (n + 1 < count ? n + 1 : n);
        for (int k = 0; k < 2; k++) tangents[2 * n + k] = after[k] - before[k];
        normalise(tangents + 2 * n);
    }
}

/* ---- speeds along a path ---- */

/* The speed of a part, in cm/s: the usual one of its type, or a wished one within its recorded range. Outside of it a
   body glides: its feet hardly leave the ground, or hardly touch it. */
double part_speed(const Steering *s, const Profile *set, int32_t type, double requested) {
    const Type *known = s->types + type;
    if (isnan(requested)) return fmax(isnan(known->speed) ? set->usual : known->speed, set->slowest);
    return within(fmax(requested, set->slowest), known->slowest, known->fastest);
}

static int32_t nearest_point(const Path *p, double arc) {
    return (int32_t)within(rint(arc / SPACING), 0, p->count - 1);
}

/* The speed at which a body leans into the turn at a point as far as recorded ones. */
static double turn_speed(const Path *p, int32_t n) {
    const int32_t first = (int32_t)fmax(n - p->profile.beside_turn, 0);
    const int32_t last = (int32_t)fmin(n + p->profile.beside_turn, p->count - 1);
    const double turned = acos(within(dot(p->tangents + 2 * first, p->tangents + 2 * last), -1, 1));
    return sqrt(p->parts[p->part[n]].lateral * (last - first) * SPACING / fmax(turned, 1e-6));
}

/* Limits what the speed grows by from each point to the next. At constant acceleration its square is linear in arc
   length. */
static void limit_growth(Path *p, int32_t from, int32_t step) {
    const double growth = 2 * p->profile.acceleration * SPACING;
    double square = INFINITY;
    for (int32_t n = from; n >= 0 && n < p->count; n += step) {
        square = fmin(p->speeds[n] * p->speeds[n], square + growth);
        p->speeds[n] = sqrt(square);
    }
}

/* The speed below which a type becomes a walk: a run where the path is slower than any recorded run. */
static double walks_below(const Steering *s, const Path *p, const Type *run, const Type *walk) {
    const int slower = isfinite(walk->fastest) && isfinite(run->fastest) && walk->slowest < run->slowest;
    return slower && run->speed > s->choice.run_speed ? p->profile.too_slow * run->slowest : 0;
}

/* The next part, from one on, at whose end the character stops. */
static int32_t next_stop(const Path *p, int32_t part) {
    while (part < p->part_count && !(p->parts[part].seconds > 0)) part++;
    return part;
}

/* Fills speeds, track and the parts, and puts the character at the beginning. The path begins at full speed, because
   start poses are in motion; only a body that stands begins more slowly. */
void plan_path(const Steering *s, Path *p) {
    const int32_t walk = steered_type(s, 0, p->profile.usual, 0);
    for (int32_t n = 0; n < p->part_count; n++) {
        const Type *type = s->types + p->parts[n].type;
        p->parts[n].facing = isnan(type->speed) ? 0 : type->facing;
        p->parts[n].end = 0;
    }
    for (int32_t n = 0; n < p->count; n++) {
        Part *part = p->parts + p->part[n];
        p->speeds[n] = fmin(part_speed(s, &p->profile, part->type, part->requested), turn_speed(p, n));
        part->end = fmin(n + 1, p->count - 1) * SPACING;
    }
    /* A part too short for a point ends with the one before. */
    for (int32_t n = 1; n < p->part_count; n++) p->parts[n].end = fmax(p->parts[n].end, p->parts[n - 1].end);
    for (int32_t n = next_stop(p, 0); n < p->part_count; n = next_stop(p, n + 1))
        p->speeds[nearest_point(p, p->parts[n].end)] = p->profile.creep;
    if (p->stands) p->speeds[0] *= p->profile.from_rest;
    limit_growth(p, 0, 1);
    limit_growth(p, p->count - 1, -1);
    for (int32_t n = 0; n < p->count; n++) {
        const int32_t type = p->parts[p->part[n]].type;
        p->track[n] = p->speeds[n] < walks_below(s, p, s->types + type, s->types + walk) ? walk : type;
    }
    p->arc = p->least = 0, p->stop = next_stop(p, 0), p->stood = -1;
}

/* ---- a character on a path ---- */

/* Point and unit direction at an arc length; straight on beyond the end. */
static void at_arc(const Path *p, double arc, double *point, double *way) {
    const int32_t last = p->count - 1, n = (int32_t)within(floor(arc / SPACING), 0, last - 1);
    const double share = within(arc / SPACING - n, 0, 1), beyond = fmax(arc - last * SPACING, 0);
    for (int k = 0; k < 2; k++) {
        const double *points = p->points + 2 * n + k, *tangents = p->tangents + 2 * n + k;
        point[k] = mix(points[0], points[2], share) + beyond * p->tangents[2 * last + k];
        way[k] = mix(tangents[0], tangents[2], share);
    }
    normalise(way);
}

static double speed_at(const Path *p, double arc) { return p->speeds[nearest_point(p, arc)]; }

/* The arc length that is reached in some frames from another one; not beyond the next stop. */
static double reached(const Path *p, double arc, int frames) {
    const double end = p->stop < p->part_count ? fmax(p->parts[p->stop].end, arc) : INFINITY;
    for (int n = 0; n < frames; n += STEP) arc = fmin(arc + speed_at(p, arc) * STEP / p->fps, end);
    return arc;
}

static double away(const Path *p, int32_t n, const double *place) {
    return hypot(p->points[2 * n] - place[0], p->points[2 * n + 1] - place[1]);
}

/* The arc length nearest to a place, near the last one, so that a character does not cut off a loop where its path
   crosses itself. */
static double nearest_arc(const Path *p, const double *place) {
    const Search *set = &p->search;
    const int32_t last = p->count - 1, end = (int32_t)within((p->arc + set->ahead) / SPACING + 2, 1, p->count);
    const int32_t first = (int32_t)within(fmax(p->arc - set->behind, p->least) / SPACING, 0, end - 1);
    const double *here = p->tangents + 2 * nearest_point(p, p->arc);
    int32_t best = first, out = -1;
    for (int32_t n = first; n < end; n++)
        if (away(p, n, place) < away(p, best, place)) best = n;
    /* The way back must be clearly nearer than the way out. */
    if (dot(p->tangents + 2 * best, here) < set->back) {
        for (int32_t n = first; n < end; n++) {
            const double far = away(p, n, place);
            if (dot(p->tangents + 2 * n, here) <= 0 || far >= away(p, best, place) + set->nearer) continue;
            if (out < 0 || far < away(p, out, place)) out = n;
        }
        if (out >= 0) best = out;
    }
    if (best < last) return best * SPACING;
    /* Beyond the last point, arc length grows along its direction, so that the character can reach the end. */
    const double beyond[2] = {place[0] - p->points[2 * last], place[1] - p->points[2 * last + 1]};
    return last * SPACING + fmax(dot(beyond, p->tangents + 2 * last), 0);
}

/* Finds the place of a body. Where a path turns back on itself, way out and way back are equally near. A body that has
   no distance left to a place beyond the turn is on the way back, and stays on it. */
static void move_on(Path *p, const double *place) {
    p->arc = nearest_arc(p, place);
    const double beyond = reached(p, p->arc, SAMPLE_FRAMES), *way = p->tangents + 2 * nearest_point(p, p->arc);
    double there[2], back[2];
    at_arc(p, beyond, there, back);
    there[0] -= place[0], there[1] -= place[1];
    const int turns = dot(back, way) < p->search.back && dot(there, way) < p->search.no_further;
    if (turns && hypot(there[0], there[1]) < p->search.beside) p->least = p->arc = beyond;
}

/* Share of standing in this frame; it rises and falls over half a blend at a stop. */
static double standing(Path *p) {
    const Part *part = p->parts + p->stop;
    if (p->stop == p->part_count || (p->stood < 0 && p->arc < part->end - p->search.arrived)) return 0;
    p->stood = p->stood < 0 ? 1 : p->stood + 1;
    const double left = rint(part->seconds * p->fps) - p->stood, half = p->blend / 2;
    if (left >= 0) return fmin(fmin(p->stood, left), half) / half;
    p->stood = -1, p->stop = next_stop(p, p->stop + 1);
    return 0;
}

/* Fills the type weights at an arc length: the mean over half a blend behind and half a blend ahead, and a share of
   standing. */
void path_weights(const Path *p, double arc, double stands, float *out) {
    const double reach = speed_at(p, arc) * (p->blend / 2) / p->fps, step = 2 * reach / (BLEND_SAMPLES - 1);
    const float share = (float)(p->stand < 0 ? 1 : 1 - stands) / BLEND_SAMPLES;
    for (int32_t n = 0; n < p->type_count; n++) out[n] = 0;
    for (int n = 0; n < BLEND_SAMPLES; n++) out[p->track[nearest_point(p, arc - reach + n * step)]] += share;
    if (p->stand >= 0) out[p->stand] += (float)stands;
}

/* Moves on to the place of a body and fills part, trajectory and type weights; returns the share of standing. */
double follow(Path *p, double x, double z, double heading) {
    move_on(p, (double[]){x, z});
    const int stood = p->stood >= 0;
    const double stands = standing(p);
    for (int n = 0; n < SAMPLES; n++) {
        double place[2], way[2];
        const double arc = p->ahead[n] = reached(p, n ? p->ahead[n - 1] : p->arc, SAMPLE_FRAMES);
        at_arc(p, arc, place, way);
        place[0] -= x, place[1] -= z;
        turn(-heading, place);
        turn(-heading - p->parts[p->part[nearest_point(p, arc)]].facing, way);
        put_sample(p->trajectory, n, place, way);
    }
    path_weights(p, p->arc, stands, p->weights);
    p->present = p->part[nearest_point(p, p->arc)];
    p->goes_on = (stood && p->stood < 0) || p->stands;
    p->stands = 0;
    p->finished = p->arc >= (p->count - 2) * SPACING && p->stop == p->part_count;
    return stands;
}
