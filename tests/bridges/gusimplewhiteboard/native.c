/* A gusimplewhiteboard's process, from the layout that its documents give, and nothing of ours:
 *
 *     native PATH create             make the file
 *     native PATH add NUMBER X...    add a message of doubles
 *     native PATH get NUMBER N       print the current message's first N doubles
 *     native PATH flood NUMBER       add messages of 16 equal numbers until standard input ends
 */
#include <fcntl.h>
#include <poll.h>
#include <stdatomic.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

union message {
    double numbers[16];
    uint64_t words[16];
    long double wide; /* which aligns the messages */
};

struct board {
    uint16_t version, eventcount;
    uint8_t indexes[512];
    uint16_t event_counters[512];
    union message messages[512][4];
    uint64_t magic;
};

_Static_assert(sizeof(union message) == 128, "message");
_Static_assert(offsetof(struct board, messages) == 1552, "messages");
_Static_assert(offsetof(struct board, magic) == 263696, "magic");
_Static_assert(sizeof(struct board) == 263712, "size");

static union message *next(struct board *b, int number)
{
    return &b->messages[number][(b->indexes[number] + 1) % 4];
}

static void publish(struct board *b, int number)
{
    atomic_signal_fence(memory_order_seq_cst); /* the compiler keeps the order, too */
    b->indexes[number] = (uint8_t)((b->indexes[number] + 1) % 4);
    atomic_signal_fence(memory_order_seq_cst);
    b->event_counters[number]++;
    atomic_signal_fence(memory_order_seq_cst);
}

int main(int argc, char **argv)
{
    if (argc < 3)
        return 2;
    int fd = open(argv[1], O_RDWR | O_CREAT, 0666);
    if (fd < 0 || ftruncate(fd, sizeof(struct board)))
        return 1;
    struct board *b = mmap(NULL, sizeof *b, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    if (b == MAP_FAILED)
        return 1;
    int number = argc > 3 ? atoi(argv[3]) : 0;
    if (!strcmp(argv[2], "create")) {
        b->version = 2207;
        b->magic = 0xfeeda11deadbeef6;
    } else if (!strcmp(argv[2], "add")) {
        union message *message = next(b, number);
        for (int i = 4; i < argc; i++)
            message->numbers[i - 4] = atof(argv[i]);
        publish(b, number);
    } else if (!strcmp(argv[2], "get")) {
        for (int i = 0; i < atoi(argv[4]); i++)
            printf("%g ", b->messages[number][b->indexes[number]].numbers[i]);
        printf("of %d\n", b->event_counters[number]);
    } else {
        struct pollfd input = {.fd = 0, .events = POLLIN};
        puts("flooding");
        fflush(stdout);
        for (uint64_t value = 1; value % 1024 || !poll(&input, 1, 0); value++) {
            union message *message = next(b, number);
            for (int i = 0; i < 16; i++)
                ((volatile uint64_t *)message->words)[i] = value;
            publish(b, number);
        }
    }
    return 0;
}
