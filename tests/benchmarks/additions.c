/* A program that adds: what the host makes of a thread that sleeps, wakes and computes as `hil run` does.
 *
 * After each absolute deadline it makes the same number of additions, in registers: no system call, no memory, no
 * interpreter. How many fill WORK_NS of CPU time is found out beforehand, paced as well. What its slowest periods take
 * longer than its median, and the slots that it runs over with its own CPU time, are stops of the core that the host
 * does not report as stolen.
 *
 * additions PERIODS PERIOD_NS CPU PRIORITY WORK_NS
 * Output: one line per period: CPU time of the additions (ns), CPU time from that wake to the next one (ns), slots
 * skipped at the next one.
 */
#define _GNU_SOURCE
#include <sched.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <time.h>

#define SECOND 1000000000LL
#define TRIALS 500
#define ADDITIONS 500 /* between two looks at the clock, in the trials */

static long long read_clock(clockid_t clock)
{
    struct timespec now;
    clock_gettime(clock, &now);
    return now.tv_sec * SECOND + now.tv_nsec;
}

static void add(long additions)
{
    uint64_t sum = 0;
    for (long i = 0; i < additions; i++) {
        sum += i;
        __asm__ volatile("" : "+r"(sum)); /* one after the other, and all of them */
    }
}

/* How many additions such a time takes, ns. */
static long add_for(long long time)
{
    long made = 0;
    for (long long end = read_clock(CLOCK_MONOTONIC) + time; read_clock(CLOCK_MONOTONIC) < end; made += ADDITIONS)
        add(ADDITIONS);
    return made;
}

static int ascending(const void *a, const void *b)
{
    long x = *(const long *)a, y = *(const long *)b;
    return (x > y) - (x < y);
}

static void become_real_time(int cpu, int priority)
{
    cpu_set_t set;
    CPU_ZERO(&set);
    CPU_SET(cpu, &set);
    if (sched_setaffinity(0, sizeof set, &set))
        perror("sched_setaffinity");
    struct sched_param parameter = {.sched_priority = priority};
    if (priority && sched_setscheduler(0, SCHED_FIFO | SCHED_RESET_ON_FORK, &parameter))
        perror("sched_setscheduler");
    if (mlockall(MCL_CURRENT | MCL_FUTURE))
        perror("mlockall");
}

struct period {
    long long adding_ns, cpu_ns, skipped;
};

static long additions_in[TRIALS];

/* So many periods of so many additions, or, in the trials (additions < 0), of so long a time. */
static void run(struct period *log, long periods, long long period, long additions, long long time)
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
        if (additions < 0)
            additions_in[i + 1] = add_for(time);
        else
            add(additions);
        log[i + 1].adding_ns = read_clock(CLOCK_THREAD_CPUTIME_ID) - cpu;
    }
}

int main(int count, char **arguments)
{
    if (count != 6) {
        fprintf(stderr, "usage: additions PERIODS PERIOD_NS CPU PRIORITY WORK_NS\n");
        return 2;
    }
    long periods = atol(arguments[1]);
    long long period = atoll(arguments[2]);
    struct period *log = calloc(periods > TRIALS ? periods : TRIALS, sizeof *log);
    if (!log || periods < 1 || period < 1)
        return 2;
    become_real_time(atoi(arguments[3]), atoi(arguments[4]));
    run(log, TRIALS, period, -1, atoll(arguments[5]));
    qsort(additions_in, TRIALS, sizeof *additions_in, ascending);
    run(log, periods, period, additions_in[TRIALS / 2], 0);
    for (long i = 0; i < periods; i++)
        printf("%lld %lld %lld\n", log[i].adding_ns, log[i].cpu_ns, log[i].skipped);
    return 0;
}
