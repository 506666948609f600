/* One question, one answer, for whoever answers. */
#include "complain.h"
#include "conversation.h"
#include "nomad.h"

#include <string.h>

int nomad_timeout_ms = 0;

int nomad_patience(int usual_ms)
{
    return nomad_timeout_ms > 0 ? nomad_timeout_ms : usual_ms;
}

const struct reply *nomad_ask(const struct request *request)
{
    static struct reply reply;

    if (!nomad_is_connected()) {
        nomad_complain("%s: no robot is connected; connect_robot comes first", request->command->name);
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
