/* Sleep from one time to the next, and do nothing else: what any program of a period pays.
 *
 * The arguments are what to print, the period in microseconds, the number of sleeps, and a priority of
 * SCHED_FIFO with locked memory, or 0. For each line of its input it sleeps so often. It prints, for
 * "cost", the processor's nanoseconds for a sleep. For "lateness", it prints by how many nanoseconds
 * each was late, and for how many the thread had waited for a processor by then. */
#define _GNU_SOURCE
#include <fcntl.h>
#include <sched.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

static long long read_clock(clockid_t clock)
{
    struct timespec t;
    clock_gettime(clock, &t);
    return t.tv_sec * 1000000000LL + t.tv_nsec;
}

/* For how long this thread has waited for a processor that others had. */
static long long read_waited(int file)
{
    char text[64];
    long long waited = 0;
    ssize_t length = pread(file, text, sizeof text - 1, 0);
    text[length > 0 ? length : 0] = 0;
    sscanf(text, "%*d %lld", &waited);
    return waited;
}

int main(int argc, char **argv)
{
    if (argc != 5)
        return 2;
    bool counts = argv[1][0] == 'l';
    int file = open("/proc/thread-self/schedstat", O_RDONLY);
    long long period = atoll(argv[2]) * 1000;
    size_t times = strtoul(argv[3], NULL, 10);
    struct sched_param priority = {.sched_priority = atoi(argv[4])};
    if (priority.sched_priority &&
        (mlockall(MCL_CURRENT | MCL_FUTURE) || sched_setscheduler(0, SCHED_FIFO, &priority)))
        return 1;
    long long *late = calloc(2 * times, sizeof *late), *waited = late + times;
    if (!late || !times)
        return 1;
    char line[16];
    while (fgets(line, sizeof line, stdin)) {
        long long due = read_clock(CLOCK_MONOTONIC), used = read_clock(CLOCK_THREAD_CPUTIME_ID);
        for (size_t i = 0; i < times; i++, due += period) {
            struct timespec until = {due / 1000000000, due % 1000000000};
            clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, NULL);
            late[i] = read_clock(CLOCK_MONOTONIC) - due;
            if (counts)
                waited[i] = read_waited(file);
        }
        used = read_clock(CLOCK_THREAD_CPUTIME_ID) - used;
        for (size_t i = 0; i < times && counts; i++)
            printf("%lld %lld ", late[i], waited[i]);
        printf("%lld\n", used / (long long)times);
        fflush(stdout);
    }
    return 0;
}
