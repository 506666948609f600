/* The table of commands, as C sees it. The rows are in commands.inc, made from the project's one table.
 *
 * A letter an argument:  w word of TCP · f flag, 0 or 1 · s u signed, unsigned of two bytes · b byte
 *                        h history of the infrareds · m laser mode · L four bytes, in the arm's packets
 * or one for all:        M the mask · T a text · P a packet of bytes · * words, as many as there are
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
    SHAPE_POSE,        /* get_rc: State[34..37] */
    SHAPE_VELOCITY,    /* State[38..40] */
    SHAPE_PREDICTION,  /* 44 numbers and a laser block; held nowhere */
    SHAPE_SIMPLE,      /* from here: numbers that are no State */
    SHAPE_LIST,        /* n and what it counts */
    SHAPE_COLLISION,
    SHAPE_CLICKED,
    SHAPE_SPECIAL,     /* bytes */
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
    int tcp_type, line_type;        /* -1: does not exist there */
    const char *tcp_args, *line_args;
    enum shape tcp_reply, line_reply;
    unsigned models;                /* bit n: the line of model number n has it */
    int line_timeout_s;
    int packet_type;                /* of the arm's packets, else -1 */
    const char *packet_data;
};

extern const struct command nomad_commands[CMD_COUNT];

#endif
