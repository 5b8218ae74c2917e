/* What both C programs ask of the kernel before they measure: a core, real time, memory that stays, no sleeping cores. */
#include <fcntl.h>
#include <sched.h>
#include <stdint.h>
#include <stdio.h>
#include <sys/mman.h>
#include <unistd.h>

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
    int fd = open("/dev/cpu_dma_latency", O_RDWR); /* held until exit */
    int32_t latency = 0;
    if (fd < 0 || write(fd, &latency, sizeof latency) != sizeof latency)
        perror("/dev/cpu_dma_latency");
}
