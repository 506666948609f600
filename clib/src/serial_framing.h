/* Finds frames in the bytes received from a serial line, where bytes may be lost, corrupted or late.
 *
 * After an invalid length, checksum or end byte, one byte is skipped and the search continues at the next 0x01, so that
 * a corrupt length cannot hide the frames behind it. No function waits.
 */
#ifndef NOMAD_SERIAL_FRAMING_H
#define NOMAD_SERIAL_FRAMING_H

#include <stddef.h>

enum {
    FRAME_START = 0x01,
    FRAME_END = 0x5C,
    NAK_TYPE = 8,
    MAX_HOST_FRAME = 255,   /* frames of the host are shorter than 256 bytes */
    MAX_ROBOT_FRAME = 5174, /* all sensors, all stamps and 482 laser lines */
    MIN_FRAME = 6
};

struct serial_buffer {
    unsigned char bytes[2 * MAX_ROBOT_FRAME];
    size_t held;
};

struct serial_frame {
    int type;
    unsigned char data[MAX_ROBOT_FRAME];
    size_t size;
};

int nomad_checksum(const unsigned char *bytes, size_t size);

/* Return the free space for received bytes, at least one frame. The caller adds the bytes it stores to `held`. */
size_t nomad_free_space(const struct serial_buffer *frames);

/* Extract the first complete frame. Return 0 if there is none yet. */
int nomad_next_frame(struct serial_buffer *frames, struct serial_frame *frame);

/* Give up the incomplete frame in front: skip its first byte. Return 0 if the buffer is empty. */
int nomad_skip_byte(struct serial_buffer *frames);

#endif
