/* Converts numbers to bytes and back. */
#include "wire.h"

struct writer nomad_writer(unsigned char *bytes, size_t size)
{
    struct writer to = {bytes, bytes + size, 0};
    return to;
}

struct reader nomad_reader(const unsigned char *bytes, size_t size)
{
    struct reader from = {bytes, bytes + size, 0};
    return from;
}

size_t nomad_remaining(const struct reader *from) { return (size_t)(from->end - from->at); }

static void put(struct writer *to, uint32_t number, int count, int high_first)
{
    if (to->failed || to->end - to->at < count) {
        to->failed = 1;
        return;
    }
    for (int k = 0; k < count; k++)
        *to->at++ = (unsigned char)(number >> 8 * (high_first ? count - 1 - k : k));
}

static uint32_t get(struct reader *from, int count, int high_first)
{
    uint32_t number = 0;

    if (from->failed || from->end - from->at < count) {
        from->failed = 1;
        return 0;
    }
    for (int k = 0; k < count; k++)
        number |= (uint32_t)*from->at++ << 8 * (high_first ? count - 1 - k : k);
    return number;
}

static long clamp(long number, long min, long max) { return number < min ? min : number > max ? max : number; }

/* Two's complement by arithmetic: the result of a cast would be implementation-defined. */
int32_t nomad_signed_word(uint32_t bits)
{
    return bits < 0x80000000u ? (int32_t)bits : -(int32_t)(0xFFFFFFFFu - bits) - 1;
}

void nomad_put_word(struct writer *to, long number) { put(to, (uint32_t)clamp(number, INT32_MIN, INT32_MAX), 4, 1); }

void nomad_put_uint16_be(struct writer *to, unsigned number) { put(to, number, 2, 1); }

uint32_t nomad_get_unsigned_word(struct reader *from) { return get(from, 4, 1); }

int32_t nomad_get_word(struct reader *from) { return nomad_signed_word(get(from, 4, 1)); }

void nomad_put_byte(struct writer *to, long number) { put(to, (uint32_t)clamp(number, 0, 0xFF), 1, 0); }

void nomad_put_unsigned(struct writer *to, long number) { put(to, (uint32_t)clamp(number, 0, 0xFFFF), 2, 0); }

void nomad_put_signed(struct writer *to, long number)
{
    long bounded = clamp(number, -0x7FFF, 0x7FFF);
    put(to, bounded < 0 ? 0x8000u + (uint32_t)-bounded : (uint32_t)bounded, 2, 0);
}

void nomad_put_four_bytes(struct writer *to, uint32_t number) { put(to, number, 4, 0); }

int nomad_get_byte(struct reader *from) { return (int)get(from, 1, 0); }

uint32_t nomad_get_bytes(struct reader *from, int count) { return get(from, count, 0); }

int32_t nomad_get_signed(struct reader *from, int count)
{
    uint32_t bits = get(from, count, 0), sign = (uint32_t)1 << (8 * count - 1);
    return bits & sign ? -(int32_t)(bits - sign) : (int32_t)bits;
}
