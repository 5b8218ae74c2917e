/* One axis and one step of it: terms.py, dynamics.py and membrane.py of sim_plant/physics, operation by operation. What
 * they say of the model and its units is not said again here. */
#include "arithmetic.h"

enum { LINES = 4, HUNG = 2, SLIPS = 4, KEPT = 8 };

typedef struct {
    double position, velocity, pierced, load_position, load_velocity, bristle, cable, force, played, walked;
    double hung[HUNG][2]; /* position and velocity of each mass hung beside the load */
    double slip[SLIPS];
} motion;

typedef struct {
    double time, position, velocity;
} point;

/* Everything is eight bytes wide, so that Python can fill it as one array (block.py has the same order). */
typedef struct {
    double kind, constant;
    /* Structure */
    double mass, coulomb, stribeck, stated_slowness, viscous, quadratic, presliding, bristle_damping, lag, load;
    double mode_stiffness, mode_damping, variation, variation_wavenumber, variation_phase;
    double cable_stiffness, cable_hysteresis, cable_reach, backlash;
    double hung_mass[HUNG], hung_stiffness[HUNG], hung_damping[HUNG];
    double slip_weight[SLIPS], slip_reach[SLIPS];
    double line_amplitude[LINES], line_wavenumber[LINES], line_phase[LINES];
    double floor_amplitude[LINES], floor_frequency[LINES], floor_phase[LINES];
    double surface, direction, membrane, puncture_depth, drag;
    /* of Dynamics */
    double inverse_mass, inverse_load, stiffness, peak, inverse_limit, inverse_lag, slowness;
    double ring_rate, ring_time, ring_scale, amplitudes, rate, speed_rate, stuck_rate, compliance, stuck_time;
    double inverse_hung[HUNG], hung_rate[HUNG], hung_time[HUNG], hung_scale[HUNG];
    /* Disturbance, Encoder */
    double noise, walk, encoder_noise, encoder_error, encoder_wavenumber, encoder_latency;
    uint64_t noise_key, walk_key, encoder_key;
    /* state */
    double command, steps, lag_h, lag_begin, lag_slope, lag_left, n_past;
    motion at;
    point past[KEPT];
} axis;

enum {
    BRISTLE = 1,
    MODE = 2,
    LAG = 4,
    STRIBECK = 8,
    VARIATION = 16,
    CABLE = 32,
    BACKLASH = 64,
    CELL = 128,
    NOISY = 1 << 14
};

#define HAS(a, bit) ((int)(a)->kind & (bit))
#define LINES_OF(a) ((int)(a)->kind >> 8 & 7)
#define FLOOR_OF(a) ((int)(a)->kind >> 11 & 7)
#define HUNG_OF(a) ((int)(a)->kind >> 16 & 3)
#define SLIPS_OF(a) ((int)(a)->kind >> 18 & 7)

static triple sinusoids(const double *amplitudes, const double *wavenumbers, const double *phases, int count,
                        double middle, double span) {
    triple sum;
    sum.first = sum.inner = sum.last = 0.0 * span;
    for (int i = 0; i < count; i++) {
        double sine, cosine, amplitude = amplitudes[i];
        sincos_turns(middle * wavenumbers[i] + phases[i], &sine, &cosine);
        double angle = 0.5 * TURN * (span * wavenumbers[i]);
        double bent = amplitude * (sine * (1.0 - 0.5 * (angle * angle)));
        double tilt = amplitude * (cosine * angle);
        sum.first = sum.first + (bent - tilt);
        sum.inner = sum.inner + amplitude * sine;
        sum.last = sum.last + (bent + tilt);
    }
    return sum;
}

static triple lines(const axis *a, double middle, double span) {
    return sinusoids(a->line_amplitude, a->line_wavenumber, a->line_phase, LINES_OF(a), middle, span);
}

static triple variations(const axis *a, double middle, double span) {
    return sinusoids(&a->variation, &a->variation_wavenumber, &a->variation_phase, 1, middle, span);
}

static triple floors(const axis *a, double middle, double span) {
    return sinusoids(a->floor_amplitude, a->floor_frequency, a->floor_phase, FLOOR_OF(a), middle, span);
}

static double resistance(const axis *a, double position, double velocity, double pierced) {
    double inside = (position - a->surface) * a->direction;
    double indentation = 0.5 * (inside + fabs(inside));
    double elastic = a->membrane * indentation * indentation * indentation;
    return (1.0 - pierced) * a->direction * elastic + pierced * a->drag * velocity;
}

/* Positive once the membrane's state changes. */
static double transition(const axis *a, const motion *at) {
    double inside = (at->load_position - a->surface) * a->direction;
    return inside - a->puncture_depth - at->pierced * (2.0 * inside - a->puncture_depth);
}

static void prepare_lag(axis *a, double h) {
    if (h == a->lag_h) {
        return;
    }
    double x = h * a->inverse_lag, left = decay(0.25 * x);
    left = left * left;
    left = left * left;
    double mean = (1.0 - left) / x, moment = (1.0 - mean) / x;
    a->lag_begin = 6.0 * moment - 2.0 * mean;
    a->lag_slope = 6.0 * mean - 12.0 * moment;
    a->lag_left = left;
    a->lag_h = h;
}

static inline double limit_at(const axis *a, double velocity) {
    if (!HAS(a, STRIBECK)) {
        return a->presliding;
    }
    double ratio = velocity * a->slowness;
    return a->presliding + a->peak / (1.0 + ratio * ratio);
}

/* The bristle `span` seconds after a start (z, before, v0), and its limit there. */
static double bend(const axis *a, double z, double before, double v0, double moved, double velocity, double span,
                   double *limit) {
    double towards = direction(velocity);
    if (velocity * v0 < 0.0) {
        double there = v0 * v0 * span / (2.0 * (v0 - velocity)), part = fabs(there) / before;
        z = (z + towards * before) * (1.0 - part * (1.0 - 0.5 * part)) - towards * before;
        moved = moved - there;
    }
    if (!HAS(a, STRIBECK)) {
        double sliding = towards * before;
        *limit = before;
        return sliding + (z - sliding) * decay(towards * moved * a->inverse_limit);
    }
    double mean;
    *limit = limit_at(a, velocity);
    double left = decay_with_mean(towards * moved * (0.5 / before + 0.5 / *limit), &mean);
    return towards * (*limit - (*limit - before) * mean) + (z - towards * before) * left;
}

static inline double within(double value, double low, double high) {
    return value < low ? low : value > high ? high : value;
}

/* The elements `span` seconds after they were bent by `begun`; returns their mean deflection. */
static double slip(const axis *a, const double begun[SLIPS], double v0, double moved, double velocity, double span,
                   double bent[SLIPS]) {
    double there = moved, most = limit_at(a, 0.0), limit = limit_at(a, velocity), mean = 0.0;
    int turned = velocity * v0 < 0.0;
    if (turned) {
        there = v0 * v0 * span / (2.0 * (v0 - velocity));
    }
    for (int i = 0; i < SLIPS_OF(a); i++) {
        double z = begun[i], reach = a->slip_reach[i];
        if (turned) {
            z = within(z + there, -(most * reach), most * reach) + (moved - there);
        } else {
            z = z + moved;
        }
        bent[i] = within(z, -(limit * reach), limit * reach);
        mean = mean + a->slip_weight[i] * bent[i];
    }
    return mean;
}

/* The bristle at the end of a step. turn: how much the acceleration fell in it. */
static double bent(const axis *a, double bristle, double before, double v0, double moved, double velocity, double turn,
                   double h) {
    double limit, last, z = bend(a, bristle, before, v0, moved, velocity, h, &limit);
    if (!HAS(a, STRIBECK)) {
        return z;
    }
    double there = 0.5 * moved + 0.125 * h * (v0 - velocity), then = 0.5 * (v0 + velocity) + 0.125 * h * turn;
    double middle = bend(a, bristle, before, v0, there, then, 0.5 * h, &limit);
    double halved = bend(a, middle, limit, then, moved - there, velocity, 0.5 * h, &last);
    return halved + (halved - z) * (1.0 / 3.0);
}

static double friction(const axis *a, double velocity, double z, double limit, double sign, double scale) {
    double dry;
    if (HAS(a, BRISTLE)) {
        dry = a->stiffness * z + a->bristle_damping * (velocity - fabs(velocity) * z / limit);
    } else {
        dry = sign * a->coulomb;
        if (HAS(a, STRIBECK)) {
            double ratio = velocity * a->slowness;
            dry = sign * (a->coulomb + a->stribeck / (1.0 + ratio * ratio));
        }
    }
    if (HAS(a, VARIATION)) {
        dry = scale * dry;
    }
    return dry + (a->viscous + a->quadratic * fabs(velocity)) * velocity;
}

static double load_on_motor(const axis *a, const motion *at, double time, double external, double command,
                            double *hold) {
    double still = 0.0 * at->position, net = external + (HAS(a, LAG) ? at->force : command);
    if (LINES_OF(a)) {
        net = net + lines(a, at->position, still).inner;
    }
    if (HAS(a, CABLE)) {
        net = net - a->cable_hysteresis * at->cable - a->cable_stiffness * at->position;
    }
    if (HAS(a, MODE)) {
        net = net + a->mode_stiffness * (at->load_position - at->position) + a->mode_damping * at->load_velocity;
    } else if (HAS(a, CELL)) {
        net = net - resistance(a, at->position, still, at->pierced);
    }
    for (int i = 0; i < HUNG_OF(a); i++) {
        const double *p = at->hung[i];
        net = net + (a->hung_stiffness[i] * (p[0] - at->position) + a->hung_damping[i] * p[1]);
    }
    if (FLOOR_OF(a)) {
        net = net - (a->mass - a->load - a->hung_mass[0] - a->hung_mass[1]) * floors(a, time + still, still).inner;
    }
    *hold = a->coulomb + a->stribeck;
    if (HAS(a, VARIATION)) {
        *hold = *hold * (1.0 + variations(a, at->position, still).inner);
    }
    return net;
}

static inline double strained(const axis *a, const motion *at, double moved) {
    double onward = direction(moved);
    return onward + (at->cable - onward) * decay(fabs(moved) / a->cable_reach);
}

static inline double followed(double played, double y, double half) {
    return within(played, y - half, y + half);
}

static double play(const axis *a, const motion *at, double y, double u, double h) {
    double half = 0.5 * a->backlash, played = at->played, u0 = at->load_velocity;
    if (u0 * u < 0.0) {
        played = followed(played, at->load_position + u0 * u0 * h / (2.0 * (u0 - u)), half);
    }
    return followed(played, y, half);
}

/* What acts along a step: pulls (N), scales of the dry friction, and the floor's accelerations (m/s^2). */
static void along(axis *a, const motion *at, double time, double external, double command, double h, double pull[3],
                  double scale[3], double floor[3]) {
    double v0 = at->velocity, middle = at->position + 0.5 * h * v0;
    pull[0] = pull[1] = pull[2] = external + command;
    if (HAS(a, LAG)) {
        prepare_lag(a, h);
        double rest = at->force - command;
        pull[0] = pull[0] + rest * a->lag_begin;
        pull[1] = pull[1] + rest * (a->lag_begin + 0.5 * a->lag_slope);
        pull[2] = pull[2] + rest * (a->lag_begin + a->lag_slope);
    }
    if (LINES_OF(a)) {
        triple sum = lines(a, middle, h * v0);
        pull[0] = pull[0] + sum.first, pull[1] = pull[1] + sum.inner, pull[2] = pull[2] + sum.last;
    }
    if (HAS(a, CABLE)) {
        double hysteresis = a->cable_hysteresis * strained(a, at, 0.5 * h * v0);
        pull[0] = pull[0] - hysteresis, pull[1] = pull[1] - hysteresis, pull[2] = pull[2] - hysteresis;
    }
    scale[0] = scale[1] = scale[2] = 1.0;
    if (HAS(a, VARIATION)) {
        triple sum = variations(a, middle, h * v0);
        scale[0] = 1.0 + sum.first, scale[1] = 1.0 + sum.inner, scale[2] = 1.0 + sum.last;
    }
    floor[0] = floor[1] = floor[2] = 0.0;
    if (FLOOR_OF(a)) {
        double still = 0.0 * v0;
        triple sum = floors(a, time + 0.5 * h + still, h + still);
        floor[0] = sum.first, floor[1] = sum.inner, floor[2] = sum.last;
    }
}

/* Of motor and load (m/s^2) in a state (q, q', y, y') under these pulls of the other masses. */
static inline double acceleration(const axis *a, double pierced, const double state[4], double z, double limit,
                                  double sign, double pull, double scale, double floor, const double pulls[HUNG],
                                  double *of_load) {
    double q = state[0], v = state[1], y = state[2], u = state[3];
    double net = pull - friction(a, v, z, limit, sign, scale), b = 0.0;
    if (HAS(a, CABLE)) {
        net = net - a->cable_stiffness * q;
    }
    if (HAS(a, MODE)) {
        double coupling = a->mode_stiffness * (y - q) + a->mode_damping * (u - v);
        net = net + coupling;
        if (HAS(a, CELL)) {
            coupling = coupling + resistance(a, y, u, pierced);
        }
        b = -coupling * a->inverse_load;
    } else if (HAS(a, CELL)) {
        net = net - resistance(a, q, v, pierced);
    }
    for (int i = 0; i < HUNG_OF(a); i++) {
        net = net + pulls[i];
    }
    double motor = net * a->inverse_mass;
    if (FLOOR_OF(a)) {
        motor = motor - floor, b = b - floor;
    }
    *of_load = b;
    return !HAS(a, BRISTLE) && sign == 0.0 ? 0.0 : motor;
}

static motion step(axis *a, const motion *at, double time, double external, double command, double sign, double h) {
    double pull[3], scale[3], floor[3];
    along(a, at, time, external, command, h, pull, scale, floor);
    double q0 = at->position, v0 = at->velocity, y0 = at->load_position, u0 = at->load_velocity;
    double state[4] = {q0, v0, y0, u0};
    double before = HAS(a, BRISTLE) ? limit_at(a, v0) : 0.0, z = at->bristle, limit = before, turn = 0.0;
    double speeds = 0.0, accelerations = 0.0, load_speeds = 0.0, load_accelerations = 0.0;
    double hung[HUNG][2], sums[HUNG][2] = {{0.0}}, pulls[HUNG], rates[HUNG][2];
    int n_hung = HUNG_OF(a);
    for (int i = 0; i < n_hung; i++) {
        hung[i][0] = at->hung[i][0], hung[i][1] = at->hung[i][1];
    }
    for (int stage = 0; stage < 4; stage++) {
        int where = stage == 0 ? 0 : stage == 3 ? 2 : 1;
        double b, weight = where == 1 ? 2.0 : 1.0;
        for (int i = 0; i < n_hung; i++) {
            pulls[i] = a->hung_stiffness[i] * (hung[i][0] - state[0]) + a->hung_damping[i] * (hung[i][1] - state[1]);
        }
        double motor =
            acceleration(a, at->pierced, state, z, limit, sign, pull[where], scale[where], floor[where], pulls, &b);
        for (int i = 0; i < n_hung; i++) {
            double c = -pulls[i] * a->inverse_hung[i];
            rates[i][0] = hung[i][1], rates[i][1] = FLOOR_OF(a) ? c - floor[where] : c;
            sums[i][0] = sums[i][0] + weight * rates[i][0], sums[i][1] = sums[i][1] + weight * rates[i][1];
        }
        turn = stage == 0 ? motor : stage == 3 ? turn - motor : turn;
        speeds = speeds + weight * state[1];
        accelerations = accelerations + weight * motor;
        if (HAS(a, MODE)) {
            load_speeds = load_speeds + weight * state[3];
            load_accelerations = load_accelerations + weight * b;
        }
        if (stage == 3) {
            break;
        }
        double ahead = stage == 2 ? h : 0.5 * h;
        if (HAS(a, MODE)) {
            state[2] = y0 + ahead * state[3], state[3] = u0 + ahead * b;
        }
        for (int i = 0; i < n_hung; i++) {
            hung[i][0] = at->hung[i][0] + ahead * rates[i][0], hung[i][1] = at->hung[i][1] + ahead * rates[i][1];
        }
        state[0] = q0 + ahead * state[1], state[1] = v0 + ahead * motor;
        if (SLIPS_OF(a)) {
            double bent[SLIPS];
            z = slip(a, at->slip, v0, state[0] - q0, state[1], ahead, bent);
            limit = limit_at(a, state[1]);
        } else if (HAS(a, BRISTLE)) {
            z = bend(a, at->bristle, before, v0, state[0] - q0, state[1], ahead, &limit);
        }
    }
    double sixth = h * (1.0 / 6.0);
    motion end = *at;
    end.position = q0 + sixth * speeds, end.velocity = v0 + sixth * accelerations;
    end.load_position = HAS(a, MODE) ? y0 + sixth * load_speeds : end.position;
    end.load_velocity = HAS(a, MODE) ? u0 + sixth * load_accelerations : end.velocity;
    for (int i = 0; i < HUNG; i++) {
        end.hung[i][0] = i < n_hung ? at->hung[i][0] + sixth * sums[i][0] : end.position;
        end.hung[i][1] = i < n_hung ? at->hung[i][1] + sixth * sums[i][1] : end.velocity;
    }
    double moved = end.position - q0;
    if (SLIPS_OF(a)) {
        end.bristle = slip(a, at->slip, v0, moved, end.velocity, h, end.slip);
    } else if (HAS(a, BRISTLE)) {
        end.bristle = bent(a, at->bristle, before, v0, moved, end.velocity, turn, h);
    }
    if (HAS(a, CABLE)) {
        end.cable = strained(a, at, moved);
    }
    end.force = command;
    if (HAS(a, LAG)) {
        prepare_lag(a, h);
        end.force = command + (at->force - command) * a->lag_left;
    }
    end.played = HAS(a, BACKLASH) ? play(a, at, end.load_position, end.load_velocity, h) : end.load_position;
    a->steps += 1.0;
    return end;
}
