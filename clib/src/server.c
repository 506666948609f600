/* An Nserver: one request, one reply, in order, on one connection.
 *
 *     connect_robot -> ct, all masks on -> calls ... -> disconnect_robot
 *
 * Rules: an answer is never taken for another call's. After a time-out, a connection that ended, or an answer that
 * does not fit its call, the connection is closed, and the calls behind it are FALSE. After a refusal it goes on.
 */
#include "address.h"
#include "complain.h"
#include "conversation.h"
#include "held.h"
#include "stream.h"

#include <string.h>
#include <unistd.h>

enum {
    USUAL_MS = 5000,
    CLICK_MS = 120000, /* get_robot_conf may wait for a click in the server's window */
    HEAD = 4,
    MAX_REPLY = 4 * 4096, /* bytes; a state with every stamp and 482 lines has 2292 words */
    MAX_REQUEST = HEAD + 4 * 256,
    ERROR_TYPE = 91,
    REAL_TIME = 10
};

static int fd = -1;
static struct terms terms;

static enum answer drop(const struct request *request, const char *why)
{
    nomad_complain("%s: %s; the connection is closed", request->command->name, why);
    nomad_close(&fd);
    return NO_ANSWER;
}

/* Motions are waited for in the server's time, which may run slower than ours. */
static milliseconds patience(const struct request *request)
{
    milliseconds usual = nomad_patience(USUAL_MS), own = request->command->line_timeout_s * 1000;
    double slowness = State[STATE_SIM_SPEED] > 0 && State[STATE_SIM_SPEED] < REAL_TIME
                          ? (double)REAL_TIME / (double)State[STATE_SIM_SPEED]
                          : 1.0;

    if (request->command == &nomad_commands[CMD_WS])
        return usual + (milliseconds)((double)request->args[3] * 1000 * slowness);
    if (request->command == &nomad_commands[CMD_GET_ROBOT_CONF])
        own = CLICK_MS;
    own = own > 1000 ? (milliseconds)((double)own * slowness) : 0;
    return own > usual ? own : usual;
}

/* So many bytes: 1, SILENT or LOST. */
static int receive(unsigned char *bytes, size_t size, milliseconds deadline)
{
    while (size > 0) {
        long got = nomad_receive(fd, bytes, size, deadline);

        if (got <= 0)
            return (int)got;
        bytes += got;
        size -= (size_t)got;
    }
    return 1;
}

static enum answer refused(const struct request *request, long code)
{
    static const char *const WHY[] = {
        "unknown message",      "wrong number or range of values", "not connected to a robot", "not on this robot",
        "not allowed by the setup or a limit, or another client drives the robot", "the real robot did not answer",
    };

    nomad_hold_error(code);
    nomad_complain("%s: refused with error %ld, %s", request->command->name, code,
                   code >= 1 && code <= 6 ? WHY[code - 1] : "whatever that is");
    return NO_ANSWER;
}

/* The answer out of a frame; `size` in bytes. Only the type of an error is looked at. */
static enum answer understood(const struct request *request, unsigned type, const unsigned char *bytes, size_t size,
                              struct reply *reply)
{
    if (type == ERROR_TYPE) {
        if (!nomad_read_tcp_reply(SHAPE_SIMPLE, bytes, size, &terms, reply))
            return drop(request, "it was answered by an error without its code");
        return refused(request, reply->values[0]);
    }
    if (!nomad_read_tcp_reply(request->command->tcp_reply, bytes, size, &terms, reply))
        return drop(request, "the answer does not fit it");
    nomad_hold(reply);
    return ANSWERED;
}

static enum answer hear(const struct request *request, struct reply *reply)
{
    static unsigned char bytes[MAX_REPLY];
    milliseconds deadline = nomad_now() + patience(request);
    int heard = receive(bytes, HEAD, deadline);
    unsigned type = (unsigned)bytes[0] << 8 | bytes[1];
    size_t size = 4 * ((size_t)bytes[2] << 8 | bytes[3]);

    if (heard == 1 && size > sizeof bytes)
        return drop(request, "the answer is longer than any can be");
    if (heard == 1)
        heard = receive(bytes, size, deadline);
    if (heard != 1)
        return drop(request, heard == SILENT ? "no answer in time" : "the server has gone");
    return understood(request, type, bytes, size, reply);
}

enum answer nomad_answer(const struct request *request, struct reply *reply)
{
    unsigned char bytes[MAX_REQUEST];
    size_t size;

    if (request->command->tcp_type < 0 || request->command == &nomad_commands[CMD_PA]) {
        nomad_complain("%s: exists only on a robot's own line", request->command->name);
        return NO_ANSWER;
    }
    size = nomad_tcp_request(request, bytes, sizeof bytes);
    if (size == 0) {
        nomad_complain("%s: no message can carry this", request->command->name);
        return NO_ANSWER;
    }
    nomad_note_on_tcp(request, &terms);
    if (nomad_send(fd, bytes, size, nomad_now() + nomad_patience(USUAL_MS)) != 1)
        return drop(request, "the server has gone");
    if (request->command->tcp_reply == SHAPE_NOTHING)
        return ANSWERED;
    return hear(request, reply);
}

/* Connecting */

/* Neither wins: one of the two would move a robot that nobody meant. */
static int is_another(const struct address *address, const long *robot_id)
{
    if (!robot_id || !address->robot || address->robot == *robot_id)
        return 0;
    nomad_complain("NOMAD_ROBOT names robot %ld, the program asks for robot %ld: let both say the same, or leave the "
                   "number out of the address", address->robot, *robot_id);
    return 1;
}

/* `robot_id`: whom the program asks for; NULL where it only looks. */
static int open_named(const long *robot_id, int aloud, struct address *address)
{
    int named = SERVER_MACHINE_NAME[0] ? 0 : nomad_address(address), patience_ms = nomad_patience(USUAL_MS), found;
    char own[256] = "";

    if (SERVER_MACHINE_NAME[0])
        return nomad_open_tcp(SERVER_MACHINE_NAME, SERV_TCP_PORT, patience_ms, aloud);
    if (named < 0)
        return -1;
    if (named && strcmp(address->scheme, "nserver") != 0) {
        nomad_complain("NOMAD_ROBOT begins with %s://, and this program was linked to talk to an nserver://; "
                       "link it with -lndirect for a robot's own line", address->scheme);
        return -1;
    }
    if (named && is_another(address, robot_id))
        return -1;
    if (named)
        return nomad_open_tcp(address->place, SERV_TCP_PORT, patience_ms, aloud);
    found = nomad_open_tcp("localhost", SERV_TCP_PORT, patience_ms, 0);
    if (found >= 0 || gethostname(own, sizeof own - 1) != 0)
        return found;
    return nomad_open_tcp(own, SERV_TCP_PORT, patience_ms, aloud);
}

static int join(enum command_id how, long robot_id)
{
    const long numbers[2] = {robot_id, (long)getpid()};
    const struct reply *reply = nomad_ask_numbers(how, numbers, 2);
    long port = reply ? reply->values[0] : 0;

    if (reply && port == 0)
        nomad_complain(how == CMD_CREATE_ROBOT ? "%s: the server makes no robot number %ld: no room for one more, or no "
                                                 "more are made (nserver -v)"
                                               : "%s: the server has no robot number %ld",
                       nomad_commands[how].name, robot_id);
    return (int)port;
}

int nomad_connect(enum command_id how, long robot_id, va_list *more, int known)
{
    struct address address = {.tm_s = 0};
    int port;

    (void)more;
    (void)known;
    if (nomad_is_connected())
        nomad_disconnect(robot_id);
    fd = open_named(&robot_id, 1, &address);
    if (fd < 0)
        return FALSE;
    terms.laser_mode = DEFAULT_LASER_MODE;
    terms.laser_width = POINTS;
    memcpy(terms.mask, nomad_everything, sizeof terms.mask);
    nomad_begin_holding(nomad_everything);
    port = join(how, robot_id);
    if (port == 0 || !ct() || (address.tm_s > 0 && !conf_tm(address.tm_s))) {
        nomad_close(&fd);
        return FALSE;
    }
    return port;
}

int nomad_disconnect(long robot_id)
{
    const long numbers[2] = {robot_id, (long)getpid()};
    int said;

    if (!nomad_is_connected())
        return FALSE;
    said = nomad_ask_numbers(CMD_DISCONNECT_ROBOT, numbers, 2) != NULL;
    nomad_close(&fd);
    return said;
}

int nomad_is_connected(void)
{
    return fd >= 0;
}

int nomad_is_running(void)
{
    struct address address;
    int found = open_named(NULL, 0, &address), running = found >= 0;

    nomad_close(&found);
    return running;
}
