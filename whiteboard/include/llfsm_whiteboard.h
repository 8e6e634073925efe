/* The whiteboard's complete shared-memory protocol, header-only, in C11 that is also C++17.
 *
 * A board is one file (in /dev/shm by default) that every process maps. It holds slots; a slot
 * holds the latest message and counts the messages added. Guarantees:
 *
 *   1. lwb_add and lwb_read are lock-free: no process ever waits for another one.
 *   2. A reader gets a complete message with its own count, or starts again; never a torn one.
 *   3. A slot's count grows by exactly one for each completed add.
 *   4. A process that is killed or stopped anywhere loses at most the message it was writing, and
 *      leaves nothing that another process has to clean up.
 *   5. A damaged file results in LWB_CORRUPT, never in an access outside the mapping. So does one
 *      that is truncated while it is open, if the program has called lwb_catch_truncation; else the
 *      next access ends it by SIGBUS, as with any mapping.
 *   6. A name that was given up (lwb_vacate) makes room for another one of the same type. No handle
 *      ever gets or adds a message under another name than its own: it returns LWB_RENAMED.
 *
 * Method: a slot has one word, (count, writer, buffer), and each writing process owns buffers of
 * its own in the slot. A writer fills a buffer that the word does not name, then swaps the word;
 * the add takes effect at the swap. A reader copies the buffer that the word names, and accepts
 * the copy if the buffer still carries the word's count.
 *
 * Use: lwb_open a board, lwb_slot a slot on it, then lwb_add, lwb_read, lwb_wait. A payload is
 * MessagePack: a message is the array of its fields' values in the order of the slot's schema.
 * A struct lwb_board and its slots may be used by one thread at a time: each thread opens its own.
 * (lwb_word, lwb_count, lwb_wait and lwb_wait_any access shared memory only; other threads may use
 * the board at the same time.) A forked child may continue to use its parent's. Linux on 64-bit
 * machines only; elsewhere use boards that need no shared memory.
 *
 * Memory orders are C11's, and no more is assumed: not that loads stay in order, as on x86. On ARM,
 * plain loads and stores pass each other, and acquires, releases and fences are instructions of their
 * own, so that a missing one shows there first. Two places need more than release and acquire. A
 * payload's words are relaxed, between fences on both sides: what a reader copies while it is
 * overwritten is discarded, since its second look at the count then sees the 0 or a later count. And
 * who waits stores first and then looks at the word, while who adds swaps the word and then looks for
 * who waits: both looks may be early under release and acquire, and the wake be lost. So these four
 * are sequentially consistent (ldar, stlr and their kind, which keep their order among themselves).
 * tests/stress/test_memory_order.py goes through all executions of both that C11 allows.
 *
 * All of it is one file, so that a program in another language needs to copy and include no more,
 * and so that one reading shows each memory order beside the one it pairs with.
 */
#ifndef LLFSM_WHITEBOARD_H
#define LLFSM_WHITEBOARD_H

#ifndef _GNU_SOURCE
#define _GNU_SOURCE 1 /* O_TMPFILE, F_OFD_SETLK, MADV_WIPEONFORK, mkostemp */
#endif
#include <assert.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <linux/futex.h>
#include <signal.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#ifdef __cplusplus /* argument-dependent lookup finds the functions, but not the memory orders */
#include <atomic>
using std::memory_order_acquire;
using std::memory_order_relaxed;
using std::memory_order_release;
using std::memory_order_seq_cst;
typedef std::atomic<uint32_t> lwb_atomic32;
typedef std::atomic<uint64_t> lwb_atomic64;
#define LWB_ZERO {}
#else
#include <stdatomic.h>
typedef _Atomic uint32_t lwb_atomic32;
typedef _Atomic uint64_t lwb_atomic64;
#define LWB_ZERO {0}
#endif

enum {
    LWB_VERSION = 2,
    LWB_MAX_SLOTS = 4096,      /* slots of a board */
    LWB_MAX_WRITERS = 256,     /* processes writing to a board at the same time */
    LWB_BUFFERS = 4,           /* a writer's buffers in a slot */
    LWB_MAX_NAME = 255,        /* bytes of a slot's or a type's name */
    LWB_MAX_SCHEMA = 1 << 20,  /* bytes of a schema */
    LWB_MAX_CAPACITY = 1 << 30 /* bytes of a message */
};

#define LWB_NO_GROUP ((gid_t)-1) /* a board is for its user alone */

enum lwb_status {
    LWB_OK = 0,
    LWB_EMPTY,     /* nothing was added to the slot yet */
    LWB_TIMEOUT,   /* no newer message within the time given */
    LWB_MISSING,   /* no such board, or no such slot */
    LWB_TOO_LARGE, /* the message exceeds the slot's capacity */
    LWB_DIFFERS,   /* the slot exists with another schema */
    LWB_NO_SPACE,  /* the file system of the board is full */
    LWB_NO_SLOT,   /* the board has LWB_MAX_SLOTS slots */
    LWB_NO_WRITER, /* LWB_MAX_WRITERS processes write to the board */
    LWB_FOREIGN,   /* the file is not a whiteboard, or belongs to another user */
    LWB_VERSIONED, /* a whiteboard of another version or kind of machine */
    LWB_CORRUPT,   /* the file is damaged */
    LWB_INVALID,   /* an argument is out of range */
    LWB_SYSTEM,    /* a system call failed: see errno */
    LWB_PASSED,    /* another message was added to the slot first */
    LWB_RENAMED    /* the slot's name was given up, and its record has another: open it again */
};

/* ---- The file -------------------------------------------------------------------------------
 * Everything is 8-byte aligned. Offsets are from the file's start; 0 means none. Records are
 * never moved or freed, so an offset stays valid; of what describes a slot, only its name changes. */

#define LWB_MAGIC 0x4452414f42574c4cull       /* "LLWBOARD" */
#define LWB_SLOT_MAGIC 0x544f4c5342574c4cull  /* "LLWBSLOT" */
#define LWB_BLOCK_MAGIC 0x4b434c4242574c4cull /* "LLWBBLCK" */

#define LWB_FURTHEST ((uint64_t)1 << 46)      /* all offsets are below */

static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__ && ATOMIC_LLONG_LOCK_FREE == 2 &&
                  sizeof(size_t) == 8 && sizeof(lwb_atomic32) == 4 && sizeof(lwb_atomic64) == 8,
              "the protocol needs a little-endian 64-bit machine with lock-free 64-bit atomics");

struct lwb_header {
    uint64_t magic;
    uint32_t version, byte_order; /* byte_order is 0x01020304 in the writer's own order */
    uint32_t max_slots, max_writers, buffers, header_size;
    uint64_t checksum;            /* of all above */
    lwb_atomic64 end;         /* where the next record goes; only grows */
    lwb_atomic32 watching;        /* odd if a process may wait for any slot's word */
    lwb_atomic32 alarm;           /* grows when an armed slot has changed */
    lwb_atomic64 named;       /* generation << 12 | index of the record named last */
    lwb_atomic32 readings;        /* grows when a process begins or ends to read a slot */
    uint32_t unused2;
    uint64_t unused[7];
    unsigned char locks[LWB_MAX_WRITERS + 64]; /* never read: see lwb_claim and lwb_attach */
    lwb_atomic64 slots[LWB_MAX_SLOTS];     /* offsets of slot records, filled in order */
};

enum { LWB_NAME_WORDS = (LWB_MAX_NAME + 1) / 8 };

struct lwb_record { /* a slot, followed by its type name and schema, each with a 0 */
    uint64_t magic, size, capacity, fingerprint;
    uint32_t type_length, schema_length, unused[2];
    uint64_t checksum; /* of all above and both texts */
    uint64_t unused2;
    lwb_atomic64 word; /* count << 16 | writer << 4 | buffer */
    lwb_atomic32 waiting; /* odd if a process may wait for the word to change */
    lwb_atomic32 armed; /* not 0 if a process may wait for this slot's word among others */
    lwb_atomic64 life; /* generation << 2 | enum lwb_life; each name has a generation of its own */
    lwb_atomic64 base; /* the count with which this name began */
    lwb_atomic64 name_sum;
    uint64_t unused3[3];
    lwb_atomic64 blocks[LWB_MAX_WRITERS]; /* each writer's buffers; only that writer sets it */
    lwb_atomic64 name[LWB_NAME_WORDS]; /* filled up with 0 */
};

enum lwb_life {
    LWB_NAMED,  /* the slot of that name */
    LWB_VACANT, /* still that, until another name takes the record */
    LWB_TAKEN   /* being named, by who has a lock on its entry of the table; nobody's without one */
};

struct lwb_block { /* a writer's buffers in one slot */
    uint64_t magic, slot, writer, checksum;
};

struct lwb_buffer { /* atomic words, because readers may read while the owner writes */
    lwb_atomic64 count, length, stamp, process;
    __extension__ lwb_atomic64 payload[];
};

/* ---- A process's state ---------------------------------------------------------------------- */

struct lwb_board {
    int fd;
    uint64_t size;                    /* bytes of the file known to exist */
    uint64_t mapped;                  /* bytes of the newest mapping */
    unsigned char *map;               /* the newest mapping */
    struct { void *at; size_t length; int guard; } maps[32]; /* all mappings: pointers into older
                                       * ones stay valid. Each is twice the last, so 32 suffice */
    int map_count;
    int writer;                       /* this process's writer id, or -1 */
    uint64_t process;                 /* this process's id, as in its messages */
    volatile unsigned char *same;     /* 1, on a page that is wiped at a fork: 0 in a child */
    bool wiped;                       /* whether that page really is */
    uint32_t reading[LWB_MAX_SLOTS];  /* lwb_begin_reading without its end, for each slot */
};

/* What of a record decides addresses and lengths. Any process that may open the file can change it at
 * any time. So it is read once, checked, and used from here: see lwb_frame_at. */
struct lwb_frame {
    uint64_t size, capacity, fingerprint, checksum;
    uint32_t type_length, schema_length;
};

struct lwb_slot {
    struct lwb_board *board;
    struct lwb_record *record;
    uint64_t offset, capacity;
    struct lwb_frame frame;                    /* the record's, as it was checked */
    int index;                                 /* of the record */
    uint64_t life, base;                       /* the record's, when it had the slot's name */
    size_t stride;                             /* bytes from one buffer to the next */
    int writer, next;                          /* the owner of `own`; the next buffer to fill */
    struct lwb_block *own;
    struct lwb_block *seen[LWB_MAX_WRITERS];   /* blocks already validated */
};

struct lwb_meta {
    uint64_t word;     /* the slot's, with this message: if unchanged, there is no newer one */
    uint64_t count;    /* the slot's, with this message */
    uint64_t stamp;    /* CLOCK_MONOTONIC in ns, just before it was added */
    uint64_t process;  /* id of the process that added it */
    size_t length;     /* bytes */
};

static inline const char *lwb_describe(int status)
{
    static const char *const texts[] = {
        "done", "nothing was added yet", "timed out", "not found",
        "the message exceeds the slot's capacity", "the slot exists with another schema",
        "no space left for the board", "the board's table of slots is full",
        "too many processes write to the board", "not a whiteboard of this user",
        "a whiteboard of another version", "the board's file is damaged",
        "an argument is out of range", "a system call failed", "another message was added first",
        "the slot's name was given up"};
    return status >= 0 && status <= LWB_RENAMED ? texts[status] : "unknown status";
}

/* ---- Helpers -------------------------------------------------------------------------------- */

static inline uint64_t lwb_hash(uint64_t hash, const void *data, size_t length)
{ /* FNV-1a; start with 0 */
    const unsigned char *bytes = (const unsigned char *)data;
    hash ^= 0xcbf29ce484222325ull;
    for (size_t i = 0; i < length; i++)
        hash = (hash ^ bytes[i]) * 0x100000001b3ull;
    return hash;
}

static inline size_t lwb_round(size_t n, size_t to) { return (n + to - 1) / to * to; }

static inline uint64_t lwb_count_of(uint64_t word) { return word >> 16; }
static inline unsigned lwb_writer_of(uint64_t word) { return word >> 4 & 0xfff; }
static inline unsigned lwb_buffer_of(uint64_t word) { return word & 0xf; }

static inline uint64_t lwb_header_sum(const struct lwb_header *h)
{
    return lwb_hash(0, h, offsetof(struct lwb_header, checksum));
}

static inline const char *lwb_texts(const struct lwb_record *r) { return (const char *)(r + 1); }

static inline uint64_t lwb_record_sum(const struct lwb_record *r, const struct lwb_frame *f)
{
    uint64_t head = lwb_hash(0, r, offsetof(struct lwb_record, checksum));
    return lwb_hash(head, lwb_texts(r), (size_t)f->type_length + f->schema_length + 2);
}

static inline const char *lwb_type_text(const struct lwb_record *r) { return lwb_texts(r); }

static inline const char *lwb_schema_text(const struct lwb_record *r)
{
    return lwb_texts(r) + r->type_length + 1;
}

static inline uint64_t lwb_generation_of(uint64_t life) { return life >> 2; }
static inline enum lwb_life lwb_state_of(uint64_t life) { return (enum lwb_life)(life & 3); }
static inline uint64_t lwb_life_of(uint64_t generation, enum lwb_life state)
{
    return generation << 2 | (uint64_t)state;
}

static inline uint64_t lwb_block_sum(const struct lwb_block *b)
{
    return lwb_hash(0, b, offsetof(struct lwb_block, checksum));
}

static inline size_t lwb_stride(uint64_t capacity) /* whole words: the last may be part-used */
{
    return lwb_round(sizeof(struct lwb_buffer) + capacity, 64);
}

static inline size_t lwb_block_size(uint64_t capacity)
{
    return lwb_round(sizeof(struct lwb_block), 64) + LWB_BUFFERS * lwb_stride(capacity);
}

static inline struct lwb_buffer *lwb_buffer_at(struct lwb_block *b, unsigned i, size_t stride)
{
    return (struct lwb_buffer *)((unsigned char *)b + lwb_round(sizeof *b, 64) + i * stride);
}

/* ---- Truncated files -------------------------------------------------------------------------
 * Whoever may write to the file may truncate it. An access to what is gone is a SIGBUS, which ends the
 * program, and with it, perhaps, what would have stopped a robot. So the handler puts empty memory, of
 * this process alone, in the place of the whole mapping, and marks that: the access under way finds
 * zeros, and all that follows LWB_CORRUPT. A fault anywhere else is left to who handled it before. */

enum { LWB_GUARDED = 256 }; /* mappings of this program; the access to more of them ends it */

static struct { lwb_atomic64 at, length; lwb_atomic32 lost; } lwb_guards[LWB_GUARDED];
static lwb_atomic32 lwb_losses;
static struct sigaction lwb_before;

static inline void lwb_on_fault(int number, siginfo_t *info, void *context)
{
    (void)context;
    uint64_t fault = (uint64_t)(uintptr_t)info->si_addr;
    int saved = errno;
    for (int i = 0; info->si_code > 0 && i < LWB_GUARDED; i++) {
        uint64_t at = atomic_load_explicit(&lwb_guards[i].at, memory_order_acquire);
        uint64_t length = atomic_load_explicit(&lwb_guards[i].length, memory_order_relaxed);
        if (at < 2 || fault < at || fault - at >= length)
            continue;
        atomic_store(&lwb_guards[i].lost, 1);
        atomic_store(&lwb_losses, 1);
        if (mmap((void *)(uintptr_t)at, length, PROT_READ | PROT_WRITE,
                 MAP_PRIVATE | MAP_ANONYMOUS | MAP_FIXED, -1, 0) != MAP_FAILED) {
            errno = saved;
            return;
        }
    }
    sigaction(SIGBUS, &lwb_before, NULL); /* the access is made again, and goes there */
    if (info->si_code <= 0)
        raise(number); /* as it was sent by somebody */
    errno = saved;
}

/* Let a truncated file result in LWB_CORRUPT, by a handler of SIGBUS; again after another was set. */
static inline void lwb_catch_truncation(void)
{
    struct sigaction action = LWB_ZERO, now;
    action.sa_sigaction = lwb_on_fault;
    action.sa_flags = SA_SIGINFO | SA_ONSTACK;
    sigemptyset(&action.sa_mask);
    if (sigaction(SIGBUS, NULL, &now) ||
        (now.sa_flags & SA_SIGINFO && now.sa_sigaction == lwb_on_fault))
        return;
    lwb_before = now;
    sigaction(SIGBUS, &action, NULL);
}

static inline int lwb_guard(void *map, size_t length) /* returns its index, or -1 without room */
{
    for (int i = 0; i < LWB_GUARDED; i++) {
        uint64_t none = 0;
        if (atomic_compare_exchange_strong(&lwb_guards[i].at, &none, 1)) { /* taken, not yet ready */
            atomic_store(&lwb_guards[i].lost, 0);
            atomic_store(&lwb_guards[i].length, length);
            atomic_store_explicit(&lwb_guards[i].at, (uint64_t)(uintptr_t)map,
                                  memory_order_release);
            return i;
        }
    }
    return -1;
}

/* True if the file was truncated, and this program has come upon that. */
static inline bool lwb_is_lost(const struct lwb_board *b)
{
    if (!atomic_load_explicit(&lwb_losses, memory_order_relaxed))
        return false;
    for (int i = 0; i < b->map_count; i++)
        if (b->maps[i].guard >= 0 && atomic_load(&lwb_guards[b->maps[i].guard].lost))
            return true;
    return false;
}

static inline int lwb_if_kept(const struct lwb_board *b, int status)
{
    return lwb_is_lost(b) ? LWB_CORRUPT : status;
}

/* The address of a range, or NULL. Every offset read from the file is checked here. The mapping
 * may extend beyond the file, so the file's size is compared. Sets errno to 0 unless a system
 * call failed, so that lwb_why can distinguish a damaged file from a lack of memory. */
static inline void *lwb_at(struct lwb_board *b, uint64_t offset, size_t length)
{
    errno = 0;
    if (offset % 8 || offset > LWB_FURTHEST || lwb_is_lost(b))
        return NULL;
    uint64_t end = offset + length;
    if (end > b->size) {
        struct stat st;
        if (fstat(b->fd, &st) || (uint64_t)st.st_size < end)
            return NULL;
        b->size = (uint64_t)st.st_size;
    }
    if (end > b->mapped) {
        size_t want = lwb_round(end < (1u << 20) ? 1u << 20 : 2 * end, 4096);
        void *map = mmap(NULL, want, PROT_READ | PROT_WRITE, MAP_SHARED, b->fd, 0);
        if (map == MAP_FAILED)
            return NULL;
        b->maps[b->map_count].guard = lwb_guard(map, want);
        b->maps[b->map_count].at = map;
        b->maps[b->map_count++].length = want;
        b->map = (unsigned char *)map;
        b->mapped = want;
    }
    return b->map + offset;
}

/* The status after lwb_at, or a check of its result, has returned NULL. */
static inline int lwb_why(void) { return errno ? LWB_SYSTEM : LWB_CORRUPT; }

static inline struct lwb_header *lwb_head(struct lwb_board *b)
{
    return (struct lwb_header *)b->map;
}

static inline int lwb_reserve(int fd, uint64_t offset, uint64_t length)
{
    /* Allocate real pages now, because a sparse file on a full tmpfs causes SIGBUS later. A signal
     * would make tmpfs undo everything and start again; with a fast timer that would never end. */
    sigset_t all, before;
    sigfillset(&all);
    sigprocmask(SIG_SETMASK, &all, &before);
    int e;
    do e = posix_fallocate(fd, (off_t)offset, (off_t)length); while (e == EINTR);
    sigprocmask(SIG_SETMASK, &before, NULL);
    errno = e;
    return e == 0 ? LWB_OK
         : e == ENOSPC || e == EFBIG || e == EDQUOT ? LWB_NO_SPACE : LWB_SYSTEM;
}

/* Allocate space for a record. A process that dies between the two steps leaves an unused gap. */
static inline int lwb_allocate(struct lwb_board *b, size_t length, uint64_t *offset, void **at)
{
    if (lwb_is_lost(b)) /* what is reserved would be of no use, and in the file */
        return LWB_CORRUPT;
    length = lwb_round(length, 64);
    *offset = atomic_fetch_add(&lwb_head(b)->end, length);
    int status = *offset + length > LWB_FURTHEST ? LWB_NO_SPACE
               : lwb_reserve(b->fd, *offset, length);
    if (status) { /* return the space, unless more was allocated behind it */
        uint64_t behind = *offset + length;
        atomic_compare_exchange_strong(&lwb_head(b)->end, &behind, *offset);
        return status;
    }
    *at = lwb_at(b, *offset, length);
    return *at ? LWB_OK : lwb_why();
}

/* Lock byte `index` of the header's lock area, or test whether it could be locked. The lock is one
 * of the open file description, which the kernel releases when the last process that has the
 * description open ends, in any way. Returns -1 on failure; for F_OFD_GETLK 0 if free, else 1. */
static inline int lwb_lock(int fd, int command, short type, int64_t index)
{
    struct flock lock = LWB_ZERO;
    lock.l_type = type;
    lock.l_whence = SEEK_SET;
    lock.l_start = (off_t)offsetof(struct lwb_header, locks) + (off_t)index;
    lock.l_len = 1;
    if (fcntl(fd, command, &lock))
        return -1;
    return lock.l_type == F_UNLCK ? 0 : 1;
}

/* The same for the byte of those who read slot `index`: beyond all that is in the file. */
static inline int lwb_lock_reading(int fd, int command, short type, int index)
{
    return lwb_lock(fd, command, type, (int64_t)LWB_FURTHEST + index);
}

/* ---- Boards -------------------------------------------------------------------------------- */

/* Whether a record is intact, but for its name. */
static inline bool lwb_is_sound(const struct lwb_record *r, const struct lwb_frame *f)
{
    return f->checksum == lwb_record_sum(r, f);
}

/* Read a record's frame, each field once: they are volatile, so that no compiler reads one again. */
static inline struct lwb_frame lwb_frame_of(const volatile struct lwb_record *r)
{
    struct lwb_frame f = LWB_ZERO;
    f.size = r->size;
    f.capacity = r->capacity;
    f.fingerprint = r->fingerprint;
    f.checksum = r->checksum;
    f.type_length = r->type_length;
    f.schema_length = r->schema_length;
    return f;
}

/* The record at `offset` and its frame, or NULL; its lengths are checked against the file's size.
 * Callers that use its texts call lwb_is_sound, too, which reads all of it. */
static inline struct lwb_record *lwb_frame_at(struct lwb_board *b, uint64_t offset,
                                              struct lwb_frame *f)
{
    struct lwb_record *r = (struct lwb_record *)lwb_at(b, offset, sizeof *r);
    if (!r || r->magic != LWB_SLOT_MAGIC)
        return NULL;
    *f = lwb_frame_of(r);
    if (f->capacity > LWB_MAX_CAPACITY || f->type_length > LWB_MAX_NAME ||
        f->schema_length > LWB_MAX_SCHEMA)
        return NULL;
    size_t texts = (size_t)f->type_length + f->schema_length + 2;
    return f->size == sizeof *r + texts ? (struct lwb_record *)lwb_at(b, offset, f->size) : NULL;
}

/* The buffers of `writer` in a slot, or NULL if damaged. */
static inline struct lwb_block *lwb_block_at(struct lwb_board *b, uint64_t offset, uint64_t slot,
                                             unsigned writer, uint64_t capacity)
{
    size_t size = lwb_block_size(capacity);
    struct lwb_block *block = (struct lwb_block *)lwb_at(b, offset, size);
    return block && block->magic == LWB_BLOCK_MAGIC && block->slot == slot &&
           block->writer == writer && block->checksum == lwb_block_sum(block) ? block : NULL;
}

union lwb_name { char text[LWB_MAX_NAME + 1]; uint64_t words[LWB_NAME_WORDS]; };

static inline uint64_t lwb_name_sum(const union lwb_name *name)
{
    return lwb_hash(0, name->text, sizeof name->text);
}

/* Copy a record's name, and its life then; false if it has none, or if that is damaged: then
 * *damaged is set. A name is only written while the record is taken. So a copy is of one name if the
 * generation is the same after it; the fence pairs with the one in lwb_rename. */
static inline bool lwb_name_of(const struct lwb_record *r, union lwb_name *name, uint64_t *life,
                               bool *damaged)
{
    uint64_t sum;
    *damaged = false;
    for (;;) {
        *life = atomic_load_explicit(&r->life, memory_order_acquire);
        if (lwb_state_of(*life) > LWB_VACANT)
            return false;
        for (int i = 0; i < LWB_NAME_WORDS; i++)
            name->words[i] = atomic_load_explicit(&r->name[i], memory_order_relaxed);
        sum = atomic_load_explicit(&r->name_sum, memory_order_relaxed);
        atomic_thread_fence(memory_order_acquire);
        uint64_t now = atomic_load_explicit(&r->life, memory_order_relaxed);
        if (lwb_generation_of(now) == lwb_generation_of(*life))
            break;
    }
    *damaged = sum != lwb_name_sum(name) || name->text[LWB_MAX_NAME];
    name->text[LWB_MAX_NAME] = 0;
    return !*damaged;
}

/* Whether the end is beyond every record; a wrong one would let new records overwrite old ones. */
static inline bool lwb_end_is_sound(struct lwb_board *b)
{
    uint64_t furthest = sizeof(struct lwb_header);
    for (int i = 0; i < LWB_MAX_SLOTS; i++) {
        uint64_t at = atomic_load(&lwb_head(b)->slots[i]);
        if (!at)
            break;
        struct lwb_frame f;
        struct lwb_record *r = lwb_frame_at(b, at, &f);
        union lwb_name name;
        uint64_t life;
        bool damaged = !r || !lwb_is_sound(r, &f);
        if (damaged || (!lwb_name_of(r, &name, &life, &damaged) && damaged))
            return false;
        if (at + f.size > furthest)
            furthest = at + f.size;
        for (unsigned w = 0; w < LWB_MAX_WRITERS; w++) {
            uint64_t block = atomic_load(&r->blocks[w]);
            if (!block)
                continue;
            if (!lwb_block_at(b, block, at, w, f.capacity))
                return false;
            if (block + lwb_block_size(f.capacity) > furthest)
                furthest = block + lwb_block_size(f.capacity);
        }
    }
    uint64_t end = atomic_load(&lwb_head(b)->end); /* after the walk: it only grows */
    return end >= furthest && end % 64 == 0 && end < LWB_FURTHEST;
}

/* Whether a file may be a board of this user or, if a group is given, of that group: then whoever is
 * in it may write there, and nobody else. */
static inline bool lwb_is_ours(const struct stat *st, gid_t group)
{
    if (group == LWB_NO_GROUP)
        return S_ISREG(st->st_mode) && st->st_uid == geteuid();
    return S_ISREG(st->st_mode) && st->st_gid == group && (st->st_mode & 0777) == 0660;
}

static inline int lwb_check(struct lwb_board *b, gid_t group)
{
    struct stat st;
    if (fstat(b->fd, &st))
        return LWB_SYSTEM;
    if (!lwb_is_ours(&st, group))
        return LWB_FOREIGN;
    struct lwb_header *h = (struct lwb_header *)lwb_at(b, 0, sizeof *h);
    uint64_t magic = 0;
    if (!h && errno)
        return LWB_SYSTEM;
    if (!h) /* too short to map: a truncated board, or another file */
        return pread(b->fd, &magic, 8, 0) == 8 && magic == LWB_MAGIC ? LWB_CORRUPT : LWB_FOREIGN;
    if (h->magic != LWB_MAGIC)
        return LWB_FOREIGN;
    if (h->checksum != lwb_header_sum(h))
        return LWB_CORRUPT;
    if (h->version != LWB_VERSION || h->byte_order != 0x01020304 ||
        h->max_slots != LWB_MAX_SLOTS || h->max_writers != LWB_MAX_WRITERS ||
        h->buffers != LWB_BUFFERS || h->header_size != sizeof *h)
        return LWB_VERSIONED;
    return lwb_end_is_sound(b) ? LWB_OK : lwb_why();
}

static inline void lwb_reset(struct lwb_board *b) /* to the state of a closed board */
{
    memset(b, 0, sizeof *b);
    b->fd = b->writer = -1;
}

static inline void lwb_close(struct lwb_board *b)
{
    int saved = errno;
    for (int i = 0; i < b->map_count; i++) {
        if (b->maps[i].guard >= 0)
            atomic_store(&lwb_guards[b->maps[i].guard].at, 0);
        munmap(b->maps[i].at, b->maps[i].length);
    }
    if (b->same)
        munmap((void *)b->same, 4096);
    if (b->fd >= 0)
        close(b->fd); /* never unlock: a forked child may still write under the same lock */
    lwb_reset(b);
    errno = saved;
}

/* Make the complete board without a name, then link it: no process sees an incomplete board, and
 * a crash leaves no file. If the file system cannot do that, use a temporary name. */
static inline int lwb_create(const char *path, gid_t group)
{
    char directory[PATH_MAX], temporary[PATH_MAX + 8] = "";
    snprintf(directory, sizeof directory, "%s", path);
    char *slash = strrchr(directory, '/');
    *(slash ? slash + 1 : directory) = 0;
    int fd = open(*directory ? directory : ".", O_TMPFILE | O_RDWR | O_CLOEXEC, 0600);
    if (fd < 0 && (errno == EOPNOTSUPP || errno == EISDIR || errno == EINVAL)) {
        snprintf(temporary, sizeof temporary, "%s.XXXXXX", path);
        fd = mkostemp(temporary, O_CLOEXEC);
    }
    if (fd < 0)
        return errno == ENOSPC ? LWB_NO_SPACE : LWB_SYSTEM;
    struct lwb_header h = LWB_ZERO;
    h.magic = LWB_MAGIC;
    h.version = LWB_VERSION;
    h.byte_order = 0x01020304;
    h.max_slots = LWB_MAX_SLOTS;
    h.max_writers = LWB_MAX_WRITERS;
    h.buffers = LWB_BUFFERS;
    h.header_size = sizeof h;
    h.checksum = lwb_header_sum(&h);
    atomic_store(&h.end, lwb_round(sizeof h, 64));
    int status = lwb_reserve(fd, 0, lwb_round(sizeof h, 4096));
    if (!status && group != LWB_NO_GROUP && (fchown(fd, (uid_t)-1, group) || fchmod(fd, 0660)))
        status = LWB_SYSTEM;
    if (!status && pwrite(fd, &h, sizeof h, 0) != (ssize_t)sizeof h)
        status = LWB_SYSTEM;
    if (!status) {
        char self[64];
        snprintf(self, sizeof self, "/proc/self/fd/%d", fd);
        if (*temporary ? linkat(AT_FDCWD, temporary, AT_FDCWD, path, 0)
                       : linkat(AT_FDCWD, self, AT_FDCWD, path, AT_SYMLINK_FOLLOW))
            status = errno == EEXIST ? LWB_OK : LWB_SYSTEM; /* another was first: use its */
    }
    int saved = errno;
    if (*temporary)
        unlink(temporary);
    close(fd);
    errno = saved;
    return status;
}

/* Whether the kernel wipes `page` in a child. It may accept MADV_WIPEONFORK and ignore it, as qemu
 * does, so it is tried out, once per process: on a child that nothing else in this process notices, as
 * its end sends no signal and only this waits for it. Without an answer, the page is not relied on. */
static inline bool lwb_wipes(volatile unsigned char *page)
{
    static lwb_atomic32 known; /* 0: not yet; 1: no; 2: yes */
    if (!atomic_load_explicit(&known, memory_order_relaxed)) {
        int status = -1, saved = errno;
        *page = 1;
        long child = syscall(SYS_clone, 0L, 0L, 0L, 0L, 0L); /* a fork, in any order of arguments */
        if (!child)
            syscall(SYS_exit_group, (long)*page);
        if (child > 0)
            while (waitpid((pid_t)child, &status, __WALL) < 0 && errno == EINTR)
                ;
        bool wipes = status != -1 && WIFEXITED(status) && !WEXITSTATUS(status);
        atomic_store_explicit(&known, wipes ? 2u : 1u, memory_order_relaxed);
        errno = saved;
    }
    return atomic_load_explicit(&known, memory_order_relaxed) == 2;
}

/* False in a forked child. Where no page shows that, the process id does, which costs a system call
 * for each add. */
static inline bool lwb_is_same(const struct lwb_board *b)
{
    return *b->same && (b->wiped || b->process == (uint64_t)getpid());
}

/* Register this process, here and for others. The page is made here, not at the first claim,
 * because a fork before that claim has to be noticed, too. */
static inline int lwb_attach(struct lwb_board *b)
{
    if (!b->same) {
        void *page = mmap(NULL, 4096, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
        if (page == MAP_FAILED)
            return LWB_SYSTEM;
        b->same = (unsigned char *)page;
        b->wiped = !madvise(page, 4096, MADV_WIPEONFORK) && lwb_wipes(b->same);
    }
    *b->same = 1;
    b->writer = -1;
    b->process = (uint64_t)getpid();
    lwb_lock(b->fd, F_OFD_SETLK, F_RDLCK, LWB_MAX_WRITERS); /* a shared lock: in use */
    for (int i = 0; i < LWB_MAX_SLOTS; i++) /* none, unless in a forked child */
        if (b->reading[i])
            lwb_lock_reading(b->fd, F_OFD_SETLK, F_RDLCK, i);
    return LWB_OK;
}

/* Open the board at `path`; with `create`, make it if it does not exist. On failure the board is
 * closed. The file's content is validated here once. With a group, it is a board of its members. */
static inline int lwb_open_for(struct lwb_board *b, const char *path, bool create, gid_t group)
{
    lwb_reset(b);
    for (int tries = 0;; tries++) { /* again if it was removed right after it was made */
        b->fd = open(path, O_RDWR | O_CLOEXEC | O_NOFOLLOW);
        if (b->fd >= 0)
            break;
        if (errno == ELOOP)
            return LWB_FOREIGN;
        if (errno != ENOENT)
            return LWB_SYSTEM;
        if (!create || tries == 100)
            return LWB_MISSING;
        int status = lwb_create(path, group);
        if (status)
            return status;
    }
    int status = lwb_check(b, group);
    if (!status)
        status = lwb_attach(b);
    if (status)
        lwb_close(b);
    return status;
}

/* Open a board of this user alone, likewise. */
static inline int lwb_open(struct lwb_board *b, const char *path, bool create)
{
    return lwb_open_for(b, path, create, LWB_NO_GROUP);
}

/* True until the board is removed (its file has no name any more). */
static inline bool lwb_linked(const struct lwb_board *b)
{
    struct stat st;
    return b->fd >= 0 && !lwb_is_lost(b) && !fstat(b->fd, &st) && st.st_nlink > 0;
}

/* True if this file is also open in another struct lwb_board, in this process or another one. */
static inline bool lwb_shared(const struct lwb_board *b)
{
    return lwb_lock(b->fd, F_OFD_GETLK, F_WRLCK, LWB_MAX_WRITERS) == 1;
}

/* ---- Slots --------------------------------------------------------------------------------- */

/* Record `index`, see lwb_frame_at; NULL with *status LWB_MISSING if there are no more. */
static inline struct lwb_record *lwb_framed(struct lwb_board *b, int index, uint64_t *offset,
                                            struct lwb_frame *f, int *status)
{
    *offset = index < LWB_MAX_SLOTS
            ? atomic_load_explicit(&lwb_head(b)->slots[index], memory_order_acquire) : 0;
    struct lwb_record *r = *offset ? lwb_frame_at(b, *offset, f) : NULL;
    *status = r ? LWB_OK : *offset ? lwb_why() : LWB_MISSING;
    return r;
}

/* The same for who needs no more of it than its atomic fields. */
static inline struct lwb_record *lwb_slot_at(struct lwb_board *b, int index, uint64_t *offset,
                                             int *status)
{
    struct lwb_frame f;
    return lwb_framed(b, index, offset, &f, status);
}

/* What slots of one kind have in common; `type` and `text` are not ended by a 0, as they may be texts
 * of a record that another process changes. */
struct lwb_kind {
    const char *type, *text;
    struct lwb_frame frame;
};

struct lwb_schema {
    const char *name, *type, *text; /* the slot's name, its type's name, the JSON schema */
    uint64_t fingerprint;           /* equal exactly if two schemas agree */
    uint64_t capacity;              /* bytes of the largest message */
};

static inline struct lwb_kind lwb_kind_of(const struct lwb_schema *s)
{
    struct lwb_kind kind = {s->type, s->text, LWB_ZERO};
    kind.frame.capacity = s->capacity;
    kind.frame.fingerprint = s->fingerprint;
    kind.frame.type_length = (uint32_t)strlen(s->type);
    kind.frame.schema_length = (uint32_t)strlen(s->text);
    return kind;
}

/* ---- Names ----------------------------------------------------------------------------------
 * All names are given by swaps of one word of the board, `named`, so there is one order of them. Who
 * needs a new name (lwb_bind)
 *
 *   1. reads `named`, and completes what it says: the record named last becomes LWB_NAMED;
 *   2. looks through all records for the name, and is done if it is there;
 *   3. takes a record, which nobody else does, and writes the name there;
 *   4. swaps `named` from what was read in 1 to that record and its generation, and starts again.
 *
 * The swap fails if any name was given since 1, so no name is given twice. It never repeats a value,
 * as a record has a new generation whenever it is taken. Who dies anywhere delays nobody: 1 is done
 * by the next one, and what is taken can be taken again when the kernel has released its lock. Who is
 * stopped keeps one record back.
 *
 * A record is taken if it is new, or vacant and of the same type and capacity. Its count goes on:
 * `base` is where the new name begins, and there is no message before base + 1. Its word is swapped
 * in between. So a writer whose handle has the former name either has swapped the word before, or its
 * swap fails; it then reads the new word and after that the new generation (lwb_add_after). A reader
 * reads the generation after the word, too: if that is its own, so is the message. */

static inline int lwb_attach(struct lwb_board *b);

/* In a forked child, open a file description of its own: its copy shares the parent's locks. */
static inline int lwb_reopen(struct lwb_board *b)
{
    if (lwb_is_same(b))
        return LWB_OK;
    char self[64];
    snprintf(self, sizeof self, "/proc/self/fd/%d", b->fd);
    int fd = open(self, O_RDWR | O_CLOEXEC); /* by number: the name may be removed or reused */
    if (fd < 0)
        return LWB_SYSTEM;
    close(b->fd);
    b->fd = fd;
    return lwb_attach(b);
}

static inline bool lwb_lock_entry(struct lwb_board *b, int index, short type)
{
    int from = (int)(offsetof(struct lwb_header, slots) - offsetof(struct lwb_header, locks));
    return lwb_lock(b->fd, F_OFD_SETLK, type, from + 8 * index) >= 0;
}

struct lwb_taken { struct lwb_record *record; uint64_t generation; int index; };

enum { LWB_NAMED_BITS = 12 }; /* of `named` for the index; the others are the generation's */
static_assert(LWB_MAX_SLOTS == 1 << LWB_NAMED_BITS, "an index has as many bits");

static inline void lwb_complete(struct lwb_board *b, uint64_t named)
{
    uint64_t offset, generation = named >> LWB_NAMED_BITS;
    uint64_t taken = lwb_life_of(generation, LWB_TAKEN);
    int status;
    struct lwb_record *r = lwb_slot_at(b, (int)(named & (LWB_MAX_SLOTS - 1)), &offset, &status);
    if (r) /* unless it is complete, or has been taken again */
        atomic_compare_exchange_strong(&r->life, &taken, lwb_life_of(generation, LWB_NAMED));
}

/* Write the name into a record that only this process can see, or has taken. The fence pairs with
 * the one in lwb_name_of: who has read any of the name sees that the record was taken. */
static inline void lwb_rename(struct lwb_record *r, const union lwb_name *name, uint64_t base)
{
    atomic_thread_fence(memory_order_release);
    atomic_store_explicit(&r->base, base, memory_order_relaxed);
    for (int i = 0; i < LWB_NAME_WORDS; i++)
        atomic_store_explicit(&r->name[i], name->words[i], memory_order_relaxed);
    atomic_store_explicit(&r->name_sum, lwb_name_sum(name), memory_order_relaxed);
}

static inline bool lwb_is_alike(const struct lwb_record *r, const struct lwb_frame *f,
                                const struct lwb_kind *k)
{
    return f->fingerprint == k->frame.fingerprint && f->capacity == k->frame.capacity &&
           f->type_length == k->frame.type_length && f->schema_length == k->frame.schema_length &&
           lwb_is_sound(r, f) && !memcmp(lwb_texts(r), k->type, f->type_length) &&
           !memcmp(lwb_texts(r) + f->type_length + 1, k->text, f->schema_length);
}

/* Take record `index` if it has no name that is in use. */
static inline bool lwb_take_over(struct lwb_board *b, struct lwb_record *r,
                                 const struct lwb_frame *f, int index, const struct lwb_kind *k,
                                 const union lwb_name *name, struct lwb_taken *taken)
{
    uint64_t life = atomic_load(&r->life), generation = lwb_generation_of(life) + 1;
    if (lwb_state_of(life) == LWB_NAMED || generation >> (64 - LWB_NAMED_BITS) ||
        !lwb_is_alike(r, f, k) || !lwb_lock_entry(b, index, F_WRLCK))
        return false;
    if (!atomic_compare_exchange_strong(&r->life, &life, lwb_life_of(generation, LWB_TAKEN))) {
        lwb_lock_entry(b, index, F_UNLCK);
        return false;
    }
    uint64_t word = atomic_load(&r->word), none;
    do none = (lwb_count_of(word) + 1) << 16 | 0xffff; /* no writer's buffer */
    while (!atomic_compare_exchange_weak(&r->word, &word, none));
    lwb_rename(r, name, lwb_count_of(none));
    taken->record = r;
    taken->generation = generation;
    taken->index = index;
    return true;
}

static inline int lwb_write_record(struct lwb_board *b, const struct lwb_kind *k,
                                   const union lwb_name *name, uint64_t *offset)
{
    size_t t = k->frame.type_length, x = k->frame.schema_length;
    void *at;
    int status = lwb_allocate(b, sizeof(struct lwb_record) + t + x + 2, offset, &at);
    if (status)
        return status;
    /* New space is zero, and a word of 0 means that nothing was added. */
    struct lwb_record *r = (struct lwb_record *)at;
    r->magic = LWB_SLOT_MAGIC;
    r->size = sizeof *r + t + x + 2;
    r->capacity = k->frame.capacity;
    r->fingerprint = k->frame.fingerprint;
    r->type_length = (uint32_t)t;
    r->schema_length = (uint32_t)x;
    memcpy((char *)(r + 1), k->type, t); /* new space is zero: so they are ended */
    memcpy((char *)(r + 1) + t + 1, k->text, x);
    r->checksum = lwb_record_sum(r, &k->frame);
    atomic_store_explicit(&r->life, lwb_life_of(1, LWB_TAKEN), memory_order_relaxed);
    lwb_rename(r, name, 0);
    return LWB_OK;
}

/* Take a record for a name: one that is vacant, or else a new one, at the first free entry. The lock
 * on a new one's entry only keeps others from taking it over at once. */
static inline int lwb_take(struct lwb_board *b, const struct lwb_kind *k,
                           const union lwb_name *name, struct lwb_taken *taken)
{
    uint64_t offset, mine = 0;
    struct lwb_frame f;
    int status = lwb_reopen(b);
    for (int i = 0; !status; i++) {
        struct lwb_record *r = lwb_framed(b, i, &offset, &f, &status);
        if (r && lwb_take_over(b, r, &f, i, k, name, taken))
            return LWB_OK;
        if (status != LWB_MISSING)
            continue;
        if (i == LWB_MAX_SLOTS)
            return LWB_NO_SLOT;
        if (!mine && (status = lwb_write_record(b, k, name, &mine)))
            return status;
        lwb_lock_entry(b, i, F_WRLCK);
        uint64_t none = 0;
        if (atomic_compare_exchange_strong(&lwb_head(b)->slots[i], &none, mine)) {
            taken->record = lwb_frame_at(b, mine, &f);
            taken->generation = 1;
            taken->index = i;
            return taken->record ? LWB_OK : lwb_why();
        }
        lwb_lock_entry(b, i, F_UNLCK);
        status = LWB_OK; /* another process was first: look at its record */
        i--;
    }
    return status;
}

/* The record of that name, with its place and life; NULL with *status LWB_MISSING if there is none. */
static inline struct lwb_record *lwb_look_up(struct lwb_board *b, const union lwb_name *name,
                                             int *index, uint64_t *offset, struct lwb_frame *f,
                                             uint64_t *life, int *status)
{
    uint64_t sum = lwb_name_sum(name);
    union lwb_name found;
    bool damaged;
    for (int i = 0;; i++) {
        *index = i;
        struct lwb_record *r = lwb_framed(b, i, offset, f, status);
        if (!r || (atomic_load_explicit(&r->name_sum, memory_order_relaxed) == sum &&
                   lwb_name_of(r, &found, life, &damaged) && !strcmp(found.text, name->text)))
            return r;
    }
}

static inline int lwb_bind_kind(struct lwb_board *b, struct lwb_slot *slot, const char *called,
                                const struct lwb_kind *k, bool create)
{
    size_t n = strlen(called);
    if (!n || n > LWB_MAX_NAME || !k->frame.capacity || k->frame.capacity > LWB_MAX_CAPACITY)
        return LWB_INVALID;
    union lwb_name name = LWB_ZERO;
    memcpy(name.text, called, n);
    struct lwb_taken taken = LWB_ZERO;
    struct lwb_record *r;
    struct lwb_frame f = LWB_ZERO;
    uint64_t offset, life, base;
    int index, status;
    for (;;) {
        uint64_t named = atomic_load(&lwb_head(b)->named);
        lwb_complete(b, named);
        r = lwb_look_up(b, &name, &index, &offset, &f, &life, &status);
        if (r) {
            base = atomic_load_explicit(&r->base, memory_order_relaxed);
            atomic_thread_fence(memory_order_acquire); /* as in lwb_name_of */
            uint64_t now = atomic_load_explicit(&r->life, memory_order_relaxed);
            if (lwb_generation_of(now) == lwb_generation_of(life))
                break;
            continue; /* it has another name by now */
        }
        if (status != LWB_MISSING || !create)
            break;
        if (!taken.record && (status = lwb_take(b, k, &name, &taken)))
            break;
        if (atomic_compare_exchange_strong(&lwb_head(b)->named, &named,
                                           taken.generation << LWB_NAMED_BITS |
                                               (uint64_t)taken.index)) {
            lwb_complete(b, taken.generation << LWB_NAMED_BITS | (uint64_t)taken.index);
            lwb_lock_entry(b, taken.index, F_UNLCK);
            taken.record = NULL;
        }
    }
    if (taken.record) /* another process has given the name first: the next one takes the record */
        lwb_lock_entry(b, taken.index, F_UNLCK);
    if (!r)
        return status;
    if (!lwb_is_sound(r, &f))
        return LWB_CORRUPT;
    memset(slot, 0, sizeof *slot);
    slot->board = b;
    slot->record = r;
    slot->offset = offset;
    slot->index = index;
    slot->capacity = f.capacity;
    slot->frame = f;
    slot->life = lwb_life_of(lwb_generation_of(life), LWB_NAMED);
    slot->base = base;
    slot->stride = lwb_stride(f.capacity);
    slot->writer = -1;
    return f.fingerprint == k->frame.fingerprint ? LWB_OK : LWB_DIFFERS;
}

static inline int lwb_bind(struct lwb_board *b, struct lwb_slot *slot, const struct lwb_schema *s,
                           bool create)
{
    if (strlen(s->type) > LWB_MAX_NAME || strlen(s->text) > LWB_MAX_SCHEMA)
        return LWB_INVALID;
    struct lwb_kind kind = lwb_kind_of(s);
    return lwb_bind_kind(b, slot, s->name, &kind, create);
}

/* Open the slot; make it if it does not exist. If its `fingerprint` differs from the board's, the
 * status is LWB_DIFFERS, with the slot open for reading its schema. */
static inline int lwb_slot(struct lwb_board *b, struct lwb_slot *slot, const struct lwb_schema *s)
{
    return lwb_bind(b, slot, s, true);
}

/* Open a slot again whose handle is LWB_RENAMED; make it only with `create`, else LWB_MISSING. The
 * handle stays as it was if that fails. */
static inline int lwb_renew(struct lwb_slot *slot, const char *name, bool create)
{
    const char *texts = lwb_texts(slot->record); /* which stay, unless somebody damages them */
    struct lwb_kind kind = {texts, texts + slot->frame.type_length + 1, slot->frame};
    struct lwb_slot again;
    int status = lwb_bind_kind(slot->board, &again, name, &kind, create);
    if (!status)
        *slot = again;
    return status;
}

/* Give up the slot's name: its record may get another one of the same type. Until then the slot is
 * there, and lwb_add or lwb_make_ready takes the name back. */
static inline void lwb_vacate(struct lwb_slot *slot)
{
    uint64_t life = slot->life;
    uint64_t vacant = lwb_life_of(lwb_generation_of(life), LWB_VACANT);
    atomic_compare_exchange_strong(&slot->record->life, &life, vacant);
}

/* Whether the slot has its name, for who is to add; a vacant one takes it back. */
static inline bool lwb_keeps_name(struct lwb_slot *s)
{
    uint64_t life = atomic_load_explicit(&s->record->life, memory_order_relaxed);
    if (life == s->life)
        return true;
    return life == lwb_life_of(lwb_generation_of(s->life), LWB_VACANT) &&
           (atomic_compare_exchange_strong(&s->record->life, &life, s->life) || life == s->life);
}

/* Whether the record has another name by now. What was read from it before is the slot's own. */
static inline bool lwb_is_renamed(const struct lwb_slot *s)
{
    uint64_t life = atomic_load_explicit(&s->record->life, memory_order_relaxed);
    return lwb_generation_of(life) != lwb_generation_of(s->life);
}

/* The slot's word: it changes with every add and never repeats. */
static inline uint64_t lwb_word(const struct lwb_slot *s)
{
    return atomic_load_explicit(&s->record->word, memory_order_acquire);
}

/* Messages added so far under the slot's name, as a word of it says. */
static inline uint64_t lwb_number_of(const struct lwb_slot *s, uint64_t word)
{
    uint64_t count = lwb_count_of(word);
    return count > s->base ? count - s->base : 0;
}

/* Messages added so far; 0 if LWB_RENAMED. */
static inline uint64_t lwb_count(const struct lwb_slot *s)
{
    uint64_t word = lwb_word(s);
    return lwb_is_renamed(s) ? 0 : lwb_number_of(s, word);
}

/* ---- Adding -------------------------------------------------------------------------------- */

/* Claim a writer id, at the first add of this process and again after a fork. */
static inline int lwb_claim(struct lwb_board *b)
{
    int status = lwb_reopen(b);
    if (status)
        return status;
    for (int id = 0; id < LWB_MAX_WRITERS; id++) {
        if (lwb_lock(b->fd, F_OFD_SETLK, F_WRLCK, id) >= 0) {
            b->writer = id;
            return LWB_OK;
        }
        if (errno != EAGAIN && errno != EACCES)
            return LWB_SYSTEM;
    }
    return LWB_NO_WRITER;
}

/* Find this process's buffers in the slot: those of a dead owner of the same id, or new ones. */
static inline int lwb_own(struct lwb_slot *s)
{
    struct lwb_board *b = s->board;
    if (b->writer < 0 || !lwb_is_same(b)) {
        int status = lwb_claim(b);
        if (status)
            return status;
    }
    unsigned id = (unsigned)b->writer;
    lwb_atomic64 *entry = &s->record->blocks[id];
    uint64_t offset = atomic_load_explicit(entry, memory_order_acquire);
    if (!offset) {
        void *at;
        int status = lwb_allocate(b, lwb_block_size(s->capacity), &offset, &at);
        if (status)
            return status;
        struct lwb_block *block = (struct lwb_block *)at;
        block->magic = LWB_BLOCK_MAGIC;
        block->slot = s->offset;
        block->writer = id;
        block->checksum = lwb_block_sum(block);
        atomic_store_explicit(entry, offset, memory_order_release);
    }
    s->own = lwb_block_at(b, offset, s->offset, id, s->capacity);
    s->writer = b->writer;
    s->next = 0;
    return s->own ? LWB_OK : lwb_why();
}

static inline int lwb_keep_own(struct lwb_slot *s)
{
    struct lwb_board *b = s->board;
    return s->own && s->writer == b->writer && lwb_is_same(b) ? LWB_OK : lwb_own(s);
}

/* Reserve what this process needs to add to the slot: adds need no more memory after that. */
static inline int lwb_make_ready(struct lwb_slot *s)
{
    return lwb_if_kept(s->board, lwb_keeps_name(s) ? lwb_keep_own(s) : LWB_RENAMED);
}

/* The same for who only looks after it for others: a name that was given up stays so. */
static inline int lwb_make_ready_if_named(struct lwb_slot *s)
{
    uint64_t life = atomic_load_explicit(&s->record->life, memory_order_relaxed);
    return lwb_if_kept(s->board, life == s->life ? lwb_keep_own(s) : LWB_RENAMED);
}

/* Wake the waiting processes, after the swap. `waiting` becomes even and a new number, so a process
 * that was about to sleep on the odd number does not, but reads the word again. (With a mere flag
 * it would sleep with the flag cleared, and the next writer would not wake it.) */
static inline void lwb_ring(lwb_atomic32 *waiting)
{
    uint32_t now = atomic_load(waiting);
    if (now % 2) {
        atomic_compare_exchange_strong(waiting, &now, now + 1); /* otherwise another writer did */
        syscall(SYS_futex, waiting, FUTEX_WAKE, INT32_MAX, NULL, NULL, 0);
    }
}

/* Wake those who wait for several slots, and have one of `bits` in the set for which they wait. */
static inline void lwb_raise(lwb_atomic32 *alarm, uint32_t bits)
{
    atomic_fetch_add(alarm, 1);
    syscall(SYS_futex, alarm, FUTEX_WAKE_BITSET, INT32_MAX, NULL, NULL, bits);
}

enum { LWB_ALARM_BITS = 31 }; /* those of slots; the bit above them is everybody's */

static inline uint32_t lwb_alarm_bit(const struct lwb_slot *s)
{
    return UINT32_C(1) << s->offset / 64 % LWB_ALARM_BITS;
}

/* The word on which those sleep who wait for any of several slots. */
static inline lwb_atomic32 *lwb_alarm(struct lwb_board *b) { return &lwb_head(b)->alarm; }

static inline void lwb_wake(struct lwb_slot *s)
{
    lwb_ring(&s->record->waiting);
    lwb_ring(&lwb_head(s->board)->watching);
    /* Disarm first: who arms the slot after that sees the new word, and who did so before is woken,
     * as each who disarms also raises the alarm. A sleeper that was killed costs one alarm. */
    if (atomic_load(&s->record->armed)) {
        atomic_store(&s->record->armed, 0);
        lwb_raise(lwb_alarm(s->board), lwb_alarm_bit(s));
    }
}

#define LWB_ANY UINT64_MAX
#define LWB_AHEAD 128 /* words between the one that is stored and the one that is fetched for it */

/* Add a message if the slot's count still is `after`, else return LWB_PASSED; with LWB_ANY, add in
 * any case. Never blocks. */
static inline int lwb_add_after(struct lwb_slot *s, const void *data, size_t length,
                                uint64_t after, uint64_t *count)
{
    if (length > s->capacity)
        return LWB_TOO_LARGE;
    struct lwb_board *b = s->board;
    int status = lwb_keep_own(s);
    if (status)
        return status;
    lwb_atomic64 *slot_word = &s->record->word;
    uint64_t word = lwb_word(s);
    if (lwb_writer_of(word) == (unsigned)s->writer && lwb_buffer_of(word) == (unsigned)s->next)
        s->next = (s->next + 1) % LWB_BUFFERS; /* readers use the published one */
    struct lwb_buffer *buffer = lwb_buffer_at(s->own, (unsigned)s->next, s->stride);

    /* Set the count to 0 before the payload: a reader that has read any of the new payload sees,
     * after its acquire fence, that the count is no longer the one it started with. The store is a
     * release, so that a reader that sees it also sees the word that this writer saw (lwb_read). */
    atomic_store_explicit(&buffer->count, 0, memory_order_release);
    atomic_thread_fence(memory_order_release);
    const unsigned char *from = (const unsigned char *)data;
    size_t words = length / 8, rest = length % 8;
    for (size_t i = 0; i < words; i++) {
        /* Of a large message, a writer that has slept finds the buffer in no cache. */
        if (i % 8 == 0 && i + LWB_AHEAD < words)
            __builtin_prefetch((const void *)&buffer->payload[i + LWB_AHEAD], 1);
        uint64_t w;
        memcpy(&w, from + 8 * i, 8);
        atomic_store_explicit(&buffer->payload[i], w, memory_order_relaxed);
    }
    if (rest) {
        uint64_t w = 0;
        memcpy(&w, from + 8 * words, rest);
        atomic_store_explicit(&buffer->payload[words], w, memory_order_relaxed);
    }
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    atomic_store_explicit(&buffer->length, length, memory_order_relaxed);
    atomic_store_explicit(&buffer->process, b->process, memory_order_relaxed);
    uint64_t stamp = (uint64_t)now.tv_sec * 1000000000u + (uint64_t)now.tv_nsec;
    atomic_store_explicit(&buffer->stamp, stamp, memory_order_relaxed);
    uint64_t place = (uint64_t)s->writer << 4 | (uint64_t)s->next, mine;
    do {
        if (!lwb_keeps_name(s))
            return lwb_if_kept(b, LWB_RENAMED); /* the buffer stays unused: the word does not name it */
        if (after != LWB_ANY && lwb_number_of(s, word) != after)
            return LWB_PASSED;
        mine = (lwb_count_of(word) + 1) << 16 | place;
        atomic_store_explicit(&buffer->count, lwb_count_of(mine), memory_order_relaxed);
        /* Sequentially consistent, like the load in lwb_wake and both steps of lwb_wait: either
         * this writer sees the waiter, or the waiter sees the new word. If it fails, it acquires:
         * the name is looked at after the word. */
    } while (!atomic_compare_exchange_weak_explicit(slot_word, &word, mine, memory_order_seq_cst,
                                                    memory_order_acquire));
    s->next = (s->next + 1) % LWB_BUFFERS;
    if (count)
        *count = lwb_number_of(s, mine);
    lwb_wake(s);
    return lwb_if_kept(b, LWB_OK);
}

/* Add a message. Never blocks. */
static inline int lwb_add(struct lwb_slot *s, const void *data, size_t length, uint64_t *count)
{
    return lwb_add_after(s, data, length, LWB_ANY, count);
}

/* ---- Getting ------------------------------------------------------------------------------- */

/* Copy the latest message, at most `room` bytes of it; meta->length is its full length. If the
 * buffer was overwritten during the copy, its count has changed, and the reader starts again with
 * the message that is the latest by then. */
static inline int lwb_read(struct lwb_slot *s, void *data, size_t room, struct lwb_meta *meta)
{
    for (;;) {
        uint64_t word = lwb_word(s);
        unsigned writer = lwb_writer_of(word), index = lwb_buffer_of(word);
        if (lwb_is_renamed(s))
            return lwb_if_kept(s->board, LWB_RENAMED);
        meta->word = word;
        meta->count = lwb_number_of(s, word);
        if (!meta->count)
            return lwb_if_kept(s->board, LWB_EMPTY);
        if (writer >= LWB_MAX_WRITERS || index >= LWB_BUFFERS)
            return LWB_CORRUPT;
        struct lwb_block *block = s->seen[writer];
        if (!block) {
            uint64_t at = atomic_load_explicit(&s->record->blocks[writer], memory_order_acquire);
            block = s->seen[writer] = lwb_block_at(s->board, at, s->offset, writer, s->capacity);
            if (!block)
                return lwb_why();
        }
        struct lwb_buffer *buffer = lwb_buffer_at(block, index, s->stride);
        meta->length = atomic_load_explicit(&buffer->length, memory_order_relaxed);
        meta->stamp = atomic_load_explicit(&buffer->stamp, memory_order_relaxed);
        meta->process = atomic_load_explicit(&buffer->process, memory_order_relaxed);
        size_t take = meta->length < room ? meta->length : room;
        if (take > s->capacity)
            take = s->capacity;
        unsigned char *to = (unsigned char *)data;
        size_t words = take / 8, rest = take % 8;
        for (size_t i = 0; i < words; i++) {
            uint64_t w = atomic_load_explicit(&buffer->payload[i], memory_order_relaxed);
            memcpy(to + 8 * i, &w, 8);
        }
        if (rest) {
            uint64_t w = atomic_load_explicit(&buffer->payload[words], memory_order_relaxed);
            memcpy(to + 8 * words, &w, rest);
        }
        atomic_thread_fence(memory_order_acquire);
        if (atomic_load_explicit(&buffer->count, memory_order_relaxed) == lwb_count_of(word))
            return meta->length <= s->capacity ? lwb_if_kept(s->board, LWB_OK) : LWB_CORRUPT;
        /* The owner only overwrites a buffer that the word does not name. So if the word is still
         * the same, the buffer is damaged, and starting again would never end. The fence pairs
         * with the owner's release of the count that was just read. */
        atomic_thread_fence(memory_order_acquire);
        if (lwb_word(s) == word)
            return LWB_CORRUPT;
    }
}

/* The messages of `writer` that its buffers still hold, without their payloads: at most LWB_BUFFERS,
 * in no order. One that lost to another message in lwb_add_after may be among them, with the other
 * one's count, and one that is being added, which has its count before the word is swapped. */
static inline int lwb_recent(struct lwb_slot *s, unsigned writer, struct lwb_meta *metas, int *found)
{
    *found = 0;
    uint64_t at = atomic_load_explicit(&s->record->blocks[writer], memory_order_acquire);
    if (!at)
        return LWB_OK;
    struct lwb_block *block = s->seen[writer];
    if (!block && !(block = s->seen[writer] =
                        lwb_block_at(s->board, at, s->offset, writer, s->capacity)))
        return lwb_why();
    for (unsigned i = 0; i < LWB_BUFFERS; i++) {
        struct lwb_buffer *buffer = lwb_buffer_at(block, i, s->stride);
        struct lwb_meta *meta = &metas[*found];
        uint64_t count = atomic_load_explicit(&buffer->count, memory_order_acquire);
        meta->count = lwb_number_of(s, count << 16);
        meta->stamp = atomic_load_explicit(&buffer->stamp, memory_order_relaxed);
        meta->process = atomic_load_explicit(&buffer->process, memory_order_relaxed);
        atomic_thread_fence(memory_order_acquire);
        if (meta->count && /* as in lwb_read: a writer first sets it to 0 */
            atomic_load_explicit(&buffer->count, memory_order_relaxed) == count)
            ++*found;
    }
    return lwb_is_renamed(s) ? LWB_RENAMED : LWB_OK;
}

/* Announce that this process is about to wait. */
static inline uint32_t lwb_announce(lwb_atomic32 *waiting)
{
    return atomic_fetch_or(waiting, 1) | 1;
}

#define LWB_LOOK_NS 50000000u /* the longest sleep: a writer may die between swap and wake */

/* Sleep while `waiting` is `odd`, for at most `ns` and at most LWB_LOOK_NS. */
static inline void lwb_sleep(lwb_atomic32 *waiting, uint32_t odd, uint64_t ns)
{
    struct timespec look = {0, (long)(ns < LWB_LOOK_NS ? ns : LWB_LOOK_NS)};
    syscall(SYS_futex, waiting, FUTEX_WAIT, odd, &look, NULL, 0);
}

/* LWB_OK if the count exceeds `after`, else LWB_TIMEOUT. The word is read sequentially consistently,
 * for lwb_wait: see lwb_add_after. */
static inline int lwb_is_newer(const struct lwb_slot *s, uint64_t after)
{
    uint64_t word = atomic_load(&s->record->word);
    return lwb_is_renamed(s) ? LWB_RENAMED : lwb_number_of(s, word) > after ? LWB_OK : LWB_TIMEOUT;
}

/* Wait until the count exceeds `after`, for at most `ns`. May return LWB_TIMEOUT early, after a
 * signal or 50 ms: call it again while there is time left. */
static inline int lwb_wait(struct lwb_slot *s, uint64_t after, uint64_t ns)
{
    int status = lwb_is_newer(s, after);
    if (status != LWB_TIMEOUT)
        return status;
    lwb_atomic32 *waiting = &s->record->waiting;
    uint32_t odd = lwb_announce(waiting);
    if (lwb_is_newer(s, after) == LWB_TIMEOUT)
        lwb_sleep(waiting, odd, ns);
    return lwb_is_newer(s, after);
}

/* ---- Waiting for any of several slots -------------------------------------------------------
 * The sleepers share one word of the board. A writer looks only whether its own slot is armed, so
 * a slot for which nobody waits wakes nobody. */

/* As LWB_LOOK_NS, but longer: machines that wait for slots should not wake a processor for it. */
#define LWB_LOOK_ANY_NS 250000000u

struct lwb_awaited { struct lwb_slot *slot; uint64_t after; };

/* Wait until the count of one of the slots exceeds its `after`, for at most `ns`. May return
 * LWB_TIMEOUT early: after a signal or 250 ms, and if the alarm was raised since the caller has read
 * `seen` from it. So a caller that first reads it, and then checks something else, can be woken for
 * that by lwb_raise. */
static inline int lwb_wait_any(lwb_atomic32 *alarm, uint32_t seen,
                               const struct lwb_awaited *awaited, size_t number, uint64_t ns)
{
    uint32_t bits = UINT32_C(1) << LWB_ALARM_BITS;
    for (size_t i = 0; i < number; i++) {
        atomic_store(&awaited[i].slot->record->armed, 1);
        int status = lwb_is_newer(awaited[i].slot, awaited[i].after);
        if (status != LWB_TIMEOUT)
            return status;
        bits |= lwb_alarm_bit(awaited[i].slot);
    }
    struct timespec until; /* this kind of wait takes a time, not a duration */
    clock_gettime(CLOCK_MONOTONIC, &until);
    uint64_t nanoseconds = (uint64_t)until.tv_nsec + (ns < LWB_LOOK_ANY_NS ? ns : LWB_LOOK_ANY_NS);
    until.tv_sec += (time_t)(nanoseconds / 1000000000u);
    until.tv_nsec = (long)(nanoseconds % 1000000000u);
    syscall(SYS_futex, alarm, FUTEX_WAIT_BITSET, seen, &until, NULL, bits);
    for (size_t i = 0; i < number; i++) {
        int status = lwb_is_newer(awaited[i].slot, awaited[i].after);
        if (status != LWB_TIMEOUT)
            return status;
    }
    return LWB_TIMEOUT;
}

/* ---- Who reads -----------------------------------------------------------------------------
 * A process that reads a slot may declare that, for who brings messages from elsewhere only if they
 * are read. It holds a shared lock on a byte of that slot, which the kernel releases when the process
 * dies. That changes no count: look again now and then. */

/* Declare that the slot is read through this handle; end it as often as it was begun, or close the
 * board. A renamed handle's declaration is about the slot that has its record now: end it first. */
static inline int lwb_begin_reading(struct lwb_slot *s)
{
    struct lwb_board *b = s->board;
    int status = lwb_reopen(b);
    if (status)
        return status;
    if (!b->reading[s->index] && lwb_lock_reading(b->fd, F_OFD_SETLK, F_RDLCK, s->index) < 0)
        return LWB_SYSTEM;
    if (!b->reading[s->index]++) {
        atomic_fetch_add(&lwb_head(b)->readings, 1);
        lwb_ring(&lwb_head(b)->watching);
    }
    return LWB_OK;
}

static inline void lwb_end_reading(struct lwb_slot *s)
{
    struct lwb_board *b = s->board;
    if (--b->reading[s->index] || !lwb_is_same(b)) /* a child's copy of its parent's lock */
        return;
    lwb_lock_reading(b->fd, F_OFD_SETLK, F_UNLCK, s->index);
    atomic_fetch_add(&lwb_head(b)->readings, 1);
    lwb_ring(&lwb_head(b)->watching);
}

/* Whether slot `index` is read, as declared through this board or by any other process. */
static inline bool lwb_is_read(const struct lwb_board *b, int index)
{
    return b->reading[index] || lwb_lock_reading(b->fd, F_OFD_GETLK, F_WRLCK, index) == 1;
}

/* How often a process has begun to read a slot, or ended. */
static inline uint32_t lwb_readings(struct lwb_board *b)
{
    return atomic_load(&lwb_head(b)->readings);
}

/* ---- Watching all slots --------------------------------------------------------------------
 * To wait for any slot: call lwb_changed, lwb_announce, lwb_changed again, then lwb_sleep with the
 * announced number; repeat. Other threads may use the board only during the sleep. */

/* Write the indices of the slots whose word differs from the one in `words` to `which`, and update
 * `words`; both have room for LWB_MAX_SLOTS. */
static inline int lwb_changed(struct lwb_board *b, uint64_t *words, uint32_t *which, int *number)
{
    uint64_t offset;
    int status = LWB_OK;
    *number = 0;
    for (int i = 0;; i++) {
        struct lwb_record *r = lwb_slot_at(b, i, &offset, &status);
        if (!r)
            return status == LWB_MISSING ? LWB_OK : status;
        uint64_t word = atomic_load(&r->word);
        if (word != words[i]) {
            words[i] = word;
            which[(*number)++] = (uint32_t)i;
        }
    }
}

#endif
