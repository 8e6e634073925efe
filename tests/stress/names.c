/* Names of slots come and go on one board, through llfsm_whiteboard.h. What must hold:
 *
 *   1. What is read through a handle was added under the handle's name, whatever name the record has
 *      had before or has by now.
 *   2. No two records have one name at the same time.
 *   3. The records are not more than the names in use at the same time, and a few: the file stops
 *      growing, also where those who give names are killed.
 *
 *     names threads|processes SECONDS [SEED]
 *
 * ends with 0 if all held; else it says what did not, and does not. Threads are for TSan; processes
 * are killed at random moments, and others take their places. */
#include "interference.h"

#include <inttypes.h>
#include <stdarg.h>
#include <stdbool.h>
#include <sys/prctl.h>
#include <sys/wait.h>

#include "llfsm_whiteboard.h"

enum { WORKERS = 4, KEPT = 12, WINDOW = 16, OFTEN = 30, MOST = 4 * WINDOW + WORKERS * (KEPT + 2) };

static char path[64];
static uint64_t seed = 1;

static struct shared {
    _Atomic bool stop;
    _Atomic uint64_t steps, read, renamed;
} *shared_numbers;

static _Noreturn void fail(const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    fprintf(stderr, "names (seed %" PRIu64 "): ", seed);
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

struct handle { uint64_t number; struct lwb_slot slot; };
struct worker { pthread_t id; uint64_t number; struct lwb_board board; struct handle kept[KEPT]; };

static void open_name(struct lwb_board *board, struct handle *h, uint64_t number)
{
    char name[32];
    snprintf(name, sizeof name, "name/%" PRIu64, number);
    struct lwb_schema schema = {name, "number", "{}", 1, 64};
    succeed(lwb_slot(board, &h->slot, &schema), "open");
    h->number = number;
}

static void check(struct handle *h)
{
    uint64_t data[8] = {0};
    struct lwb_meta meta, recent[LWB_BUFFERS];
    int found, status = lwb_read(&h->slot, data, sizeof data, &meta);
    if (status != LWB_OK && status != LWB_EMPTY && status != LWB_RENAMED)
        fail("name/%" PRIu64 ": %s", h->number, lwb_describe(status));
    for (size_t i = 0; status == LWB_OK && i < meta.length / 8; i++)
        if (data[i] != h->number)
            fail("name/%" PRIu64 ": a message of name/%" PRIu64, h->number, data[i]);
    if (status == LWB_OK && lwb_word(&h->slot) == meta.word &&
        lwb_recent(&h->slot, lwb_writer_of(meta.word), recent, &found) == LWB_OK &&
        lwb_word(&h->slot) == meta.word) {
        for (int i = 0; i < found; i++)
            if (!recent[i].count || recent[i].count > meta.count + 1) /* one is being added */
                fail("name/%" PRIu64 ": message %" PRIu64 " of %" PRIu64, h->number,
                     recent[i].count, meta.count);
    }
    atomic_fetch_add(status == LWB_OK ? &shared_numbers->read : &shared_numbers->renamed, 1);
}

static void put(struct handle *h)
{
    uint64_t data[8];
    for (int i = 0; i < 8; i++)
        data[i] = h->number;
    uint64_t count = 0;
    int status = lwb_add(&h->slot, data, 8 * (1 + random_number() % 8), &count);
    if (status == LWB_OK && !count)
        fail("name/%" PRIu64 ": message 0", h->number);
    if (status != LWB_RENAMED)
        succeed(status, "add");
}

static void *work(void *argument)
{
    struct worker *w = argument;
    yield_within = OFTEN;
    dice = mix(seed) ^ mix(w->number);
    succeed(lwb_open(&w->board, path, true), "open the board");
    for (int i = 0; !shared_numbers->stop; i = (i + 1) % KEPT) {
        uint64_t now = atomic_fetch_add(&shared_numbers->steps, 1) / 4;
        struct handle *h = &w->kept[i];
        if (h->number)
            lwb_vacate(&h->slot);
        open_name(&w->board, h, /* the newest, which others make, too, or any */
                  now + (random_number() % 2 ? WINDOW : 1 + random_number() % WINDOW));
        for (int k = 0; k < 8; k++) {
            h = &w->kept[random_number() % KEPT];
            if (!h->number)
                continue;
            if (random_number() % 4)
                put(h);
            check(h);
            if (lwb_wait(&h->slot, UINT64_MAX - 1, 0) == LWB_RENAMED && random_number() % 2)
                open_name(&w->board, h, h->number);
        }
    }
    lwb_close(&w->board);
    return NULL;
}

/* Look through the table, and give up what those who were killed have left. Returns its length. */
static int survey(struct lwb_board *board)
{
    static struct { uint64_t number, life; struct lwb_record *record; } seen[LWB_MAX_SLOTS];
    uint64_t old = shared_numbers->steps / 4, offset;
    int known = 0, status;
    for (int i = 0;; i++) {
        struct lwb_record *r = lwb_slot_at(board, i, &offset, &status);
        union lwb_name name;
        bool damaged;
        if (!r && status == LWB_MISSING)
            return i;
        if (!r)
            fail("record %d: %s", i, lwb_describe(status));
        if (!lwb_name_of(r, &name, &seen[known].life, &damaged)) {
            if (damaged)
                fail("record %d: a torn name", i);
            continue;
        }
        uint64_t number = strtoull(name.text + 5, NULL, 10);
        for (int k = 0; k < known; k++)
            if (seen[k].number == number && lwb_generation_of(seen[k].life) ==
                                                lwb_generation_of(atomic_load(&seen[k].record->life)))
                fail("two records have the name %s", name.text);
        seen[known].number = number;
        seen[known++].record = r;
        if (number < old) {
            struct lwb_slot slot = {.record = r, .life = lwb_life_of(
                lwb_generation_of(seen[known - 1].life), LWB_NAMED)};
            lwb_vacate(&slot);
        }
    }
}

static void begin(struct worker *w, bool processes)
{
    if (!processes) {
        if (pthread_create(&w->id, NULL, work, w))
            fail("no thread");
        return;
    }
    pid_t pid = fork();
    if (!pid) {
        prctl(PR_SET_PDEATHSIG, SIGKILL); /* none survives, and holds the pipes of who started it */
        _exit(work(w) != NULL);
    }
    w->id = (pthread_t)pid;
}

static void end(struct worker *w, bool processes)
{
    int status = 0;
    if (processes)
        waitpid((pid_t)w->id, &status, 0);
    else
        pthread_join(w->id, NULL);
    if (status && !(WIFSIGNALED(status) && WTERMSIG(status) == SIGKILL))
        fail("a worker ended with status %d", status);
}

static int records_of(struct lwb_board *board)
{
    uint64_t offset;
    int status, i = 0;
    while (lwb_slot_at(board, i, &offset, &status))
        i++;
    return i;
}

/* Let a process die when it has taken a record, or when it has also given the name. */
static void die_naming(struct lwb_board *board, bool given)
{
    static const struct lwb_schema schema = {"name/7777777", "number", "{}", 1, 64};
    struct handle h;
    open_name(board, &h, 1);
    lwb_vacate(&h.slot);
    int records = records_of(board);
    pid_t pid = fork();
    if (!pid) {
        struct lwb_board mine;
        struct lwb_taken taken;
        union lwb_name name = LWB_ZERO;
        strcpy(name.text, schema.name);
        succeed(lwb_open(&mine, path, false), "open the board");
        struct lwb_kind kind = lwb_kind_of(&schema);
        succeed(lwb_take(&mine, &kind, &name, &taken), "take");
        if (given)
            atomic_store(&lwb_head(&mine)->named,
                         taken.generation << LWB_NAMED_BITS | (uint64_t)taken.index);
        kill(getpid(), SIGKILL);
    }
    waitpid(pid, NULL, 0);
    uint64_t number = given ? 7777777 : 8888888;
    open_name(board, &h, number);
    put(&h);
    check(&h);
    if (records_of(board) != records)
        fail("a record is lost: its process died when it had %s", given ? "named it" : "taken it");
    open_name(board, &h, number);
    if (lwb_count(&h.slot) != 1)
        fail("the name of a process that died is given twice");
    lwb_vacate(&h.slot);
}

int main(int count, char **arguments)
{
    bool processes = count > 1 && !strcmp(arguments[1], "processes");
    double seconds = count > 2 ? atof(arguments[2]) : 0;
    seed = count > 3 ? strtoull(arguments[3], NULL, 0) : 1;
    if (!(seconds > 0) || count > 4 || (!processes && strcmp(arguments[1], "threads"))) {
        fprintf(stderr, "usage: %s threads|processes SECONDS [SEED]\n", arguments[0]);
        return 2;
    }
    snprintf(path, sizeof path, "/dev/shm/llfsm.names.%ld", (long)getpid());
    shared_numbers = mmap(NULL, sizeof *shared_numbers, PROT_READ | PROT_WRITE,
                          MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    static struct worker workers[WORKERS], own;
    alarm((unsigned)seconds + 180); /* a hang is a death by SIGALRM; on a busy machine a yield is long */
    dice = mix(seed);
    uint64_t number = 0, kills = 0;
    succeed(lwb_open(&own.board, path, true), "open the board");
    die_naming(&own.board, false);
    die_naming(&own.board, true);
    lwb_close(&own.board);
    if (!processes)
        succeed(lwb_open(&own.board, path, true), "open the board");
    for (; number < WORKERS; number++) {
        workers[number].number = number;
        begin(&workers[number], processes);
    }
    if (processes) /* not before the forks: each has a board of its own, as programs do */
        succeed(lwb_open(&own.board, path, true), "open the board");
    struct timespec start, now;
    clock_gettime(CLOCK_MONOTONIC, &start);
    int records;
    do {
        records = survey(&own.board);
        if (records > MOST)
            fail("%d records for %d names", records, MOST);
        struct worker *w = &workers[random_number() % WORKERS];
        if (processes && random_number() % 4 == 0) {
            kill((pid_t)w->id, SIGKILL);
            end(w, true);
            w->number = number++;
            begin(w, true);
            kills++;
        }
        usleep((useconds_t)(random_number() % 2000));
        clock_gettime(CLOCK_MONOTONIC, &now);
    } while ((double)(now.tv_sec - start.tv_sec) + 1e-9 * (double)(now.tv_nsec - start.tv_nsec) <
                 seconds ||
             !shared_numbers->read || !shared_numbers->renamed || (processes && !kills));
    shared_numbers->stop = true;
    for (int i = 0; i < WORKERS; i++)
        end(&workers[i], processes);
    records = survey(&own.board);
    printf("%" PRIu64 " names, %" PRIu64 " messages read, %" PRIu64 " handles of names given up, %"
           PRIu64 " kills, %d records\n", (uint64_t)shared_numbers->steps / 4,
           (uint64_t)shared_numbers->read, (uint64_t)shared_numbers->renamed, kills, records);
    unlink(path);
    return 0;
}
