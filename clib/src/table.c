/* The rows of the command table. */
#include "table.h"

const struct command nomad_commands[CMD_COUNT] = {
#define ROW(id, name, tcp, line, tcp_args, line_args, tcp_reply, line_reply, models, seconds, packet, data)            \
    {name, tcp, line, tcp_args, line_args, SHAPE_##tcp_reply, SHAPE_##line_reply, models, seconds, packet, data},
#include "commands.inc"
#undef ROW
};
