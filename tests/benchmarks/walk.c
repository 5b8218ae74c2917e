/* A program that walks over memory: what the host makes of a thread that sleeps, wakes and touches as much as a tick.
 *
 * After each absolute deadline it follows a ring of LINES cache lines on PAGES pages, as many as a tick of the compiled
 * loop touches (docs/what-costs-what.md), and adds to each: no system call, no page fault, no interpreter. How many steps fill WORK_NS of CPU time is found out beforehand, paced as well. What its slowest periods
 * take longer than its median, and the slots that it runs over with its own CPU time, are stops of the core that the
 * host does not report as stolen.
 *
 * walk PERIODS PERIOD_NS CPU PRIORITY WORK_NS
 * Output: one line per period: CPU time of the walk (ns), CPU time from that wake to the next one (ns), slots skipped
 * at the next one.
 */
#define _GNU_SOURCE
#include <fcntl.h>
#include <sched.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

#include "real_time.h"

#define SECOND 1000000000LL
#define TRIALS 500
#define PAGES 600
#define LINES 3100
#define PAGE 4096
#define LINE 64
#define STEPS 20 /* between two looks at the clock, in the trials */

static long long read_clock(clockid_t clock)
{
    struct timespec now;
    clock_gettime(clock, &now);
    return now.tv_sec * SECOND + now.tv_nsec;
}

struct line {
    struct line *next;
    uint64_t visits;
};

static char memory[PAGES * PAGE] __attribute__((aligned(PAGE)));
static struct line *at;

/* A ring of lines, some of every page, shuffled (Fisher and Yates) by a generator that is the same everywhere. */
static void lay_out(void)
{
    static struct line *lines[LINES];
    uint64_t state = 1;
    for (int i = 0; i < LINES; i++) {
        int in_page = (i / PAGES * 11 + i % PAGES * 7) % (PAGE / LINE); /* another line of its page each time round */
        state = state * 6364136223846793005ULL + 1442695040888963407ULL; /* Knuth's MMIX */
        int other = (state >> 33) % (i + 1);
        lines[i] = lines[other];
        lines[other] = (struct line *)(memory + i % PAGES * PAGE + in_page * LINE);
    }
    for (int i = 0; i < LINES; i++)
        lines[i]->next = lines[(i + 1) % LINES];
    at = lines[0];
}

static void walk(long steps)
{
    struct line *line = at;
    for (; steps > 0; steps--) {
        line->visits++;
        line = line->next;
    }
    at = line;
}

/* How many steps such a time takes, ns. */
static long walk_for(long long time)
{
    long made = 0;
    for (long long end = read_clock(CLOCK_MONOTONIC) + time; read_clock(CLOCK_MONOTONIC) < end; made += STEPS)
        walk(STEPS);
    return made;
}

static int ascending(const void *a, const void *b)
{
    long x = *(const long *)a, y = *(const long *)b;
    return (x > y) - (x < y);
}

struct period {
    long long walk_ns, cpu_ns, skipped;
};

static long steps_in[TRIALS];

/* So many periods of so many steps, or, in the trials (steps < 0), of so long a time. */
static void run(struct period *log, long periods, long long period, long steps, long long time)
{
    long long deadline = read_clock(CLOCK_MONOTONIC), woke_cpu = 0;
    for (long i = -1; i < periods; i++) {
        long long skipped = (read_clock(CLOCK_MONOTONIC) - deadline) / period;
        deadline += (skipped + 1) * period;
        struct timespec until = {deadline / SECOND, deadline % SECOND};
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, NULL);
        long long late = (read_clock(CLOCK_MONOTONIC) - deadline) / period, cpu = read_clock(CLOCK_THREAD_CPUTIME_ID);
        deadline += late * period;
        if (i >= 0) {
            log[i].cpu_ns = cpu - woke_cpu;
            log[i].skipped = skipped + late;
        }
        woke_cpu = cpu;
        if (i + 1 == periods)
            return;
        if (steps < 0)
            steps_in[i + 1] = walk_for(time);
        else
            walk(steps);
        log[i + 1].walk_ns = read_clock(CLOCK_THREAD_CPUTIME_ID) - cpu;
    }
}

int main(int count, char **arguments)
{
    if (count != 6) {
        fprintf(stderr, "usage: walk PERIODS PERIOD_NS CPU PRIORITY WORK_NS\n");
        return 2;
    }
    long periods = atol(arguments[1]);
    long long period = atoll(arguments[2]);
    struct period *log = calloc(periods > TRIALS ? periods : TRIALS, sizeof *log);
    if (!log || periods < 1 || period < 1)
        return 2;
    lay_out();
    become_real_time(atoi(arguments[3]), atoi(arguments[4]));
    run(log, TRIALS, period, -1, atoll(arguments[5]));
    qsort(steps_in, TRIALS, sizeof *steps_in, ascending);
    run(log, periods, period, steps_in[TRIALS / 2], 0);
    for (long i = 0; i < periods; i++)
        printf("%lld %lld %lld\n", log[i].walk_ns, log[i].cpu_ns, log[i].skipped);
    return 0;
}
