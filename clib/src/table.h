/* The table of commands. scripts/clib-table generates its rows, commands.inc, from the project's Python table.
 *
 * One letter per argument:  w TCP word · f flag, 0 or 1 · s, u signed, unsigned, two bytes · b byte
 *                           h infrared history · m laser mode · L four bytes, in packets of the arm
 * or one letter for all:    M the mask · T a text · P a packet of bytes · * any number of words
 */
#ifndef NOMAD_TABLE_H
#define NOMAD_TABLE_H

enum shape {
    SHAPE_STATE,
    SHAPE_INFRARED,
    SHAPE_SONAR,
    SHAPE_BUMPER,
    SHAPE_COMPASS,
    SHAPE_LASER,
    SHAPE_SEGMENTS,
    SHAPE_POSE,       /* get_rc: State[34..37] */
    SHAPE_VELOCITY,   /* State[38..40] */
    SHAPE_PREDICTION, /* 44 numbers and a laser block; not stored in State */
    SHAPE_SIMPLE,     /* from here on: numbers that do not belong to State */
    SHAPE_LIST,       /* n, then the elements */
    SHAPE_COLLISION,
    SHAPE_CLICKED,
    SHAPE_SPECIAL, /* bytes */
    SHAPE_TRUTH,
    SHAPE_CONTROL,
    SHAPE_CALIBRATION, /* three scores of the compass */
    SHAPE_NOTHING
};

enum command_id {
#define ROW(id, ...) CMD_##id,
#include "commands.inc"
#undef ROW
    CMD_COUNT
};

struct command {
    const char *name;
    int tcp_type, line_type; /* -1: not available there */
    const char *tcp_args, *line_args;
    enum shape tcp_reply, line_reply;
    unsigned models; /* bit n: available on the line of model n */
    int line_timeout_s;
    int packet_type; /* for packets of the arm, else -1 */
    const char *packet_data;
};

extern const struct command nomad_commands[CMD_COUNT];

#endif
