/* Request and reply on a robot's own line.
 *
 * A command is sent once, after the input is flushed. Its reply is a frame of the same type, or a NAK; other frames are
 * late replies to earlier commands and are skipped. A time-out or an invalid reply leaves State unchanged and the line
 * usable. The type of an unanswered command stays pending: before the next command of that type, a query of a type that
 * is not pending is exchanged. The robot replies in order, so no late reply can follow that one. st and lp are
 * sent immediately in any case.
 */
#ifndef NOMAD_SERIAL_SESSION_H
#define NOMAD_SERIAL_SESSION_H

#include "session.h"
#include "serial_framing.h"

enum { FRAME_TYPES = 256 };

struct robot_line {
    int fd;
    struct wire_state wire;
    struct serial_buffer frames;
    unsigned char pending[FRAME_TYPES]; /* types whose reply may still arrive late */
};

enum outcome nomad_serial_transact(struct robot_line *line, const struct request *request, struct reply *reply);

#endif
