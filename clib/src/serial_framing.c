/* Finds frames in the bytes received from a serial line. */
#include "serial_framing.h"

#include <string.h>

enum { LENGTH_FIELD_END = 3, FRAME_OVERHEAD = 4 };

int nomad_checksum(const unsigned char *bytes, size_t size)
{
    unsigned sum = 0;

    while (size--)
        sum += *bytes++;
    return (int)(sum & 0xFF);
}

size_t nomad_free_space(const struct serial_buffer *frames) { return sizeof frames->bytes - frames->held; }

static void discard(struct serial_buffer *frames, size_t count)
{
    frames->held -= count;
    memmove(frames->bytes, frames->bytes + count, frames->held);
}

/* Move the next possible frame to the front. Return its full size, or 0 if there is none yet. */
static size_t find_candidate(struct serial_buffer *frames)
{
    for (;;) {
        const unsigned char *start = memchr(frames->bytes, FRAME_START, frames->held);
        size_t size;

        discard(frames, start ? (size_t)(start - frames->bytes) : frames->held);
        if (frames->held < LENGTH_FIELD_END)
            return 0;
        size = FRAME_OVERHEAD + (frames->bytes[1] | (size_t)frames->bytes[2] << 8);
        if (size >= MIN_FRAME && size <= MAX_ROBOT_FRAME)
            return size;
        discard(frames, 1);
    }
}

int nomad_next_frame(struct serial_buffer *frames, struct serial_frame *frame)
{
    size_t size;

    while ((size = find_candidate(frames)) != 0 && frames->held >= size) {
        const unsigned char *bytes = frames->bytes;

        if (bytes[size - 1] == FRAME_END && bytes[size - 2] == nomad_checksum(bytes, size - 2)) {
            frame->type = bytes[3];
            frame->size = size - MIN_FRAME;
            memcpy(frame->data, bytes + FRAME_OVERHEAD, frame->size);
            discard(frames, size);
            return 1;
        }
        discard(frames, 1);
    }
    return 0;
}

int nomad_skip_byte(struct serial_buffer *frames)
{
    if (frames->held == 0)
        return 0;
    discard(frames, 1);
    return 1;
}
