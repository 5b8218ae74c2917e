/* The tick of `hil run` as a C programmer would write it: the yardstick of `make bench ARGS=tick`.
 *
 * Joins the local bus by its rules (drivers/bus/local_medium.py: connect to every listening socket, send "hil1" and a
 * queue depth, count up), then, at absolute deadlines: receive the drives' feedback, check and decode it (stage_fd), one three-state
 * constant-gain Kalman filter per axis with look-ahead, PD plus feedforward with friction, clamp and rate limit, encode,
 * send. Same sockets, same frames, same arithmetic. It never sets an enable bit, so the drives do not act on its torque.
 *
 * tick BUS_DIRECTORY TICKS PERIOD_NS CPU PRIORITY HOST_ID FEEDBACK_ID AXES LIMIT_N
 * Output: one line per tick: CPU time of the tick from wake to send (ns), CPU time of the whole period (ns), wake
 * lateness (ns), frames accepted.
 */
#define _GNU_SOURCE
#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <sched.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <time.h>
#include <unistd.h>

#include "real_time.h"

#define MAX_AXES 4
#define MAX_LINKS 8
#define SECOND 1000000000LL

struct canfd_frame_bytes {
    uint32_t can_id;
    uint8_t length, flags, reserved0, reserved1;
    uint8_t data[64];
};

struct feedback {
    int32_t position;
    uint32_t sample_time;
    uint16_t status, sequence;
    uint32_t checksum;
} __attribute__((packed));

struct command {
    float force[MAX_AXES];
    uint16_t sequence, flags;
    uint32_t checksum;
} __attribute__((packed));

struct axis {
    double resolution, mass, coulomb, viscous, quadratic, kp, kd, limit, step;
    double gain[3], state[3], target, force, net;
    int64_t stamp;
};

struct sample {
    long long tick_ns, period_ns, late_ns;
    int accepted;
};

static uint32_t crc_table[256];

static void make_crc_table(void)
{
    for (uint32_t i = 0; i < 256; i++) {
        uint32_t c = i;
        for (int k = 0; k < 8; k++)
            c = c & 1 ? 0xEDB88320u ^ (c >> 1) : c >> 1;
        crc_table[i] = c;
    }
}

/* zlib.crc32 with a start value */
static uint32_t crc32_from(uint32_t start, const uint8_t *data, size_t length)
{
    uint32_t c = ~start;
    while (length--)
        c = crc_table[(c ^ *data++) & 0xFF] ^ (c >> 8);
    return ~c;
}

static long long read_clock(clockid_t clock)
{
    struct timespec now;
    clock_gettime(clock, &now);
    return now.tv_sec * SECOND + now.tv_nsec;
}

static void die(const char *what)
{
    perror(what);
    exit(1);
}

static int connect_member(const char *directory, const char *name)
{
    struct sockaddr_un address = {.sun_family = AF_UNIX};
    if (snprintf(address.sun_path, sizeof address.sun_path, "%s/%s", directory, name) >= (int)sizeof address.sun_path)
        return -1;
    int fd = socket(AF_UNIX, SOCK_SEQPACKET | SOCK_NONBLOCK, 0);
    if (fd < 0 || connect(fd, (struct sockaddr *)&address, sizeof address) < 0) {
        close(fd);
        return -1;
    }
    struct { char mark[4]; uint32_t depth; } handshake = {{'h', 'i', 'l', '1'}, 64};
    if (send(fd, &handshake, sizeof handshake, MSG_NOSIGNAL) < 0)
        die("handshake");
    return fd;
}

/* Under the channel's lock: connect to every member, then count up in the lock file, so that the others look at theirs. */
static int join_bus(const char *directory, int *links)
{
    int count = 0;
    char path[4096];
    snprintf(path, sizeof path, "%s/lock", directory);
    int lock = open(path, O_RDWR);
    uint64_t *joined = lock < 0 ? MAP_FAILED : mmap(NULL, sizeof *joined, PROT_READ | PROT_WRITE, MAP_SHARED, lock, 0);
    if (joined == MAP_FAILED || flock(lock, LOCK_EX))
        die(path);
    DIR *entries = opendir(directory);
    if (!entries)
        die(directory);
    for (struct dirent *entry; (entry = readdir(entries)) && count < MAX_LINKS;) {
        size_t length = strlen(entry->d_name);
        if (length > 5 && !strcmp(entry->d_name + length - 5, ".sock")) {
            int fd = connect_member(directory, entry->d_name);
            if (fd >= 0)
                links[count++] = fd;
        }
    }
    closedir(entries);
    ++*joined;
    flock(lock, LOCK_UN);
    return count;
}

static void set_up(struct axis *axes, int n, double period, double limit)
{
    for (int i = 0; i < n; i++) {
        axes[i] = (struct axis){.resolution = 1e-7, .mass = 0.02, .coulomb = 0.2, .viscous = 0.04, .quadratic = 0.002,
                                .kp = 1000, .kd = 5, .limit = limit, .step = 10000 * period,
                                .gain = {0.6, 0.3 / period, -0.02}, .target = NAN};
    }
}

static int take(const struct canfd_frame_bytes *frame, ssize_t size, struct axis *axes, int n, uint32_t feedback_id,
                uint16_t sequence, double period)
{
    uint32_t i = frame->can_id - feedback_id;
    struct feedback in;
    if (size != (ssize_t)sizeof *frame || i >= (uint32_t)n || frame->length != sizeof in)
        return 0;
    memcpy(&in, frame->data, sizeof in);
    if (crc32_from(frame->can_id, frame->data, sizeof in - 4) != in.checksum || in.sequence != sequence)
        return 0;
    struct axis *axis = &axes[i];
    double measured = in.position * axis->resolution;
    if (isnan(axis->target)) {
        axis->target = axis->state[0] = measured;
    }
    axis->stamp = in.sample_time;
    double change = (axis->net - axis->state[2]) / axis->mass * period;
    axis->state[0] += (axis->state[1] + 0.5 * change) * period;
    axis->state[1] += change;
    double innovation = measured - axis->state[0];
    for (int k = 0; k < 3; k++)
        axis->state[k] += axis->gain[k] * innovation;
    return 1;
}

static double law(struct axis *axis, double now, double period)
{
    double omega = 3.14159, amplitude = 1e-3; /* a setpoint that moves, so that nothing is folded away */
    double position = axis->target + amplitude * (1 - cos(omega * now));
    double velocity = amplitude * omega * sin(omega * now), acceleration = amplitude * omega * omega * cos(omega * now);
    double change = (axis->net - axis->state[2]) / axis->mass * period;
    double ahead_position = axis->state[0] + (axis->state[1] + 0.5 * change) * period;
    double ahead_velocity = axis->state[1] + change;
    double friction = copysign(axis->coulomb, velocity) + axis->viscous * velocity
                      + axis->quadratic * velocity * fabs(velocity);
    double asked = axis->kp * (position - ahead_position) + axis->kd * (velocity - ahead_velocity)
                   + axis->mass * acceleration + friction;
    double force = fmin(fmax(asked, axis->force - axis->step), axis->force + axis->step);
    force = fmin(fmax(force, -axis->limit), axis->limit);
    axis->force = force;
    axis->net = force - friction;
    return force;
}

static void send_command(const int *links, int n_links, struct axis *axes, int n, uint16_t sequence, uint32_t host_id,
                         double now, double period)
{
    struct command out = {.sequence = sequence};
    for (int i = 0; i < n; i++)
        out.force[i] = (float)law(&axes[i], now, period);
    struct canfd_frame_bytes frame = {.can_id = host_id, .length = sizeof out, .flags = 0x05}; /* FDF, BRS */
    out.checksum = crc32_from(host_id, (uint8_t *)&out, sizeof out - 4);
    memcpy(frame.data, &out, sizeof out);
    for (int i = 0; i < n_links; i++)
        send(links[i], &frame, sizeof frame, MSG_NOSIGNAL);
}

int main(int argc, char **argv)
{
    if (argc != 10) {
        fprintf(stderr, "usage: tick BUS_DIRECTORY TICKS PERIOD_NS CPU PRIORITY HOST_ID FEEDBACK_ID AXES LIMIT_N\n");
        return 2;
    }
    int ticks = atoi(argv[2]), n = atoi(argv[8]), links[MAX_LINKS];
    long long period_ns = atoll(argv[3]);
    uint32_t host_id = strtoul(argv[6], NULL, 0), feedback_id = strtoul(argv[7], NULL, 0);
    double period = period_ns * 1e-9;
    struct axis axes[MAX_AXES];
    struct sample *samples = calloc(ticks, sizeof *samples);
    if (!samples || n < 1 || n > MAX_AXES)
        return 2;
    make_crc_table();
    set_up(axes, n, period, atof(argv[9]));
    int n_links = join_bus(argv[1], links);
    if (!n_links) {
        fprintf(stderr, "%s: nobody on this bus\n", argv[1]);
        return 1;
    }
    become_real_time(atoi(argv[4]), atoi(argv[5]));

    long long start = read_clock(CLOCK_MONOTONIC), deadline = start, mark = read_clock(CLOCK_THREAD_CPUTIME_ID);
    for (int tick = 0; tick < ticks; tick++) {
        deadline += period_ns;
        struct timespec until = {deadline / SECOND, deadline % SECOND};
        while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, NULL) == EINTR)
            ;
        long long woke = read_clock(CLOCK_MONOTONIC), began = read_clock(CLOCK_THREAD_CPUTIME_ID);
        struct canfd_frame_bytes frame;
        int accepted = 0;
        for (int i = 0; i < n_links; i++)
            for (ssize_t size; (size = recv(links[i], &frame, sizeof frame, MSG_DONTWAIT)) > 0;)
                accepted += take(&frame, size, axes, n, feedback_id, (uint16_t)(tick - 1), period);
        send_command(links, n_links, axes, n, (uint16_t)tick, host_id, (woke - start) * 1e-9, period);
        long long ended = read_clock(CLOCK_THREAD_CPUTIME_ID);
        samples[tick] = (struct sample){ended - began, ended - mark, woke - deadline, accepted};
        mark = ended;
        if (woke - deadline > period_ns / 2) /* skip what was lost, never catch up */
            deadline += (woke - deadline) / period_ns * period_ns + period_ns;
    }
    for (int tick = 0; tick < ticks; tick++)
        printf("%lld %lld %lld %d\n", samples[tick].tick_ns, samples[tick].period_ns, samples[tick].late_ns,
               samples[tick].accepted);
    return 0;
}
