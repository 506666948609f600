/* Sends a request on a robot's own line and receives its reply. */
#include "serial_session.h"

#include "error.h"
#include "client_state.h"
#include "stream.h"

#include <string.h>

enum {
    DEFAULT_TIMEOUT_MS = 1000,
    MAX_GAP_MS = 250,   /* longest pause within a reply */
    DRAIN_TIMEOUTS = 2, /* idle time, in reply time-outs, after which no late reply is expected */
    MAX_DRAIN_TIMEOUTS = 10
};

static void empty_input(struct robot_line *line)
{
    nomad_flush(line->fd);
    line->frames.held = 0;
}

static enum outcome report_disconnect(struct robot_line *line, const struct request *request)
{
    nomad_report_error("%s: the line is disconnected; connect again", request->command->name);
    nomad_close(&line->fd);
    return NO_REPLY;
}

/* Receive the next complete frame: 1, TIMED_OUT or DISCONNECTED. Once part of a frame has arrived, wait at most
 * MAX_GAP_MS for more of it. */
static int receive_frame(struct robot_line *line, struct serial_frame *frame, milliseconds deadline)
{
    int has_started = 0;

    for (;;) {
        milliseconds gap = nomad_now() + MAX_GAP_MS;
        long got;

        if (nomad_next_frame(&line->frames, frame))
            return 1;
        got = nomad_receive(line->fd, line->frames.bytes + line->frames.held, nomad_free_space(&line->frames),
                            has_started && gap < deadline ? gap : deadline);
        if (got == DISCONNECTED)
            return DISCONNECTED;
        if (got == TIMED_OUT)
            break;
        line->frames.held += (size_t)got;
        has_started = 1;
        if (nomad_now() >= deadline) /* continuous input without a frame */
            break;
    }
    /* A corrupt length may hide complete frames behind an incomplete one: search from every byte. */
    while (nomad_skip_byte(&line->frames))
        if (nomad_next_frame(&line->frames, frame))
            return 1;
    return TIMED_OUT;
}

static int has_pending(const struct robot_line *line)
{
    for (int k = 0; k < FRAME_TYPES; k++)
        if (line->pending[k])
            return 1;
    return 0;
}

/* A NAK does not name its request. While other replies are pending it is ambiguous and is ignored. */
static enum outcome receive_reply(struct robot_line *line, const struct request *request, milliseconds deadline,
                                  struct reply *reply)
{
    static struct serial_frame frame;

    for (;;) {
        int status = receive_frame(line, &frame, deadline);

        if (status == DISCONNECTED)
            return report_disconnect(line, request);
        if (status == TIMED_OUT) {
            line->pending[request->command->line_type] = 1;
            nomad_report_error("%s: no valid reply in time", request->command->name);
            return NO_REPLY;
        }
        if (frame.type == NAK_TYPE && frame.size == 0 && !has_pending(line))
            return NOT_ACKNOWLEDGED;
        if (frame.type == request->command->line_type)
            break;
        line->pending[frame.type] = 0;
    }
    memset(line->pending, 0, sizeof line->pending); /* replies come in order: older ones are lost */
    if (!nomad_decode_serial_reply(request->command->line_reply, frame.data, frame.size, &line->wire, reply)) {
        nomad_report_error("%s: the reply has the wrong format; is the robot of this model?", request->command->name);
        return NO_REPLY;
    }
    nomad_apply_reply(reply);
    return REPLIED;
}

static milliseconds reply_timeout(const struct request *request)
{
    milliseconds timeout = nomad_reply_timeout(DEFAULT_TIMEOUT_MS),
                 command_ms = request->command->line_timeout_s * 1000;

    if (request->command == &nomad_commands[CMD_WS])
        return timeout + request->args[3] * 1000;
    return command_ms > DEFAULT_TIMEOUT_MS && command_ms > timeout ? command_ms : timeout;
}

static int send_request(struct robot_line *line, const struct request *request)
{
    unsigned char bytes[MAX_HOST_FRAME];
    size_t size = nomad_encode_serial_request(request, bytes, sizeof bytes);

    if (size == 0) {
        nomad_report_error("%s: the request is too long; a frame has at most %d bytes", request->command->name,
                           MAX_HOST_FRAME);
        return 0;
    }
    empty_input(line);
    if (nomad_send(line->fd, bytes, size, nomad_now() + DEFAULT_TIMEOUT_MS) == 1)
        return 1;
    report_disconnect(line, request);
    return 0;
}

/* Wait until the line is idle for so long that no late reply is expected. Return 0 if it never is. */
static int drain(struct robot_line *line)
{
    unsigned char discarded[512];
    milliseconds timeout = nomad_reply_timeout(DEFAULT_TIMEOUT_MS), end = nomad_now() + MAX_DRAIN_TIMEOUTS * timeout;

    while (nomad_now() < end) {
        long got = nomad_receive(line->fd, discarded, sizeof discarded, nomad_now() + DRAIN_TIMEOUTS * timeout);

        if (got == TIMED_OUT)
            memset(line->pending, 0, sizeof line->pending);
        if (got <= 0)
            return got == TIMED_OUT;
    }
    return 0;
}

/* Make sure that no late reply can be mistaken for the reply to this request: exchange a query of another type, whose
 * reply comes after all late ones, or wait until the line is idle. */
static int flush_pending_reply(struct robot_line *line, const struct request *request, struct reply *reply)
{
    static const enum command_id PROBES[] = {CMD_GET_RA, CMD_GET_RV, CMD_GET_RC, CMD_GET_BP, CMD_GET_SN};
    struct request probe = {0};

    for (size_t k = 0; k < sizeof PROBES / sizeof *PROBES && probe.command == NULL; k++)
        if (!line->pending[nomad_commands[PROBES[k]].line_type])
            probe.command = &nomad_commands[PROBES[k]];
    if (probe.command ? send_request(line, &probe)
                            && receive_reply(line, &probe, nomad_now() + reply_timeout(&probe), reply) == REPLIED
                      : drain(line))
        return 1;
    nomad_report_error("%s: not sent, because a late reply could be mistaken for its own", request->command->name);
    return 0;
}

/* If a reply of this type is pending, stop commands are sent at once, and again after the pending replies are flushed.
 */
enum outcome nomad_serial_transact(struct robot_line *line, const struct request *request, struct reply *reply)
{
    int is_urgent = request->command == &nomad_commands[CMD_ST] || request->command == &nomad_commands[CMD_LP];

    if (line->pending[request->command->line_type]) {
        if (is_urgent && !send_request(line, request))
            return NO_REPLY;
        if (!flush_pending_reply(line, request, reply))
            return NO_REPLY;
    }
    return send_request(line, request) ? receive_reply(line, request, nomad_now() + reply_timeout(request), reply)
                                       : NO_REPLY;
}
