/* Frames in what a line delivers. A line is never clean: bytes get lost, corrupted, or come late.
 *
 * Rules: a length out of bounds, a wrong checksum or end costs one byte, and the search goes on at the next 0x01, so
 * that a corrupt length cannot swallow the frames behind it. It never waits.
 */
#ifndef NOMAD_LINE_FRAMES_H
#define NOMAD_LINE_FRAMES_H

#include <stddef.h>

enum {
    FRAME_START = 0x01,
    FRAME_END = 0x5C,
    NAK_TYPE = 8,
    HOST_LIMIT = 255,   /* a host's frame is shorter than 256 bytes */
    ROBOT_LIMIT = 5174, /* every sensor, every stamp and 482 laser lines */
    SMALLEST_FRAME = 6
};

struct line_frames {
    unsigned char bytes[2 * ROBOT_LIMIT];
    size_t held;
};

struct line_frame {
    int type;
    unsigned char data[ROBOT_LIMIT];
    size_t size;
};

int nomad_checksum(const unsigned char *bytes, size_t size);

/* Room behind what is held, for the next bytes; at least a frame's. The caller adds to `held` what it put there. */
size_t nomad_room(const struct line_frames *frames);

/* The first whole frame; 0 where there is none yet. */
int nomad_take_frame(struct line_frames *frames, struct line_frame *frame);

/* No more will come of the first frame that is not whole: look behind its first byte. 0 where nothing is left. */
int nomad_give_up(struct line_frames *frames);

#endif
