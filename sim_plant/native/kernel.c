/* Time passing for the axes of a stage: the loops of effort, events.py, real_axis.py, disturbance.py and encoder.py.
 *
 * Where Python would raise (a division by zero, a root of less than zero) or a number is no longer finite, an axis is
 * left as it was and reported: Python then takes it over from there. */
#include "dynamics.h"

enum { MAX_EVENTS = 8, MAX_ITERATIONS = 60 };

static const double COUNTS[] = {1,  2,  3,   4,   5,  6,   8,   12,  16,  24,   32,  48,
                                64, 96, 128, 192, 256, 384, 512, 768, 1024, 1536};
enum { N_COUNTS = sizeof COUNTS / sizeof *COUNTS };

#define MODE_STEP 0.28
#define BRISTLE_STEP 0.19
#define TURN_STEP 1e-8
#define MODE_LEAST 0.01
#define BRISTLE_RING 1.2e4
#define BRISTLE_BENT 4.0
#define BRISTLE_LEAST 0.001
#define BREAKING_LOOSE 0.3
#define MOST_TURN_STEPS 16.0
#define PEAK_STEP 0.08
#define SLOPE_BROKEN 4.0
#define STICKING 0.999

static double sticking(const axis *a, double towards) {
    double stuck = 0.0;
    for (int i = 0; i < SLIPS_OF(a); i++) {
        double end = STICKING * a->presliding * a->slip_reach[i];
        stuck = stuck + (towards * a->at.slip[i] < end ? a->slip_weight[i] : 0.0);
    }
    return stuck;
}

static double effort(const axis *a, double external, double command, double h) {
    const motion *at = &a->at;
    double drive = external + command, speed = fabs(at->velocity), push = 0.0;
    double pull = a->mode_stiffness * fabs(at->load_position - at->position) + a->cable_stiffness * fabs(at->position);
    for (int i = 0; i < HUNG_OF(a); i++) {
        pull = pull + a->hung_stiffness[i] * fabs(at->hung[i][0] - at->position);
    }
    if (HAS(a, BRISTLE)) {
        push = fabs(drive - a->stiffness * at->bristle);
        pull = pull + push + BREAKING_LOOSE * a->coulomb;
    } else {
        pull = pull + fabs(drive) + a->coulomb + a->stribeck;
    }
    if (HAS(a, LAG)) {
        pull = pull + fabs(at->force - command);
    }
    double reach = h * (pull + a->amplitudes) * a->inverse_mass, fastest = speed + reach;
    double work = h * (a->rate + fastest * a->speed_rate);
    if (HAS(a, MODE)) {
        double swing = fabs(at->load_position - at->position) + a->ring_time * fabs(at->load_velocity - at->velocity);
        work = greater(work, h * a->ring_rate * sqrt(sqrt(greater(swing * a->ring_scale, MODE_LEAST))));
    }
    for (int i = 0; i < HUNG_OF(a); i++) {
        const double *p = at->hung[i];
        double swing = fabs(p[0] - at->position) + a->hung_time[i] * fabs(p[1] - at->velocity);
        work = greater(work, h * a->hung_rate[i] * sqrt(sqrt(greater(swing * a->hung_scale[i], MODE_LEAST))));
    }
    if (HAS(a, STRIBECK)) {
        double nearest = speed - reach;
        nearest = 0.5 * (nearest + fabs(nearest));
        double resolved = reach * a->slowness / (1.0 + nearest * a->slowness);
        work = greater(work, (0.5 / PEAK_STEP) * resolved);
    }
    if (HAS(a, BRISTLE)) {
        double towards = direction(at->velocity), openness = fabs(1.0 - towards * at->bristle * a->inverse_limit);
        if (SLIPS_OF(a)) {
            openness = SLOPE_BROKEN * sticking(a, towards);
        }
        openness = speed <= reach ? 2.0 : openness;
        double rushing = fastest * a->inverse_limit, held = h * BREAKING_LOOSE * a->coulomb * a->inverse_mass;
        double bend = at->bristle * a->inverse_limit;
        double turns = sqrt(speed <= reach ? bend * bend * fabs(reach - held) * h * (1.0 / TURN_STEP) : 0.0);
        work = greater(work, turns > MOST_TURN_STEPS ? MOST_TURN_STEPS : turns);
        double swing = push * a->compliance + speed * a->stuck_time, part = swing * a->inverse_limit;
        double ring = greater(greater(swing * BRISTLE_RING, BRISTLE_BENT * part * part), BRISTLE_LEAST);
        ring = sqrt(sqrt(ring > 1.0 ? 1.0 : ring));
        work = greater(work, (h / BRISTLE_STEP) * ring * sqrt(openness * (a->stuck_rate + rushing * rushing)));
    }
    return work;
}

/* What ends a step early, and the state it begins at. */
typedef struct {
    axis *a;
    motion at;
    double time, external, command, sign;
    int cell; /* the membrane's transition; else a stop or a breakaway */
} event;

static motion after(const event *e, double tau) {
    return step(e->a, &e->at, e->time, e->external, e->command, e->sign, tau);
}

static double due(const event *e, const motion *at, double tau) {
    if (e->cell) {
        return transition(e->a, at);
    }
    if (e->sign != 0.0) {
        return -e->sign * at->velocity;
    }
    double hold, net = load_on_motor(e->a, at, e->time + tau, e->external, e->command, &hold);
    return fabs(net) - hold;
}

static double first_instant(const event *e, double latest, motion *found) {
    double low = 0.0, high = latest, below = due(e, &e->at, 0.0);
    *found = after(e, latest);
    double above = due(e, found, latest);
    below = 0.0 < below ? 0.0 : below;
    for (int i = 0; i < MAX_ITERATIONS; i++) {
        if (high - low <= 1e-15 * latest) {
            break;
        }
        double tau = i % 3 < 2 ? high - (high - low) * (above / (above - below)) : 0.5 * (low + high);
        if (!(low < tau && tau < high)) {
            tau = 0.5 * (low + high);
        }
        motion there = after(e, tau);
        double value = due(e, &there, tau);
        if (value > 0.0) {
            high = tau, above = value, *found = there;
            below *= 0.5;
        } else {
            low = tau, below = value;
            above *= 0.5;
        }
    }
    return high;
}

static double sign_of(const axis *a, const motion *at, double time, double external, double command) {
    if (HAS(a, BRISTLE)) {
        return 1.0;
    }
    if (at->velocity != 0.0) {
        return at->velocity > 0.0 ? 1.0 : -1.0;
    }
    double hold, net = load_on_motor(a, at, time, external, command, &hold);
    return net > hold ? 1.0 : net < -hold ? -1.0 : 0.0;
}

static motion advance_step(axis *a, motion at, double time, double external, double command, double h) {
    double left = h;
    for (int i = 0; i < MAX_EVENTS; i++) {
        event e = {a, at, time, external, command, sign_of(a, &at, time, external, command), 0};
        motion end = after(&e, left);
        double tau = left;
        if (!HAS(a, BRISTLE) && due(&e, &end, left) > 0.0) {
            if (e.sign != 0.0 && at.velocity == 0.0) {
                return step(a, &at, time, external, command, 0.0, left);
            }
            tau = first_instant(&e, left, &end);
            if (e.sign != 0.0) {
                end.velocity = 0.0;
                if (!HAS(a, MODE)) {
                    end.load_velocity = 0.0;
                }
            }
        }
        e.cell = HAS(a, CELL);
        if (e.cell && transition(a, &end) > 0.0) {
            tau = first_instant(&e, tau, &end);
            end.pierced = 1.0 - end.pierced;
        }
        at = end, time = time + tau, left = left - tau;
        if (left <= 0.0) {
            break;
        }
    }
    return at;
}

static void piece(axis *a, double time, double external, double h) {
    double work = effort(a, external, a->command, h);
    int i = 0;
    while (i < N_COUNTS - 1 && COUNTS[i] < work) {
        i++;
    }
    int count = (int)COUNTS[i], smooth = HAS(a, BRISTLE) && !HAS(a, CELL);
    double part = h / count;
    for (int index = 0; index < count; index++) {
        double begin = time + index * part;
        a->at = smooth ? step(a, &a->at, begin, external, a->command, 1.0, part)
                       : advance_step(a, a->at, begin, external, a->command, part);
    }
}

static void remember(axis *a, double time) {
    int n = (int)a->n_past;
    if (n == KEPT) {
        for (int i = 1; i < KEPT; i++) {
            a->past[i - 1] = a->past[i];
        }
        n--;
    }
    a->past[n] = (point){time, a->at.position, a->at.velocity};
    a->n_past = n + 1;
}

static void pieces(axis *a, double begin, double h, int count, int64_t before) {
    for (int index = 0; index < count; index++) {
        double time = begin + index * h, external = a->constant;
        remember(a, time);
        if (HAS(a, NOISY)) {
            double span = sqrt(h);
            uint64_t number = (uint64_t)(before + index);
            a->at.walked = a->at.walked + a->walk * span * normal(a->walk_key, number);
            external = external + (a->at.walked + a->noise / sqrt(2.0 * h) * normal(a->noise_key, number));
        }
        piece(a, time, external, h);
    }
}

static int is_finite(const motion *at) {
    double sum = at->position + at->velocity + at->load_position + at->load_velocity + at->bristle + at->cable;
    sum += at->force + at->played + at->walked;
    for (int i = 0; i < HUNG; i++) {
        sum += at->hung[i][0] + at->hung[i][1];
    }
    for (int i = 0; i < SLIPS; i++) {
        sum += at->slip[i];
    }
    return sum - sum == 0.0;
}

/* Bytes of an axis: Python compares them with its own layout. */
int64_t hil_size_of_axis(void) { return sizeof(axis); }

/* Advance axes by `count` pieces of h seconds from `begin` (s); `before`: pieces before. Returns how many of them are
 * as they were, because Python has to do it; those have steps = -1. `steps` is
 * how many this took otherwise. */
int64_t hil_advance(axis *axes, int64_t n, double begin, double h, int64_t count, int64_t before) {
    int64_t left = 0;
    for (int64_t i = 0; i < n; i++) {
        axes[i].steps = 0.0;
        axis kept = axes[i];
        feclearexcept(FE_DIVBYZERO | FE_INVALID);
        pieces(&axes[i], begin, h, (int)count, before);
        if (fetestexcept(FE_DIVBYZERO | FE_INVALID) || !is_finite(&axes[i].at)) {
            axes[i] = kept;
            axes[i].steps = -1.0;
            left++;
        }
    }
    return left;
}

static double delayed(const axis *a, double now) {
    double t1 = now, q1 = a->at.position, v1 = a->at.velocity, shown = q1;
    for (int i = (int)a->n_past - 1; i >= 0; i--) {
        if (!(a->encoder_latency > now - t1)) {
            break;
        }
        double t0 = a->past[i].time, q0 = a->past[i].position, v0 = a->past[i].velocity;
        double h = t1 - t0, s = (now - a->encoder_latency - t0) / h;
        s = s < 0.0 ? 0.0 : s;
        double r = 1.0 - s;
        shown = r * r * (q0 * (1.0 + 2.0 * s) + h * s * v0) + s * s * (q1 * (1.0 + 2.0 * r) - h * r * v1);
        t1 = t0, q1 = q0, v1 = v0;
    }
    return shown;
}

/* What the encoder shows at `now` (s); `read`: samples before. */
double hil_show(const axis *a, double now, int64_t read) {
    double shown = a->encoder_latency != 0.0 ? delayed(a, now) : a->at.position;
    if (a->encoder_error != 0.0) {
        double sine, cosine;
        sincos_turns(shown * a->encoder_wavenumber, &sine, &cosine);
        shown = shown + a->encoder_error * sine;
    }
    if (a->encoder_noise != 0.0) {
        shown = shown + a->encoder_noise * normal(a->encoder_key, (uint64_t)read);
    }
    return shown;
}
