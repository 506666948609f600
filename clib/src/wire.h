/* Converts numbers to bytes and back, for both protocols.
 *
 *     TCP       32-bit words, high byte first, two's complement
 *     serial    1, 2 or 4 bytes, low byte first; signed numbers are sign-magnitude: -50 is 32 80
 *
 * Bytes are read and written one by one, so that neither the size nor the byte order of a long matters. A reader or
 * writer that reaches its end sets `failed` and does nothing more; reads then return 0.
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
size_t nomad_remaining(const struct reader *from);

/* TCP. A long beyond 32 bits is clamped to the range of a word. */
void nomad_put_word(struct writer *to, long number);
void nomad_put_uint16_be(struct writer *to, unsigned number);
int32_t nomad_get_word(struct reader *from);
uint32_t nomad_get_unsigned_word(struct reader *from);

/* Serial. Numbers are clamped to the range of the bytes. */
void nomad_put_byte(struct writer *to, long number);
void nomad_put_unsigned(struct writer *to, long number);
void nomad_put_signed(struct writer *to, long number);
void nomad_put_four_bytes(struct writer *to, uint32_t number);
int nomad_get_byte(struct reader *from);
uint32_t nomad_get_bytes(struct reader *from, int count);
int32_t nomad_get_signed(struct reader *from, int count);

int32_t nomad_signed_word(uint32_t bits);

#endif
