/* Many threads hammer one board through llfsm_whiteboard.h. What must hold:
 *
 *   1. A reader gets a whole message: every byte follows from its head, its length and its slot.
 *   2. The count that a reader sees in a slot never decreases.
 *   3. One count stands for one message, whoever reads it and whoever wrote it.
 *   4. In the end a slot's count is the number of adds done.
 *   5. Who waits, for one slot or for any of several, is woken by the very next add.
 *   6. Threads that make a slot of one name at the same time get one slot.
 *
 *     stress SECONDS [WRITERS [SEED]]
 *
 * ends with 0 if all held; else it says what did not, and does not. Every thread opens the board
 * for itself, as processes do. See interference.h for what makes the run rough. */
#include "interference.h"

#include <inttypes.h>
#include <stdarg.h>
#include <stdbool.h>

#include "llfsm_whiteboard.h"

enum { SLOTS = 4, LARGEST = 65536, RING = 1 << 16, MAKERS = 3, MADE = 200, WAITERS = 2, PONGS = 4,
       RARELY = 2000, OFTEN = 30 };

/* Not all multiples of 8; the largest takes long enough to copy to be caught in the middle. */
static const size_t capacities[SLOTS] = {21, 200, 3000, LARGEST};

static char path[64];
static uint64_t seed = 1;
static pthread_barrier_t opened, next_slot;
static _Atomic bool stop, over; /* the run; the ping-pong */
static _Atomic uint64_t added[SLOTS], made[MADE], reads, changes, rounds, woken;
static _Atomic uint64_t known[SLOTS][RING]; /* count << 24 | hash of the message with this count */

static _Noreturn void fail(const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    fprintf(stderr, "stress (seed %" PRIu64 "): ", seed);
    vfprintf(stderr, format, arguments);
    fputc('\n', stderr);
    unlink(path);
    _exit(1);
}

static void succeed(int status, const char *what)
{
    if (status)
        fail("%s: %s", what, lwb_describe(status));
}

/* ---- Messages: a head (writer, sequence), then words that follow from it -------------------- */

static uint64_t identity(uint64_t head, size_t length, int slot)
{
    return mix(mix(head) ^ length << 8 ^ (uint64_t)slot);
}

static uint64_t word_of(uint64_t head, uint64_t identity, size_t at)
{
    return at ? identity * (2 * at + 1) ^ at << 40 : head;
}

static void fill(unsigned char *to, uint64_t head, size_t length, int slot)
{
    uint64_t id = identity(head, length, slot);
    for (size_t at = 0; at < length; at += 8) {
        uint64_t word = word_of(head, id, at);
        memcpy(to + at, &word, length - at < 8 ? length - at : 8);
    }
}

/* One count, one message. */
static void note(int slot, uint64_t count, uint64_t id)
{
    _Atomic uint64_t *place = &known[slot][count % RING];
    uint64_t ours = count << 24 | (id & 0xffffff), theirs = atomic_load(place);
    while (theirs >> 24 < count && !atomic_compare_exchange_weak(place, &theirs, ours))
        ;
    if (theirs >> 24 == count && theirs != ours)
        fail("slot %d: two messages of count %" PRIu64, slot, count);
}

/* Check the `have` bytes that were read of a message. */
static void verify(const unsigned char *data, size_t have, const struct lwb_meta *meta, int slot)
{
    if (meta->process != (uint64_t)getpid())
        fail("slot %d: from process %" PRIu64, slot, meta->process);
    uint64_t head = 0;
    if (meta->length && have < 8)
        return;
    memcpy(&head, data, meta->length ? 8 : 0);
    uint64_t id = identity(head, meta->length, slot);
    for (size_t at = 0; at < have; at += 8) {
        uint64_t word = word_of(head, id, at);
        if (memcmp(data + at, &word, have - at < 8 ? have - at : 8))
            fail("slot %d, count %" PRIu64 ": torn at byte %zu of %zu", slot, meta->count, at,
                 meta->length);
    }
    note(slot, meta->count, id);
}

/* ---- Threads -------------------------------------------------------------------------------- */

struct thread {
    pthread_t id;
    uint64_t number;
    struct lwb_board board;
    struct lwb_slot slots[SLOTS];
    uint64_t last[SLOTS];
    unsigned char data[LARGEST + 1];
};

static void open_slot(struct thread *t, struct lwb_slot *slot, const char *kind, int number,
                      size_t capacity)
{
    char name[32];
    snprintf(name, sizeof name, "%s/%d", kind, number);
    struct lwb_schema schema = {name, "bytes", "{}", 1, capacity};
    succeed(lwb_slot(&t->board, slot, &schema), name);
}

static void begin(struct thread *t, unsigned yields)
{
    yield_within = yields;
    dice = mix(seed) ^ mix(t->number);
    succeed(lwb_open(&t->board, path, true), "open");
    for (int k = 0; k < SLOTS; k++)
        open_slot(t, &t->slots[k], "slot", k, capacities[k]);
    if (pthread_barrier_wait(&opened) == PTHREAD_BARRIER_SERIAL_THREAD)
        unlink(path); /* all have it: nothing can be left behind */
}

static uint64_t add(struct thread *t, int k, uint64_t head, size_t length)
{
    uint64_t count = 0;
    fill(t->data, head, length, k);
    succeed(lwb_add(&t->slots[k], t->data, length, &count), "add");
    atomic_fetch_add(&added[k], 1);
    note(k, count, identity(length ? head : 0, length, k));
    return count;
}

static bool read_one(struct thread *t, int k, size_t room)
{
    struct lwb_meta meta = {0};
    t->data[room] = 0xa5;
    int status = lwb_read(&t->slots[k], t->data, room, &meta);
    if (t->data[room] != 0xa5)
        fail("slot %d: read beyond the room of %zu", k, room);
    if (status == LWB_EMPTY && !t->last[k])
        return false;
    succeed(status, "read");
    if (meta.count < t->last[k])
        fail("slot %d: count %" PRIu64 " after %" PRIu64, k, meta.count, t->last[k]);
    verify(t->data, meta.length < room ? meta.length : room, &meta, k);
    bool newer = meta.count > t->last[k];
    t->last[k] = meta.count;
    return newer;
}

static int any_slot(void)
{ /* the large one less often, or there would be little else */
    int k = (int)(random_number() % 16);
    return k == 0 ? SLOTS - 1 : k % (SLOTS - 1);
}

static void *write_messages(void *argument)
{
    struct thread *t = argument;
    begin(t, RARELY);
    for (uint64_t sequence = 1; !stop; sequence++) {
        int k = any_slot();
        if (sequence % 256 == 0) /* a new handle, as a new owner of our writer id would have */
            open_slot(t, &t->slots[k], "slot", k, capacities[k]);
        uint64_t any = random_number(), kind = any >> 60;
        size_t length = kind == 0 ? 0 : kind == 1 ? capacities[k]
                                                  : 8 + (any & 0xffffffff) % (capacities[k] - 7);
        uint64_t count = add(t, k, t->number << 32 | sequence, length);
        if (count <= t->last[k])
            fail("slot %d: an add got %" PRIu64 " after %" PRIu64, k, count, t->last[k]);
        t->last[k] = count;
    }
    lwb_close(&t->board);
    return NULL;
}

static void *read_messages(void *argument)
{
    struct thread *t = argument;
    begin(t, RARELY);
    uint64_t done = 0, newer = 0;
    for (; !stop; done++) {
        int k = any_slot();
        uint64_t any = random_number();
        newer += read_one(t, k, any >> 62 ? capacities[k] : any % (capacities[k] + 1));
    }
    atomic_fetch_add(&reads, done);
    atomic_fetch_add(&changes, newer);
    lwb_close(&t->board);
    return NULL;
}

/* Waits where many add. */
static void *wait_for_messages(void *argument)
{
    struct thread *t = argument;
    begin(t, OFTEN);
    while (!stop)
        if (lwb_wait(&t->slots[0], t->last[0], UINT64_MAX) == LWB_OK) {
            if (!read_one(t, 0, capacities[0]))
                fail("woken, but there is nothing newer than %" PRIu64, t->last[0]);
            atomic_fetch_add(&woken, 1);
        }
    lwb_close(&t->board);
    return NULL;
}

static void wait_beyond(struct lwb_slot *slot, uint64_t count)
{
    while (lwb_wait(slot, count, UINT64_MAX) == LWB_TIMEOUT)
        ; /* woken by what was not newer */
}

/* Waits for either slot, although only the first one changes. */
static void wait_beyond_among(struct lwb_slot *slot, uint64_t count, struct lwb_slot *other)
{
    const struct lwb_awaited awaited[] = {{slot, count}, {other, UINT64_MAX}};
    lwb_atomic32 *alarm = lwb_alarm(slot->board);
    while (lwb_wait_any(alarm, atomic_load(alarm), awaited, 2, UINT64_MAX) == LWB_TIMEOUT)
        ;
}

static void wait_in_turn(uint64_t turn, struct lwb_slot *slot, uint64_t count,
                         struct lwb_slot *other)
{
    if (turn % 2)
        wait_beyond(slot, count);
    else
        wait_beyond_among(slot, count, other);
}

/* One thread wakes some, and all of them together wake it: with one lost wake-up all sleep. */
static void *ping(void *argument)
{
    struct thread *t = argument;
    struct lwb_slot ping, pong;
    begin(t, OFTEN);
    open_slot(t, &ping, "ping", 0, 8);
    open_slot(t, &pong, "pong", 0, 8);
    for (uint64_t count = 0; !stop; count++) {
        succeed(lwb_add(&ping, NULL, 0, NULL), "ping");
        wait_in_turn(count, &pong, PONGS * count + PONGS - 1, &ping);
        atomic_fetch_add(&rounds, 1);
    }
    over = true;
    succeed(lwb_add(&ping, NULL, 0, NULL), "the last ping");
    lwb_close(&t->board);
    return NULL;
}

static void *pong(void *argument)
{
    struct thread *t = argument;
    struct lwb_slot ping, pong;
    begin(t, OFTEN);
    open_slot(t, &ping, "ping", 0, 8);
    open_slot(t, &pong, "pong", 0, 8);
    for (uint64_t count = 0;; count++) {
        wait_in_turn(t->number, &ping, count, &pong);
        if (over)
            break;
        succeed(lwb_add(&pong, NULL, 0, NULL), "pong");
    }
    lwb_close(&t->board);
    return NULL;
}

/* Makes the slots that the other makers make, and adds one message to each. */
static void *make_slots(void *argument)
{
    struct thread *t = argument;
    begin(t, OFTEN);
    for (int i = 0; i < MADE; i++) {
        struct lwb_slot slot;
        pthread_barrier_wait(&next_slot);
        open_slot(t, &slot, "made", i, 5000); /* so large that the mapping has to grow */
        succeed(lwb_add(&slot, NULL, 0, NULL), "add to what was made");
        atomic_fetch_add(&made[i], 1);
    }
    lwb_close(&t->board);
    return NULL;
}

/* ---- The run -------------------------------------------------------------------------------- */

static void on_alarm(int signal)
{
    (void)signal;
    static const char text[] = "stress: hangs: a lost wake-up, or a loop without an end\n";
    _exit(write(STDERR_FILENO, text, sizeof text - 1) ? 1 : 1);
}

static void check_the_end(struct thread *t)
{
    for (int k = 0; k < SLOTS; k++) {
        if (lwb_count(&t->slots[k]) != added[k])
            fail("slot %d: count %" PRIu64 " after %" PRIu64 " adds", k, lwb_count(&t->slots[k]),
                 added[k]);
        read_one(t, k, capacities[k]);
    }
    for (int i = 0; i < MADE && made[i]; i++) {
        struct lwb_slot slot;
        open_slot(t, &slot, "made", i, 5000);
        if (lwb_count(&slot) != made[i])
            fail("made/%d: %" PRIu64 " makers, count %" PRIu64, i, made[i], lwb_count(&slot));
    }
}

int main(int count, char **arguments)
{
    unsigned seconds = count > 1 ? (unsigned)atoi(arguments[1]) : 0;
    int writers = count > 2 ? atoi(arguments[2]) : 4;
    seed = count > 3 ? strtoull(arguments[3], NULL, 0) : 1;
    if (!seconds || writers < 1 || count > 4) {
        fprintf(stderr, "usage: %s SECONDS [WRITERS [SEED]]\n", arguments[0]);
        return 2;
    }
    snprintf(path, sizeof path, "/dev/shm/llfsm.stress.%ld", (long)getpid());
    signal(SIGALRM, on_alarm);
    alarm(seconds + 180); /* on a busy machine a yield is long */

    struct { void *(*work)(void *); int many; } roles[] = {
        {write_messages, writers}, {read_messages, writers}, {wait_for_messages, WAITERS},
        {ping, 1}, {pong, PONGS}, {make_slots, MAKERS}};
    int total = 0;
    for (int role = 0; role < 6; role++)
        total += roles[role].many;
    struct thread *threads = calloc((size_t)total + 1, sizeof *threads), *own = &threads[total];
    if (!threads)
        fail("no memory");
    pthread_barrier_init(&opened, NULL, (unsigned)total + 1);
    pthread_barrier_init(&next_slot, NULL, MAKERS);
    for (int role = 0, i = 0; role < 6; role++)
        for (int one = 0; one < roles[role].many; one++, i++) {
            threads[i].number = (uint64_t)i + 1;
            if (pthread_create(&threads[i].id, NULL, roles[role].work, &threads[i]))
                fail("no thread");
        }
    begin(own, RARELY);
    sleep(seconds);
    stop = true;
    add(own, 0, 0, 8); /* wakes those who wait */
    for (int i = 0; i < total; i++)
        pthread_join(threads[i].id, NULL);
    check_the_end(own);
    lwb_close(&own->board);
    if (!changes || !woken || !rounds || !made[0])
        fail("nothing happened");
    printf("%" PRIu64 " adds, %" PRIu64 " reads, %" PRIu64 " of something new, %" PRIu64 " woken, %"
           PRIu64 " rounds of ping-pong\n",
           added[0] + added[1] + added[2] + added[3], reads, changes, woken, rounds);
    free(threads);
    return 0;
}
