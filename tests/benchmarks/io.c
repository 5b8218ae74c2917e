/* One tick's I/O of the bus layer in C: the yardstick of `make bench ARGS=io`.
 *
 * The same system calls on the same kind of socket as drivers/bus/port.py makes them on the local bus: one recvmmsg that
 * takes the four feedback frames with their time stamps, clock readings to bring the stamps to CLOCK_MONOTONIC, one
 * send. The frames are copied out, as a caller would need them.
 *
 * io TICKS
 * Output: CPU time per tick (ns) as min, median and max over the ticks, the cost of reading the CPU clock taken off.
 */
#define _GNU_SOURCE
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>

#define SLOTS 32
#define FEEDBACK_FRAMES 4
#define FRAME_BYTES 72
#define CONTROL_BYTES 64
#define CLOCK_READINGS 1000
#define SECOND 1000000000LL

struct frame {
    uint32_t can_id;
    uint8_t length, flags, reserved[2];
    uint8_t data[64];
};

struct received {
    struct frame frame;
    int64_t timestamp_ns;
};

static struct frame slots[SLOTS];
static char control[SLOTS][CONTROL_BYTES] __attribute__((aligned(8)));
static struct iovec vectors[SLOTS];
static struct mmsghdr headers[SLOTS];

static int64_t read_clock(clockid_t clock)
{
    struct timespec t;
    clock_gettime(clock, &t);
    return t.tv_sec * SECOND + t.tv_nsec;
}

static void check(int result, const char *what)
{
    if (result < 0) {
        perror(what);
        exit(1);
    }
}

static int64_t stamp_of(struct msghdr *header)
{
    struct cmsghdr *message = CMSG_FIRSTHDR(header);
    struct timespec t;
    if (!message || message->cmsg_type != SO_TIMESTAMPNS)
        return 0;
    memcpy(&t, CMSG_DATA(message), sizeof t);
    return t.tv_sec * SECOND + t.tv_nsec;
}

static int drain(int link, int64_t previous_ns, struct received *out)
{
    int64_t wall = read_clock(CLOCK_REALTIME), now = read_clock(CLOCK_MONOTONIC), offset = wall - now;
    int count = recvmmsg(link, headers, SLOTS, MSG_DONTWAIT, NULL);
    now = read_clock(CLOCK_MONOTONIC);
    for (int i = 0; i < count; i++) {
        int64_t stamp = stamp_of(&headers[i].msg_hdr) - offset;
        out[i].frame = slots[i];
        out[i].timestamp_ns = stamp < previous_ns ? previous_ns : stamp > now ? now : stamp;
        headers[i].msg_hdr.msg_controllen = CONTROL_BYTES;
    }
    return count;
}

static int by_value(const void *a, const void *b)
{
    int64_t x = *(const int64_t *)a, y = *(const int64_t *)b;
    return (x > y) - (x < y);
}

int main(int argc, char **argv)
{
    int ticks = argc > 1 ? atoi(argv[1]) : 1000, on = 1, pair[2];
    int64_t *cost = calloc(ticks, sizeof *cost), previous = 0, readings[CLOCK_READINGS];
    struct received frames[SLOTS];
    struct frame command = {.can_id = 0x080, .length = 24, .flags = 5}, feedback = {.length = 16, .flags = 5}, sent;

    check(socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_NONBLOCK, 0, pair), "socketpair");
    check(setsockopt(pair[0], SOL_SOCKET, SO_TIMESTAMPNS, &on, sizeof on), "SO_TIMESTAMPNS");
    for (int i = 0; i < SLOTS; i++) {
        vectors[i] = (struct iovec){&slots[i], FRAME_BYTES};
        headers[i].msg_hdr.msg_iov = &vectors[i];
        headers[i].msg_hdr.msg_iovlen = 1;
        headers[i].msg_hdr.msg_control = control[i];
        headers[i].msg_hdr.msg_controllen = CONTROL_BYTES;
    }
    for (int i = 0; i < CLOCK_READINGS; i++) {
        int64_t start = read_clock(CLOCK_THREAD_CPUTIME_ID);
        readings[i] = read_clock(CLOCK_THREAD_CPUTIME_ID) - start;
    }
    qsort(readings, CLOCK_READINGS, sizeof *readings, by_value);
    int64_t clock_cost = readings[CLOCK_READINGS / 2];
    for (int tick = 0; tick < ticks; tick++) {
        for (int axis = 0; axis < FEEDBACK_FRAMES; axis++) {
            feedback.can_id = 0x100 + axis;
            check(send(pair[1], &feedback, FRAME_BYTES, 0), "feedback");
        }
        int64_t start = read_clock(CLOCK_THREAD_CPUTIME_ID);
        int count = drain(pair[0], previous, frames);
        previous = read_clock(CLOCK_MONOTONIC);
        memcpy(command.data, &tick, sizeof tick);
        ssize_t written = send(pair[0], &command, FRAME_BYTES, MSG_NOSIGNAL);
        cost[tick] = read_clock(CLOCK_THREAD_CPUTIME_ID) - start - clock_cost;
        if (count != FEEDBACK_FRAMES || written != FRAME_BYTES || frames[3].frame.can_id != 0x103) {
            fprintf(stderr, "tick %d: received %d, sent %zd bytes\n", tick, count, written);
            return 1;
        }
        check(recv(pair[1], &sent, sizeof sent, 0), "command");
    }
    qsort(cost, ticks, sizeof *cost, by_value);
    printf("%lld %lld %lld\n", (long long)cost[0], (long long)cost[ticks / 2], (long long)cost[ticks - 1]);
    return 0;
}
