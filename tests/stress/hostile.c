/* Processes use a board while another one, which may write to its file, changes it under them: any
 * byte, any word, and words of records in pairs, each put back soon after, so that those who look
 * find it sound, and then find something else. Whatever they find, they must not touch memory that is
 * not theirs, believe a length that a slot cannot have, or never come back.
 *
 *     hostile SECONDS [SEED [FILE]]
 *
 * ends with 0 if nobody did; build it with ASan and UBSan. A board that is damaged for good makes all
 * calls end early: so each board lives for a fraction of a second only. With a FILE, this board of
 * three slots or more is changed, never for good, and who uses it is another's matter. */
#ifndef _GNU_SOURCE
#define _GNU_SOURCE 1
#endif
#include <inttypes.h>
#include <stdbool.h>
#include <sys/prctl.h>
#include <sys/resource.h>

#include "llfsm_whiteboard.h"

enum { SLOTS = 3, WORKERS = 6, HANGS_S = 20, LIFE_MS = 150, LARGEST = 3000 };
static const size_t capacities[SLOTS] = {21, 200, 3000};
static char names[SLOTS][LWB_MAX_NAME + 1] = {"first/slot", "second"}; /* the third: the longest */

static char path[64], new_path[72];
static uint64_t dice;
static struct { _Atomic uint64_t steps[WORKERS], sound, damaged; } *shared;

static uint64_t draw(void)
{ /* splitmix64 */
    uint64_t x = dice += 0x9e3779b97f4a7c15u;
    x = (x ^ x >> 30) * 0xbf58476d1ce4e5b9u;
    x = (x ^ x >> 27) * 0x94d049bb133111ebu;
    return x ^ x >> 31;
}

static void wrong(const char *what)
{
    fprintf(stderr, "hostile: %s\n", what);
    abort();
}

static struct lwb_schema schema_of(unsigned i)
{
    struct lwb_schema s = {names[i % SLOTS], "Type", "{\"a\": 1}", 7, capacities[i % SLOTS]};
    return s;
}

/* ---- Those who use the board ----------------------------------------------------------------- */

static void read_slot(struct lwb_slot *s)
{
    size_t most = s->capacity < LARGEST ? s->capacity : LARGEST; /* it may have been changed */
    size_t room = draw() % 2 ? most : draw() % (most + 1);
    unsigned char *data = malloc(room ? room : 1); /* of just the size, for ASan */
    struct lwb_meta meta, recent[LWB_BUFFERS];
    int found;
    if (!lwb_read(s, data, room, &meta) && meta.length > s->capacity)
        wrong("a message is longer than its slot allows");
    if (!lwb_recent(s, (unsigned)(draw() % LWB_MAX_WRITERS), recent, &found) &&
        (found < 0 || found > LWB_BUFFERS))
        wrong("a writer has more messages than buffers");
    free(data);
}

static void add_to_slot(struct lwb_slot *s)
{
    unsigned char data[LARGEST];
    uint64_t count;
    memset(data, (int)draw(), sizeof data);
    lwb_add_after(s, data, draw() % LARGEST % (s->capacity + 1), draw() % 4 ? LWB_ANY : draw() % 5, &count);
}

static void list_slots(struct lwb_board *b)
{
    int status;
    for (int i = 0; i < 8; i++) {
        uint64_t offset, life;
        struct lwb_frame f;
        struct lwb_record *r = lwb_framed(b, i, &offset, &f, &status);
        if (!r)
            break;
        union lwb_name name;
        bool damaged;
        const char *volatile text_of = name.text; /* else the compiler trusts that it ends */
        if (lwb_name_of(r, &name, &life, &damaged) && strlen(text_of) > LWB_MAX_NAME)
            wrong("a name does not end");
        char *type = malloc(LWB_MAX_NAME + 1);
        memcpy(type, lwb_texts(r), f.type_length);
        free(type);
        if (lwb_is_sound(r, &f)) {
            if (f.schema_length > LWB_MAX_SCHEMA)
                wrong("a schema is longer than any");
            char *text = malloc(f.schema_length + 1u);
            memcpy(text, lwb_texts(r) + f.type_length + 1, f.schema_length);
            free(text);
        }
    }
}

static void wait_for_slots(struct lwb_board *b, struct lwb_slot *slots)
{
    struct lwb_awaited awaited[SLOTS];
    for (int i = 0; i < SLOTS; i++)
        awaited[i] = (struct lwb_awaited){&slots[i], lwb_count(&slots[i])};
    lwb_wait(&slots[draw() % SLOTS], draw() % 3, 100000);
    lwb_atomic32 *alarm = lwb_alarm(b);
    lwb_wait_any(alarm, atomic_load(alarm), awaited, SLOTS, 100000);
}

/* Use one board in the way of a worker for a while; return whether it could be opened. */
static bool use(unsigned worker)
{
    struct lwb_board *b = malloc(sizeof *b);
    struct lwb_slot *slots = calloc(SLOTS, sizeof *slots);
    bool opened = !lwb_open(b, path, false);
    bool bound = opened;
    for (unsigned i = 0; bound && i < SLOTS; i++) {
        struct lwb_schema schema = schema_of(i);
        bound = !lwb_bind(b, &slots[i], &schema, worker % 2);
        if (bound && slots[i].capacity > LWB_MAX_CAPACITY)
            wrong("a slot has a capacity that none can have");
    }
    for (int i = 0; bound && i < 300; i++) {
        unsigned at = (unsigned)(draw() % SLOTS);
        switch (worker % 6) {
        case 0: read_slot(&slots[at]); break;
        case 1: add_to_slot(&slots[at]); break;
        case 2: list_slots(b); break;
        case 3: i % 4 ? add_to_slot(&slots[at]) : wait_for_slots(b, slots); break;
        case 4: read_slot(&slots[at]); list_slots(b); i += 5; break;
        default:
            if (lwb_renew(&slots[at], names[draw() % SLOTS], true))
                break;
            if (draw() % 2)
                lwb_vacate(&slots[at]);
            read_slot(&slots[at]);
        }
        atomic_fetch_add(&shared->steps[worker], 1);
    }
    if (opened)
        lwb_close(b);
    free(slots);
    free(b);
    atomic_fetch_add(&shared->steps[worker], 1);
    atomic_fetch_add(bound ? &shared->sound : &shared->damaged, 1);
    return opened;
}

/* ---- Who changes it ------------------------------------------------------------------------- */

static uint64_t odd_value(uint64_t was)
{
    static const uint64_t edges[] = {0, 1, 7, 255, 256, 257, 4096, 1u << 20, 1u << 30, UINT32_MAX,
                                     (uint64_t)1 << 46, (uint64_t)1 << 63, UINT64_MAX};
    switch (draw() % 5) {
    case 0: return edges[draw() % (sizeof edges / sizeof *edges)];
    case 1: return was ^ (uint64_t)1 << draw() % 64;
    case 2: return was + (draw() % 2 ? 8 : -(uint64_t)8) * (1 + draw() % 600);
    case 3: return (was & 0xffffffff00000000u) | edges[draw() % 10];
    default: return draw();
    }
}

/* The words that decide most: those of the header, and of the slots' records and blocks. */
static size_t place_in(const unsigned char *map, size_t size)
{
    const struct lwb_header *h = (const struct lwb_header *)(const void *)map;
    size_t record = (size_t)atomic_load(&h->slots[draw() % SLOTS]);
    if (draw() % 8 == 0 || record + sizeof(struct lwb_record) + 64 > size)
        return draw() % (size / 8) * 8;
    if (draw() % 4 == 0)
        return draw() % (sizeof *h / 8) * 8;
    if (draw() % 4 == 0)
        return record + offsetof(struct lwb_record, name) +
               (draw() % 2 ? draw() % LWB_NAME_WORDS : LWB_NAME_WORDS - 1) * 8;
    if (draw() % 2)
        return record + draw() % 18 * 8; /* magic, lengths, life, word, the first blocks */
    const struct lwb_record *r = (const struct lwb_record *)(const void *)(map + record);
    uint64_t word = atomic_load(&r->word);
    size_t block = (size_t)atomic_load(&r->blocks[lwb_writer_of(word) % LWB_MAX_WRITERS]);
    size_t at = draw() % 2 ? draw() % 40 * 8 /* anything at its beginning; the published head */
              : 64 + lwb_buffer_of(word) * lwb_stride(r->capacity % 4096) + draw() % 4 * 8;
    return block && block + at + 8 < size ? block + at : record;
}

static void change(unsigned char *map, size_t size)
{
    size_t at[2], number = 1 + draw() % 2;
    uint64_t was[2];
    for (size_t i = 0; i < number; i++) {
        at[i] = place_in(map, size) / 8 * 8;
        if (at[i] + 8 > size)
            at[i] = 0;
        was[i] = atomic_load((lwb_atomic64 *)(void *)(map + at[i]));
    }
    uint64_t other[2] = {odd_value(was[0]), number > 1 ? odd_value(was[1]) : 0};
    for (unsigned n = 1 + (unsigned)(draw() % 300); n--;) {
        for (size_t i = 0; i < number; i++)
            atomic_store((lwb_atomic64 *)(void *)(map + at[i]), other[i]);
        for (volatile unsigned rest = (unsigned)(draw() % 40); rest;)
            rest--;
        for (size_t i = 0; i < number; i++)
            atomic_store((lwb_atomic64 *)(void *)(map + at[i]), was[i]);
        for (volatile unsigned rest = (unsigned)(draw() % 40); rest;)
            rest--;
    }
}

/* ---- The run -------------------------------------------------------------------------------- */

static uint64_t now_ms(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint64_t)now.tv_sec * 1000u + (uint64_t)now.tv_nsec / 1000000u;
}

static void change_file(int fd, uint64_t until, bool for_good)
{
    struct stat st;
    if (fd < 0 || fstat(fd, &st))
        wrong("the board is gone");
    size_t size = (size_t)st.st_size;
    unsigned char *map = mmap(NULL, size, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    while (now_ms() < until) {
        change(map, size);
        if (!for_good)
            usleep((useconds_t)(draw() % 30)); /* else who uses it ends before it begins */
        else if (draw() % 2000 == 0)
            map[draw() % size] ^= (unsigned char)(1 << draw() % 8);
    }
    munmap(map, size);
}

/* Make a board with a message in each slot, and let it live for a while under changes. */
static void one_life(void)
{
    struct lwb_board b;
    struct lwb_slot slots[SLOTS];
    if (lwb_open(&b, new_path, true))
        wrong("no board can be made");
    for (unsigned i = 0; i < SLOTS; i++) {
        struct lwb_schema schema = schema_of(i);
        if (lwb_slot(&b, &slots[i], &schema) || lwb_add(&slots[i], "a message", 9, NULL))
            wrong("no slot can be made");
    }
    if (rename(new_path, path)) /* only now do the others find it */
        wrong("the board is gone");
    change_file(b.fd, now_ms() + LIFE_MS, true);
    lwb_close(&b);
}

static void work(unsigned worker)
{
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    for (;;)
        use(worker);
}

int main(int number, char **arguments)
{
    if (number < 2)
        return 2;
    uint64_t seed = number > 2 ? strtoull(arguments[2], NULL, 0) : now_ms();
    uint64_t end = now_ms() + strtoull(arguments[1], NULL, 0) * 1000u;
    struct rlimit most = {64 << 20, 64 << 20}; /* a file of terabytes is nobody's finding */
    setrlimit(RLIMIT_FSIZE, &most);
    signal(SIGXFSZ, SIG_IGN);
    snprintf(path, sizeof path, "/dev/shm/hostile-%d", (int)getpid());
    snprintf(new_path, sizeof new_path, "%s.new", path);
    shared = mmap(NULL, 4096, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    pid_t workers[WORKERS];
    uint64_t steps[WORKERS] = {0}, moved[WORKERS];
    int failed = 0;
    memset(names[SLOTS - 1], 'n', LWB_MAX_NAME);
    dice = seed;
    if (number > 3) {
        change_file(open(arguments[3], O_RDWR), end, false);
        return 0;
    }
    for (unsigned i = 0; i < WORKERS; i++) {
        moved[i] = now_ms();
        if (!(workers[i] = fork())) {
            dice = seed + (i + 1) * 1000003u;
            work(i);
        }
    }
    while (!failed && now_ms() < end) {
        one_life();
        for (unsigned i = 0; i < WORKERS; i++) {
            int status;
            if (waitpid(workers[i], &status, WNOHANG) == workers[i]) {
                fprintf(stderr, "worker %u ended, status %#x\n", i, (unsigned)status);
                workers[i] = failed = -1;
            } else if (atomic_load(&shared->steps[i]) != steps[i]) {
                steps[i] = atomic_load(&shared->steps[i]);
                moved[i] = now_ms();
            } else if (now_ms() - moved[i] > HANGS_S * 1000u) {
                fprintf(stderr, "worker %u does not come back\n", i);
                failed = -1;
            }
        }
    }
    for (unsigned i = 0; i < WORKERS; i++)
        if (workers[i] > 0)
            kill(workers[i], SIGKILL);
    unlink(path);
    printf("seed %" PRIu64 ": %" PRIu64 " sound boards, %" PRIu64 " damaged, steps:", seed,
           atomic_load(&shared->sound), atomic_load(&shared->damaged));
    for (unsigned i = 0; i < WORKERS; i++)
        printf(" %" PRIu64, atomic_load(&shared->steps[i]));
    printf("\n");
    return failed ? 1 : 0;
}
