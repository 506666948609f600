/* Numbers to bytes and back: the one place that knows how either language writes them.
 *
 *     over TCP       words of 32 bits, high byte first, two's complement
 *     on the line    1, 2 or 4 bytes, low byte first; signed numbers are sign-magnitude, -50 is 32 80
 *
 * Rules: bytes are taken and put one by one, so that neither the size of a long nor the order of its bytes matters.
 * A writer or reader that runs over its end does nothing more and says so in `failed`; reads then give 0.
 */
#ifndef NOMAD_WIRE_H
#define NOMAD_WIRE_H

#include <stddef.h>
#include <stdint.h>

struct writer {
    unsigned char *at, *end;
    int failed;
};

struct reader {
    const unsigned char *at, *end;
    int failed;
};

struct writer nomad_writer(unsigned char *bytes, size_t size);
struct reader nomad_reader(const unsigned char *bytes, size_t size);
size_t nomad_left(const struct reader *from);

/* TCP. A long beyond 32 bits is brought to the nearest that a word holds. */
void nomad_put_word(struct writer *to, long number);
void nomad_put_short_high_first(struct writer *to, unsigned number);
int32_t nomad_get_word(struct reader *from);
uint32_t nomad_get_unsigned_word(struct reader *from);

/* The line. Numbers are brought to the nearest that the bytes hold. */
void nomad_put_byte(struct writer *to, long number);
void nomad_put_unsigned(struct writer *to, long number);
void nomad_put_signed(struct writer *to, long number);
void nomad_put_four_bytes(struct writer *to, uint32_t number);
int nomad_get_byte(struct reader *from);
uint32_t nomad_get_bytes(struct reader *from, int count);
int32_t nomad_get_signed(struct reader *from, int count);

int32_t nomad_signed_word(uint32_t bits);

#endif
