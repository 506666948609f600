/* One question and its answer on a robot's own line.
 *
 * Rules: a command goes out once, after the input was emptied, and the frame of its type or a NAK answers it; other
 * frames are late answers of others and are passed over. Silence or an answer that does not fit leaves State as it was,
 * and the line usable. A question without answer stays owed: before another of its type goes out, one of a type that is
 * not owed is asked, for a robot answers in order, and behind that answer nothing late can come (st and lp go out at
 * once all the same).
 */
#ifndef NOMAD_LINE_EXCHANGE_H
#define NOMAD_LINE_EXCHANGE_H

#include "conversation.h"
#include "line_frames.h"

enum { FRAME_TYPES = 256 };

struct robot_line {
    int fd;
    struct terms terms;
    struct line_frames frames;
    unsigned char owed[FRAME_TYPES]; /* types whose answer may still come late */
};

enum answer nomad_exchange(struct robot_line *line, const struct request *request, struct reply *reply);

#endif
