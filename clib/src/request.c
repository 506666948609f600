/* Sends one request and returns its reply, over whichever transport the library has. */
#include "error.h"
#include "client_state.h"
#include "session.h"
#include "nomad.h"

#include <string.h>

int nomad_timeout_ms = 0;

static int is_missing_reported;

int nomad_reply_timeout(int default_ms) { return nomad_timeout_ms > 0 ? nomad_timeout_ms : default_ms; }

/* Print this error once per lost connection: old programs repeat a failing call in a tight loop and would flood stderr.
 */
static void report_not_connected(const struct request *request)
{
    nomad_store_error("%s: no robot is connected; call connect_robot first", request->command->name);
    if (is_missing_reported)
        return;
    nomad_print("Nclient: %s", nomad_last_error());
    is_missing_reported = nomad_verbose;
}

int nomad_open_session(enum command_id how, long robot_id, const struct line_arguments *line)
{
    int connected = nomad_connect(how, robot_id, line);

    if (connected)
        is_missing_reported = 0;
    return connected;
}

const struct reply *nomad_request(const struct request *request)
{
    static struct reply reply;

    nomad_reset_reply(&reply, SHAPE_NOTHING);
    if (nomad_is_ignored(request->command))
        return &reply;
    if (!nomad_is_connected()) {
        report_not_connected(request);
        nomad_set_error_code(NO_SERVER);
        return NULL;
    }
    switch (nomad_transact(request, &reply)) {
    case REPLIED: return &reply;
    case NOT_ACKNOWLEDGED: /* the old library treats a NAK as success */
        nomad_print("Nak");
        nomad_reset_reply(&reply, SHAPE_NOTHING);
        return &reply;
    default: break;
    }
    if (!nomad_is_connected())
        nomad_set_error_code(NO_SERVER);
    return NULL;
}

const struct reply *nomad_request_numbers(enum command_id id, const long *numbers, int count)
{
    struct request request = {0};

    request.command = &nomad_commands[id];
    request.count = count < MAX_ARGS ? count : MAX_ARGS;
    for (int k = 0; k < request.count; k++)
        request.args[k] = numbers[k];
    return nomad_request(&request);
}
