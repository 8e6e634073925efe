/* As much of MessagePack as messages of numbers need, for C and C++. */
#ifndef MESSAGEPACK_H
#define MESSAGEPACK_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

/* Bytes from `at` to `end`; `good` until one is missing or something else than was asked for. */
struct pack { unsigned char *at, *end; bool good; };
struct unpack { const unsigned char *at, *end; bool good; };

static inline void pack_number(struct pack *p, unsigned char kind, uint64_t value, int bytes)
{
    p->good = p->good && p->end - p->at > bytes;
    if (!p->good)
        return;
    *p->at++ = kind;
    while (bytes--)
        *p->at++ = (unsigned char)(value >> 8 * bytes);
}

static inline void pack_array(struct pack *p, unsigned length) /* up to 15 */
{
    pack_number(p, (unsigned char)(0x90 | length), 0, 0);
}

static inline void pack_double(struct pack *p, double value)
{
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    pack_number(p, 0xcb, bits, 8);
}

static inline uint64_t unpack_bytes(struct unpack *u, int bytes)
{
    uint64_t value = 0;
    u->good = u->good && u->end - u->at >= bytes;
    while (u->good && bytes--)
        value = value << 8 | *u->at++;
    return value;
}

static inline void unpack_array(struct unpack *u, unsigned length) /* up to 15 */
{
    u->good = unpack_bytes(u, 1) == (0x90 | length) && u->good;
}

/* A number as a double: Python writes a whole one that way, whatever the field's type. */
static inline double unpack_double(struct unpack *u)
{
    unsigned kind = (unsigned)unpack_bytes(u, 1);
    if (kind <= 0x7f)
        return kind;
    if (kind >= 0xe0)
        return (int8_t)kind;
    if (kind >= 0xcc && kind <= 0xcf)
        return (double)unpack_bytes(u, 1 << (kind - 0xcc));
    if (kind >= 0xd0 && kind <= 0xd3) {
        int bits = 8 << (kind - 0xd0);
        return (double)((int64_t)(unpack_bytes(u, bits / 8) << (64 - bits)) >> (64 - bits));
    }
    if (kind == 0xca) {
        uint32_t bits = (uint32_t)unpack_bytes(u, 4);
        float value;
        memcpy(&value, &bits, sizeof value);
        return value;
    }
    u->good = u->good && kind == 0xcb;
    uint64_t bits = unpack_bytes(u, 8);
    double value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

#endif
