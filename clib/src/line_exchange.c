/* One question and its answer on a robot's own line. */
#include "line_exchange.h"

#include "complain.h"
#include "held.h"
#include "stream.h"

#include <string.h>

enum {
    USUAL_MS = 1000,
    GAP_MS = 250, /* silence within an answer after which no more of it comes */
    QUIET = 2,    /* times the usual patience: silence after which no late answer comes, for want of a better way */
    LONGEST_QUIET = 10
};

static void empty_input(struct robot_line *line)
{
    nomad_flush(line->fd);
    line->frames.held = 0;
}

static enum answer lost(struct robot_line *line, const struct request *request)
{
    nomad_complain("%s: the line is gone; connect again", request->command->name);
    nomad_close(&line->fd);
    return NO_ANSWER;
}

/* The next whole frame: 1, SILENT, LOST. Behind a piece of one no more than GAP_MS is waited for the rest. */
static int next_frame(struct robot_line *line, struct line_frame *frame, milliseconds deadline)
{
    int heard = 0;

    for (;;) {
        milliseconds gap = nomad_now() + GAP_MS;
        long got;

        if (nomad_take_frame(&line->frames, frame))
            return 1;
        got = nomad_receive(line->fd, line->frames.bytes + line->frames.held, nomad_room(&line->frames),
                            heard && gap < deadline ? gap : deadline);
        if (got == LOST)
            return LOST;
        if (got == SILENT)
            break;
        line->frames.held += (size_t)got;
        heard = 1;
        if (nomad_now() >= deadline) /* a line that babbles */
            break;
    }
    while (nomad_give_up(&line->frames))
        if (nomad_take_frame(&line->frames, frame))
            return 1;
    return SILENT;
}

static int owes_any(const struct robot_line *line)
{
    for (int k = 0; k < FRAME_TYPES; k++)
        if (line->owed[k])
            return 1;
    return 0;
}

/* While others are owed, a NAK may be any's, and counts as nobody's. */
static enum answer hear(struct robot_line *line, const struct request *request, milliseconds deadline,
                        struct reply *reply)
{
    static struct line_frame frame;

    for (;;) {
        int heard = next_frame(line, &frame, deadline);

        if (heard == LOST)
            return lost(line, request);
        if (heard == SILENT) {
            line->owed[request->command->line_type] = 1;
            nomad_complain("%s: no good answer came", request->command->name);
            return NO_ANSWER;
        }
        if (frame.type == NAK_TYPE && frame.size == 0 && !owes_any(line))
            return NOT_ACKNOWLEDGED;
        if (frame.type == request->command->line_type)
            break;
        line->owed[frame.type] = 0;
    }
    memset(line->owed, 0, sizeof line->owed); /* what was asked before and has not come is lost */
    if (!nomad_read_line_reply(request->command->line_reply, frame.data, frame.size, &line->terms, reply)) {
        nomad_complain("%s: the answer does not fit it; is the robot of this model?", request->command->name);
        return NO_ANSWER;
    }
    nomad_hold(reply);
    return ANSWERED;
}

static milliseconds patience(const struct request *request)
{
    milliseconds usual = nomad_patience(USUAL_MS), own = request->command->line_timeout_s * 1000;

    if (request->command == &nomad_commands[CMD_WS])
        return usual + request->args[3] * 1000;
    return own > USUAL_MS && own > usual ? own : usual;
}

static int say(struct robot_line *line, const struct request *request)
{
    unsigned char bytes[HOST_LIMIT];
    size_t size = nomad_line_request(request, bytes, sizeof bytes);

    if (size == 0) {
        nomad_complain("%s: a frame of a host has at most %d bytes", request->command->name, HOST_LIMIT);
        return 0;
    }
    empty_input(line);
    if (nomad_send(line->fd, bytes, size, nomad_now() + USUAL_MS) == 1)
        return 1;
    lost(line, request);
    return 0;
}

static int wait_for_quiet(struct robot_line *line)
{
    unsigned char rubbish[512];
    milliseconds usual = nomad_patience(USUAL_MS), end = nomad_now() + LONGEST_QUIET * usual;

    while (nomad_now() < end) {
        long got = nomad_receive(line->fd, rubbish, sizeof rubbish, nomad_now() + QUIET * usual);

        if (got == SILENT)
            memset(line->owed, 0, sizeof line->owed);
        if (got <= 0)
            return got == SILENT;
    }
    return 0;
}

/* See to it that no late answer can pass for this question's. */
static int see_off(struct robot_line *line, const struct request *request, struct reply *reply)
{
    static const enum command_id PROBES[] = {CMD_GET_RA, CMD_GET_RV, CMD_GET_RC, CMD_GET_BP, CMD_GET_SN};
    struct request probe = {0};

    for (size_t k = 0; k < sizeof PROBES / sizeof *PROBES && probe.command == NULL; k++)
        if (!line->owed[nomad_commands[PROBES[k]].line_type])
            probe.command = &nomad_commands[PROBES[k]];
    if (probe.command ? say(line, &probe) && hear(line, &probe, nomad_now() + patience(&probe), reply) == ANSWERED
                      : wait_for_quiet(line))
        return 1;
    nomad_complain("%s: held back, since a late answer could have passed for its own", request->command->name);
    return 0;
}

enum answer nomad_exchange(struct robot_line *line, const struct request *request, struct reply *reply)
{
    int is_urgent = request->command == &nomad_commands[CMD_ST] || request->command == &nomad_commands[CMD_LP];

    if (line->owed[request->command->line_type]) {
        if (is_urgent && !say(line, request))
            return NO_ANSWER;
        if (!see_off(line, request, reply))
            return NO_ANSWER;
    }
    return say(line, request) ? hear(line, request, nomad_now() + patience(request), reply) : NO_ANSWER;
}
