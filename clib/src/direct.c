/* A robot on its own line: a serial port, or a TCP port behind which the line is.
 *
 * Rules: what a model's line does not have is refused here and not sent. A ct or conf_ls that was not answered leaves
 * the shape of states unknown: it is said again before anything else. One question and its answer: line_exchange.c.
 */
#include "complain.h"
#include "conversation.h"
#include "held.h"
#include "line_exchange.h"
#include "line_place.h"
#include "stream.h"

#include <string.h>

enum {
    HELLO_MS = 5000,
    OPEN_MS = 5000,
    HELLO_SIZE = 11, /* what a N200 says first over TCP: mask and laser mode in force */
    GREETINGS = 3,
    LONGEST_WAIT_S = 255
};

static struct robot_line line = {.fd = -1};
static struct request doubtful[2]; /* ct and conf_ls, while nobody knows whether they were heard */

/* Where a request that shapes states is kept while in doubt; NULL for the others. */
static struct request *place_of(const struct request *request)
{
    if (request->command == &nomad_commands[CMD_CT])
        return &doubtful[0];
    return request->command == &nomad_commands[CMD_CONF_LS] ? &doubtful[1] : NULL;
}

static enum answer shape(const struct request *request, struct reply *reply)
{
    struct terms before = line.terms;
    struct request *place = place_of(request), asked = *request;
    enum answer answer;

    nomad_note_on_line(&asked, &line.terms);
    answer = nomad_exchange(&line, &asked, reply);
    if (answer == NOT_ACKNOWLEDGED)
        line.terms = before;
    if (answer == NO_ANSWER)
        *place = asked;
    else
        place->command = NULL;
    return answer;
}

static int settled(const struct request *request, struct reply *reply)
{
    for (int k = 0; k < 2; k++)
        if (line.fd >= 0 && doubtful[k].command && place_of(request) != &doubtful[k]
            && shape(&doubtful[k], reply) == NO_ANSWER) {
            nomad_complain("%s: held back, since %s before it was not answered", request->command->name,
                           doubtful[k].command ? doubtful[k].command->name : "a command");
            return 0;
        }
    return line.fd >= 0;
}

static int is_refused(const struct command *command)
{
    static const char *const NAMES[] = {"N200", "N150", "Scout"};

    if (command->line_type < 0)
        nomad_complain("%s: exists only on an Nserver", command->name);
    else if (!(command->models >> line.terms.model & 1))
        nomad_complain("%s: a %s does not have it on its own line", command->name, NAMES[line.terms.model]);
    else
        return 0;
    return 1;
}

static enum answer answer_plainly(const struct request *request, struct reply *reply)
{
    if (is_refused(request->command) || !settled(request, reply))
        return NO_ANSWER;
    return place_of(request) ? shape(request, reply) : nomad_exchange(&line, request, reply);
}

/* A wait longer than a byte can say, in pieces: until the axes named are still, or its time is over. */
static enum answer wait_in_pieces(const struct request *request, struct reply *reply)
{
    struct request piece = *request;
    long left = request->args[3];

    for (;;) {
        enum answer answer;
        long moving;

        piece.args[3] = left < LONGEST_WAIT_S ? left : LONGEST_WAIT_S;
        left -= piece.args[3];
        answer = answer_plainly(&piece, reply);
        moving = (request->args[0] != 0) | (request->args[1] != 0) << 1 | (request->args[2] != 0) << 2;
        if (answer != ANSWERED || left <= 0 || !(State[STATE_MOTOR_STATUS] & moving))
            return answer;
    }
}

static enum answer place_robot_by_halves(const struct request *request, struct reply *reply)
{
    struct request half = *request;
    enum answer answer;

    half.command = &nomad_commands[CMD_DP];
    half.count = 2;
    answer = answer_plainly(&half, reply);
    if (answer != ANSWERED)
        return answer;
    half.command = &nomad_commands[CMD_DA];
    memcpy(half.args, request->args + 2, 2 * sizeof *half.args);
    return answer_plainly(&half, reply);
}

enum answer nomad_answer(const struct request *request, struct reply *reply)
{
    if (request->command == &nomad_commands[CMD_PLACE_ROBOT])
        return place_robot_by_halves(request, reply);
    if (request->command == &nomad_commands[CMD_WS])
        return wait_in_pieces(request, reply);
    return answer_plainly(request, reply);
}

/* Connecting */

/* The hello: b0 .. b4 of the mask | bit 0 = compass | bit 0 = laser, position-data bits x 2 | laser mode | 3 unread */
static int adopt_hello(void)
{
    unsigned char hello[HELLO_SIZE];
    milliseconds deadline = nomad_now() + HELLO_MS;

    for (size_t held = 0; held < sizeof hello;) {
        long got = nomad_receive(line.fd, hello + held, sizeof hello - held, deadline);
        if (got <= 0) {
            nomad_complain("connect_robot: a N200 says %d bytes first, and they did not come; is the robot of this "
                           "model?", HELLO_SIZE);
            return 0;
        }
        held += (size_t)got;
    }
    for (int k = 0; k < 40; k++)
        line.terms.mask[1 + k] = hello[k / 8] >> k % 8 & 1;
    line.terms.mask[41] = 1;
    line.terms.mask[SMASK_COMPASS] = hello[5] & 1;
    line.terms.mask[SMASK_LASER] = hello[6] & 1;
    line.terms.mask[SMASK_POS_DATA] = hello[6] >> 1 & POS_ALL;
    line.terms.laser_mode = hello[7];
    line.terms.laser_width = nomad_line_laser_width(hello[7]);
    nomad_begin_holding(line.terms.mask);
    return 1;
}

static int greet(const struct place *place)
{
    if (place->model != MODEL_N200)
        return 1; /* their mask is fixed and never sent */
    if (!place->is_port)
        return adopt_hello();
    for (int k = 0; k < GREETINGS && line.fd >= 0; k++)
        if (ct())
            return 1;
    return 0;
}

static void begin(const struct place *place)
{
    const int *mask = place->model == MODEL_N200 ? nomad_everything : nomad_fixed_mask;

    line.terms.model = place->model;
    memcpy(line.terms.mask, mask, sizeof line.terms.mask);
    line.terms.laser_mode = DEFAULT_LASER_MODE;
    line.terms.laser_width = PIXELS;
    line.frames.held = 0;
    memset(line.owed, 0, sizeof line.owed);
    doubtful[0].command = doubtful[1].command = NULL;
    nomad_begin_holding(mask);
}

int nomad_connect(enum command_id how, long robot_id, va_list *more, int known)
{
    struct place place;

    if (how != CMD_CONNECT_ROBOT) {
        nomad_complain("%s: exists only on an Nserver", nomad_commands[how].name);
        return FALSE;
    }
    if (nomad_is_connected())
        nomad_disconnect(robot_id);
    if (!nomad_place_from_arguments(&place, more, known))
        return FALSE;
    if (place.model < 0 || place.model > MODEL_SCOUT) {
        nomad_complain("connect_robot: a model's number is 0 (N200), 1 (N150) or 2 (Scout), not %d", place.model);
        return FALSE;
    }
    line.fd = place.is_port ? nomad_open_serial(place.name, place.number)
                            : nomad_open_tcp(place.name, place.number, nomad_patience(OPEN_MS), 1);
    if (line.fd < 0)
        return FALSE;
    begin(&place);
    if (greet(&place) && (!place.tm_s || conf_tm(place.tm_s)))
        return TRUE;
    nomad_close(&line.fd);
    return FALSE;
}

int nomad_disconnect(long robot_id)
{
    (void)robot_id;
    if (!nomad_is_connected())
        return FALSE;
    nomad_close(&line.fd);
    return TRUE;
}

int nomad_is_connected(void)
{
    return line.fd >= 0;
}

/* There is no server; what can be told is whether the line can be opened. */
int nomad_is_running(void)
{
    struct place place;
    int found, running;

    if (nomad_is_connected())
        return TRUE;
    if (!nomad_place_from_outside(&place))
        return FALSE;
    found = place.is_port ? nomad_open_serial(place.name, place.number)
                          : nomad_open_tcp(place.name, place.number, nomad_patience(OPEN_MS), 0);
    running = found >= 0;
    nomad_close(&found);
    return running;
}
