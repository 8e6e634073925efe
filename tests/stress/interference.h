/* What stress.c puts between llfsm_whiteboard.h and the machine, to be included before it:
 *
 *   - before and after atomic operations the thread yields at random, so that threads meet in the
 *     middle of each other's steps, on few processors too;
 *   - a sleeper sleeps until it is woken: without the look every 50 ms a lost wake-up hangs;
 *   - under TSan all threads get one mapping of the board: a race through two mappings of one file
 *     is between two addresses, and TSan would not see it. */
#ifndef _GNU_SOURCE
#define _GNU_SOURCE 1
#endif
#include <pthread.h>
#include <sched.h>
#include <stdatomic.h>
#include <stdint.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

static _Thread_local uint64_t dice;
static _Thread_local unsigned yield_within = 1, until_yield; /* atomic operations */

static uint64_t mix(uint64_t x)
{ /* the finaliser of splitmix64 */
    x = (x ^ x >> 30) * 0xbf58476d1ce4e5b9u;
    x = (x ^ x >> 27) * 0x94d049bb133111ebu;
    return x ^ x >> 31;
}

static uint64_t random_number(void) { return mix(dice += 0x9e3779b97f4a7c15u); }

static void perhaps_yield(void)
{
    if (until_yield-- == 0) {
        until_yield = (unsigned)(random_number() % yield_within);
        sched_yield();
    }
}

#undef atomic_load_explicit
#define atomic_load_explicit(at, order) \
    __extension__({ \
        __typeof__((void)0, *(at)) value_; \
        perhaps_yield(); \
        __atomic_load(at, &value_, order); \
        perhaps_yield(); \
        value_; \
    })
#undef atomic_store_explicit
#define atomic_store_explicit(at, what, order) \
    __extension__({ \
        __typeof__((void)0, *(at)) value_ = (what); \
        perhaps_yield(); \
        __atomic_store(at, &value_, order); \
    })

static long patient_SYS_futex(void *word, int operation, uint32_t value,
                              const struct timespec *time, void *unused, int unused2)
{
    perhaps_yield();
    return syscall(SYS_futex, word, operation, value, time && time->tv_nsec ? NULL : time, unused,
                   unused2);
}
#define patient_SYS_clone(...) (syscall)(SYS_clone, __VA_ARGS__)
#define patient_SYS_exit_group(status) (syscall)(SYS_exit_group, status)
#define syscall(number, ...) patient_##number(__VA_ARGS__)

#ifdef __SANITIZE_THREAD__
enum { SHARED = 1 << 28 };
static void *shared;
static pthread_mutex_t sharing = PTHREAD_MUTEX_INITIALIZER;

static void *shared_mmap(void *at, size_t length, int protection, int flags, int fd, off_t offset)
{
    if (flags & MAP_ANONYMOUS)
        return mmap(at, length, protection, flags, fd, offset);
    pthread_mutex_lock(&sharing);
    if (!shared)
        shared = mmap(NULL, SHARED, protection, flags, fd, offset);
    pthread_mutex_unlock(&sharing);
    return length <= SHARED ? shared : MAP_FAILED;
}

static int shared_munmap(void *at, size_t length) { return at == shared ? 0 : munmap(at, length); }
#define mmap shared_mmap
#define munmap shared_munmap
#endif
