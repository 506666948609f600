/* Frames in what a line delivers. */
#include "line_frames.h"

#include <string.h>

enum { BEHIND_LENGTH = 3, OVERHEAD = 4 };

int nomad_checksum(const unsigned char *bytes, size_t size)
{
    unsigned sum = 0;

    while (size--)
        sum += *bytes++;
    return (int)(sum & 0xFF);
}

size_t nomad_room(const struct line_frames *frames)
{
    return sizeof frames->bytes - frames->held;
}

static void discard(struct line_frames *frames, size_t count)
{
    frames->held -= count;
    memmove(frames->bytes, frames->bytes + count, frames->held);
}

/* Bring a possible frame to the front; its whole size, 0 where there is none yet. */
static size_t candidate(struct line_frames *frames)
{
    for (;;) {
        const unsigned char *start = memchr(frames->bytes, FRAME_START, frames->held);
        size_t size;

        discard(frames, start ? (size_t)(start - frames->bytes) : frames->held);
        if (frames->held < BEHIND_LENGTH)
            return 0;
        size = OVERHEAD + (frames->bytes[1] | (size_t)frames->bytes[2] << 8);
        if (size >= SMALLEST_FRAME && size <= ROBOT_LIMIT)
            return size;
        discard(frames, 1);
    }
}

int nomad_take_frame(struct line_frames *frames, struct line_frame *frame)
{
    size_t size;

    while ((size = candidate(frames)) != 0 && frames->held >= size) {
        const unsigned char *bytes = frames->bytes;

        if (bytes[size - 1] == FRAME_END && bytes[size - 2] == nomad_checksum(bytes, size - 2)) {
            frame->type = bytes[3];
            frame->size = size - SMALLEST_FRAME;
            memcpy(frame->data, bytes + OVERHEAD, frame->size);
            discard(frames, size);
            return 1;
        }
        discard(frames, 1);
    }
    return 0;
}

int nomad_give_up(struct line_frames *frames)
{
    if (frames->held == 0)
        return 0;
    discard(frames, 1);
    return 1;
}
