/* A robot on its own line: a serial port, or a TCP port behind which the line is.
 *
 * Rules: a command goes out once, after the input was emptied, and the frame of its type or a NAK answers it; other
 * frames are late answers of others and are passed over. Silence or an answer that does not fit is FALSE, State as it
 * was, and the line stays usable. A question without answer stays owed: before another of its type goes out, one of a
 * type that is not owed is asked, for a robot answers in order, and behind that answer nothing late can come (st and lp
 * go out at once all the same). A ct or conf_ls that was not answered leaves the shape of states unknown: it is said
 * again before anything else. What a model's line does not have is refused here and not sent.
 */
#include "address.h"
#include "complain.h"
#include "conversation.h"
#include "held.h"
#include "line_frames.h"
#include "stream.h"

#include <string.h>

enum {
    USUAL_MS = 1000,
    HELLO_MS = 5000,
    OPEN_MS = 5000,
    GAP_MS = 250,    /* silence within an answer after which no more of it comes */
    QUIET = 2,       /* times the usual patience: silence after which no late answer comes, for want of a better way */
    LONGEST_QUIET = 10,
    TYPES = 256,
    HELLO_SIZE = 11, /* what a N200 says first over TCP: mask and laser mode in force */
    GREETINGS = 3,
    LONGEST_WAIT_S = 255
};

struct line {
    int is_port;
    char place[80];
    int number; /* baud, or TCP port */
    int model;
};

static int fd = -1;
static struct terms terms;
static struct line_frames frames;
static unsigned char owed[TYPES];  /* types whose answer may still come late */
static struct request doubtful[2]; /* ct and conf_ls, while nobody knows whether they were heard */

/* One exchange */

static void empty_input(void)
{
    nomad_flush(fd);
    frames.held = 0;
}

static enum answer lost(const struct request *request)
{
    nomad_complain("%s: the line is gone; connect again", request->command->name);
    nomad_close(&fd);
    return NO_ANSWER;
}

/* The next whole frame: 1, SILENT, LOST. Behind a piece of one no more than GAP_MS is waited for the rest. */
static int next_frame(struct line_frame *frame, milliseconds deadline)
{
    int heard = 0;

    for (;;) {
        milliseconds gap = nomad_now() + GAP_MS;
        long got;

        if (nomad_take_frame(&frames, frame))
            return 1;
        got = nomad_receive(fd, frames.bytes + frames.held, nomad_room(&frames),
                            heard && gap < deadline ? gap : deadline);
        if (got == LOST)
            return LOST;
        if (got == SILENT)
            break;
        frames.held += (size_t)got;
        heard = 1;
        if (nomad_now() >= deadline) /* a line that babbles */
            break;
    }
    while (nomad_give_up(&frames))
        if (nomad_take_frame(&frames, frame))
            return 1;
    return SILENT;
}

static int owes_any(void)
{
    for (int k = 0; k < TYPES; k++)
        if (owed[k])
            return 1;
    return 0;
}

/* While others are owed, a NAK may be any's, and counts as nobody's. */
static enum answer hear(const struct request *request, milliseconds deadline, struct reply *reply)
{
    static struct line_frame frame;

    for (;;) {
        int heard = next_frame(&frame, deadline);

        if (heard == LOST)
            return lost(request);
        if (heard == SILENT) {
            owed[request->command->line_type] = 1;
            nomad_complain("%s: no good answer came", request->command->name);
            return NO_ANSWER;
        }
        if (frame.type == NAK_TYPE && frame.size == 0 && !owes_any())
            return NOT_ACKNOWLEDGED;
        if (frame.type == request->command->line_type)
            break;
        owed[frame.type] = 0;
    }
    memset(owed, 0, sizeof owed); /* what was asked before and has not come is lost */
    if (!nomad_read_line_reply(request->command->line_reply, frame.data, frame.size, &terms, reply)) {
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

static int say(const struct request *request)
{
    unsigned char bytes[HOST_LIMIT];
    size_t size = nomad_line_request(request, bytes, sizeof bytes);

    if (size == 0) {
        nomad_complain("%s: a frame of a host has at most %d bytes", request->command->name, HOST_LIMIT);
        return 0;
    }
    empty_input();
    if (nomad_send(fd, bytes, size, nomad_now() + USUAL_MS) == 1)
        return 1;
    lost(request);
    return 0;
}

static int wait_for_quiet(void)
{
    unsigned char rubbish[512];
    milliseconds usual = nomad_patience(USUAL_MS), end = nomad_now() + LONGEST_QUIET * usual;

    while (nomad_now() < end) {
        long got = nomad_receive(fd, rubbish, sizeof rubbish, nomad_now() + QUIET * usual);

        if (got == SILENT)
            memset(owed, 0, sizeof owed);
        if (got <= 0)
            return got == SILENT;
    }
    return 0;
}

/* See to it that no late answer can pass for this question's. */
static int see_off(const struct request *request, struct reply *reply)
{
    static const enum command_id PROBES[] = {CMD_GET_RA, CMD_GET_RV, CMD_GET_RC, CMD_GET_BP, CMD_GET_SN};
    struct request probe = {0};

    for (size_t k = 0; k < sizeof PROBES / sizeof *PROBES && probe.command == NULL; k++)
        if (!owed[nomad_commands[PROBES[k]].line_type])
            probe.command = &nomad_commands[PROBES[k]];
    if (probe.command ? say(&probe) && hear(&probe, nomad_now() + patience(&probe), reply) == ANSWERED
                      : wait_for_quiet())
        return 1;
    nomad_complain("%s: held back, since a late answer could have passed for its own", request->command->name);
    return 0;
}

static enum answer exchange(const struct request *request, struct reply *reply)
{
    int is_urgent = request->command == &nomad_commands[CMD_ST] || request->command == &nomad_commands[CMD_LP];

    if (owed[request->command->line_type]) {
        if (is_urgent && !say(request))
            return NO_ANSWER;
        if (!see_off(request, reply))
            return NO_ANSWER;
    }
    return say(request) ? hear(request, nomad_now() + patience(request), reply) : NO_ANSWER;
}

/* Around it */

/* Where a request that shapes states is kept while in doubt; NULL for the others. */
static struct request *place_of(const struct request *request)
{
    if (request->command == &nomad_commands[CMD_CT])
        return &doubtful[0];
    return request->command == &nomad_commands[CMD_CONF_LS] ? &doubtful[1] : NULL;
}

static enum answer shape(const struct request *request, struct reply *reply)
{
    struct terms before = terms;
    struct request *place = place_of(request), asked = *request;
    enum answer answer;

    nomad_note_on_line(&asked, &terms);
    answer = exchange(&asked, reply);
    if (answer == NOT_ACKNOWLEDGED)
        terms = before;
    if (answer == NO_ANSWER)
        *place = asked;
    else
        place->command = NULL;
    return answer;
}

static int settled(const struct request *request, struct reply *reply)
{
    for (int k = 0; k < 2; k++)
        if (fd >= 0 && doubtful[k].command && place_of(request) != &doubtful[k]
            && shape(&doubtful[k], reply) == NO_ANSWER) {
            nomad_complain("%s: held back, since %s before it was not answered", request->command->name,
                           doubtful[k].command ? doubtful[k].command->name : "a command");
            return 0;
        }
    return fd >= 0;
}

static int is_refused(const struct command *command)
{
    static const char *const NAMES[] = {"N200", "N150", "Scout"};

    if (command->line_type < 0)
        nomad_complain("%s: exists only on an Nserver", command->name);
    else if (!(command->models >> terms.model & 1))
        nomad_complain("%s: a %s does not have it on its own line", command->name, NAMES[terms.model]);
    else
        return 0;
    return 1;
}

static enum answer answer_plainly(const struct request *request, struct reply *reply)
{
    if (is_refused(request->command) || !settled(request, reply))
        return NO_ANSWER;
    return place_of(request) ? shape(request, reply) : exchange(request, reply);
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

static enum answer place(const struct request *request, struct reply *reply)
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
        return place(request, reply);
    if (request->command == &nomad_commands[CMD_WS])
        return wait_in_pieces(request, reply);
    return answer_plainly(request, reply);
}

/* Connecting */

static int fill(struct line *line, const char *place, int is_port, int number, int model)
{
    if (strlen(place) >= sizeof line->place) {
        nomad_complain("connect_robot: the name of a device or host has at most %d characters",
                       (int)sizeof line->place - 1);
        return 0;
    }
    memcpy(line->place, place, strlen(place) + 1);
    line->is_port = is_port;
    line->number = number;
    line->model = model;
    return 1;
}

/* Where a robot is that is named by its number alone: NOMAD_ROBOT, else the globals. */
static int from_outside(struct line *line)
{
    struct address address;
    int found = nomad_address(&address), model = DEFAULT_ROBOT_MODEL;

    if (found < 0)
        return 0;
    if (!found)
        return ROBOT_MACHINE_NAME[0] ? fill(line, ROBOT_MACHINE_NAME, 0, CONN_TCP_PORT, model)
                                     : fill(line, DEFAULT_SERIAL_PORT, 1, DEFAULT_SERIAL_BAUD, model);
    if (address.model >= 0)
        model = address.model;
    if (strcmp(address.scheme, "serial") == 0)
        return fill(line, address.place, 1, address.baud ? address.baud : DEFAULT_SERIAL_BAUD, model);
    if (strcmp(address.scheme, "robotd") == 0)
        return fill(line, address.place, 0, CONN_TCP_PORT, model);
    nomad_complain("NOMAD_ROBOT begins with %s://, and this program was linked for a robot's own line, serial:// or "
                   "robotd://; link it with -lnclient for an Nserver", address.scheme);
    return 0;
}

static int from_arguments(struct line *line, va_list *more, int known)
{
    int model = va_arg(*more, int), number;
    const char *place;

#ifdef NOMAD_NO_MORE
    if (known && model == NOMAD_NO_MORE)
        return from_outside(line);
#endif
    place = va_arg(*more, const char *);
    number = va_arg(*more, int);
    return fill(line, place, place[0] == '/', number, model);
}

/* b0 .. b4 of the mask | bit 0 = compass | bit 0 = laser, position-data bits x 2 | laser mode | 3 that nobody reads */
static int adopt_hello(void)
{
    unsigned char hello[HELLO_SIZE];
    milliseconds deadline = nomad_now() + HELLO_MS;

    for (size_t held = 0; held < sizeof hello;) {
        long got = nomad_receive(fd, hello + held, sizeof hello - held, deadline);
        if (got <= 0) {
            nomad_complain("connect_robot: a N200 says %d bytes first, and they did not come; is the robot of this "
                           "model?", HELLO_SIZE);
            return 0;
        }
        held += (size_t)got;
    }
    for (int k = 0; k < 40; k++)
        terms.mask[1 + k] = hello[k / 8] >> k % 8 & 1;
    terms.mask[41] = 1;
    terms.mask[SMASK_COMPASS] = hello[5] & 1;
    terms.mask[SMASK_LASER] = hello[6] & 1;
    terms.mask[SMASK_POS_DATA] = hello[6] >> 1 & POS_ALL;
    terms.laser_mode = hello[7];
    terms.laser_width = nomad_line_laser_width(hello[7]);
    nomad_begin_holding(terms.mask);
    return 1;
}

static int greet(const struct line *line)
{
    if (line->model != MODEL_N200)
        return 1; /* their mask is fixed and never sent */
    if (!line->is_port)
        return adopt_hello();
    for (int k = 0; k < GREETINGS && fd >= 0; k++)
        if (ct())
            return 1;
    return 0;
}

static void begin(const struct line *line)
{
    const int *mask = line->model == MODEL_N200 ? nomad_everything : nomad_fixed_mask;

    terms.model = line->model;
    memcpy(terms.mask, mask, sizeof terms.mask);
    terms.laser_mode = DEFAULT_LASER_MODE;
    terms.laser_width = PIXELS;
    frames.held = 0;
    memset(owed, 0, sizeof owed);
    doubtful[0].command = doubtful[1].command = NULL;
    nomad_begin_holding(mask);
}

int nomad_connect(enum command_id how, long robot_id, va_list *more, int known)
{
    struct line line;

    if (how != CMD_CONNECT_ROBOT) {
        nomad_complain("%s: exists only on an Nserver", nomad_commands[how].name);
        return FALSE;
    }
    if (nomad_is_connected())
        nomad_disconnect(robot_id);
    if (!from_arguments(&line, more, known))
        return FALSE;
    if (line.model < 0 || line.model > MODEL_SCOUT) {
        nomad_complain("connect_robot: a model's number is 0 (N200), 1 (N150) or 2 (Scout), not %d", line.model);
        return FALSE;
    }
    fd = line.is_port ? nomad_open_serial(line.place, line.number)
                      : nomad_open_tcp(line.place, line.number, nomad_patience(OPEN_MS), 1);
    if (fd < 0)
        return FALSE;
    begin(&line);
    if (greet(&line))
        return TRUE;
    nomad_close(&fd);
    return FALSE;
}

int nomad_disconnect(long robot_id)
{
    (void)robot_id;
    if (!nomad_is_connected())
        return FALSE;
    nomad_close(&fd);
    return TRUE;
}

int nomad_is_connected(void)
{
    return fd >= 0;
}

/* There is no server; what can be told is whether the line can be opened. */
int nomad_is_running(void)
{
    struct line line;
    int found, running;

    if (nomad_is_connected())
        return TRUE;
    if (!from_outside(&line))
        return FALSE;
    found = line.is_port ? nomad_open_serial(line.place, line.number)
                         : nomad_open_tcp(line.place, line.number, nomad_patience(OPEN_MS), 0);
    running = found >= 0;
    nomad_close(&found);
    return running;
}
