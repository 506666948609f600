/* One question, one answer, for whoever answers. */
#include "complain.h"
#include "conversation.h"
#include "nomad.h"

#include <string.h>

int nomad_timeout_ms = 0;

static int missing_was_said;

int nomad_patience(int usual_ms)
{
    return nomad_timeout_ms > 0 ? nomad_timeout_ms : usual_ms;
}

/* Said once, until a connection is made: an old loop asks on without looking, hundreds of thousands of times a second. */
static void complain_of_nobody(const struct request *request)
{
    nomad_keep("%s: no robot is connected; connect_robot comes first", request->command->name);
    if (missing_was_said)
        return;
    nomad_remark("Nclient: %s", nomad_last_error());
    missing_was_said = nomad_verbose;
}

int nomad_meet(enum command_id how, long robot_id, va_list *more, int known)
{
    int connected = nomad_connect(how, robot_id, more, known);

    if (connected)
        missing_was_said = 0;
    return connected;
}

const struct reply *nomad_ask(const struct request *request)
{
    static struct reply reply;

    if (!nomad_is_connected()) {
        complain_of_nobody(request);
        return NULL;
    }
    switch (nomad_answer(request, &reply)) {
    case ANSWERED:
        return &reply;
    case NOT_ACKNOWLEDGED: /* which the old library took for done */
        nomad_remark("Nak");
        nomad_begin(&reply, SHAPE_NOTHING);
        return &reply;
    default:
        return NULL;
    }
}

const struct reply *nomad_ask_numbers(enum command_id id, const long *numbers, int count)
{
    struct request request = {0};

    request.command = &nomad_commands[id];
    request.count = count < MAX_ARGS ? count : MAX_ARGS;
    for (int k = 0; k < request.count; k++)
        request.args[k] = numbers[k];
    return nomad_ask(&request);
}
