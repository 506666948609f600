/* Session with an Nserver: one request, one reply, in order, on one connection.
 *
 *     connect_robot -> ct with all masks on -> calls ... -> disconnect_robot
 *
 * A reply is never assigned to the wrong call: after a time-out, a lost connection or an invalid reply the connection
 * is closed, and later calls return FALSE. After an error reply the session continues.
 */
#include "address.h"
#include "error.h"
#include "session.h"
#include "client_state.h"
#include "stream.h"

#include <string.h>
#include <unistd.h>

enum {
    DEFAULT_TIMEOUT_MS = 5000,
    CLICK_TIMEOUT_MS = 120000, /* get_robot_conf may wait for a click in the server's window */
    HEAD = 4,
    MAX_REPLY = 4 * 4096, /* bytes; a state with every stamp and 482 lines has 2292 words */
    MAX_REQUEST = HEAD + 4 * 256,
    ERROR_TYPE = 91,
    HELD = 7, /* error of a motion while a person holds the robot */
    REAL_TIME = 10 /* State[STATE_SIM_SPEED] at real time */
};

static int fd = -1;
static struct wire_state wire;
static long robot; /* the robot of this connection */
static int is_hold_reported; /* since a person holds the robot */
static pid_t owner; /* the process that opened it; a forked child shares it */

static enum outcome close_with_error(const struct request *request, const char *why)
{
    nomad_report_error("%s: %s; the connection is closed", request->command->name, why);
    nomad_close(&fd);
    return NO_REPLY;
}

/* Motions take simulated time, which may pass more slowly than real time. */
static milliseconds reply_timeout(const struct request *request)
{
    milliseconds timeout = nomad_reply_timeout(DEFAULT_TIMEOUT_MS),
                 command_ms = request->command->line_timeout_s * 1000;
    double slowness = State[STATE_SIM_SPEED] > 0 && State[STATE_SIM_SPEED] < REAL_TIME
                          ? (double)REAL_TIME / (double)State[STATE_SIM_SPEED]
                          : 1.0;

    if (request->command == &nomad_commands[CMD_WS])
        return timeout + (milliseconds)((double)request->args[3] * 1000 * slowness);
    if (request->command == &nomad_commands[CMD_GET_ROBOT_CONF])
        command_ms = CLICK_TIMEOUT_MS;
    command_ms = command_ms > 1000 ? (milliseconds)((double)command_ms * slowness) : 0;
    return command_ms > timeout ? command_ms : timeout;
}

/* Receive exactly `size` bytes: 1, TIMED_OUT or DISCONNECTED. */
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

/* Calls whose reply has no values succeed also if the server refuses them, as in the old library. */
static int has_simple_reply(const struct command *command)
{
    return command->tcp_reply == SHAPE_SIMPLE && command != &nomad_commands[CMD_CONNECT_ROBOT]
           && command != &nomad_commands[CMD_CREATE_ROBOT];
}

static enum outcome report_refusal(const struct request *request, struct reply *reply)
{
    long code = reply->values[0];
    void (*report)(const char *, ...) = nomad_report_error;
    static const char *const WHY[] = {
        "unknown message",
        "wrong number or range of values",
        "not connected to a robot",
        "not on this robot",
        "not allowed by the setup or a limit, or another client drives the robot",
        "the real robot did not reply",
        "a person holds the robot (Stop): release it on the page or with nserver ctl release",
    };

    /* A program that drives on while a person holds its robot would flood stderr: print it once per hold. */
    if (code == HELD) {
        report = is_hold_reported ? nomad_store_error : nomad_report_error;
        is_hold_reported = 1;
    }
    report("%s: error %ld, %s", request->command->name, code,
           code >= 1 && code <= 7 ? WHY[code - 1] : "an unknown error code");
    nomad_reset_reply(reply, SHAPE_NOTHING);
    if (has_simple_reply(request->command))
        return REPLIED;
    nomad_set_error_code(code);
    return NO_REPLY;
}

/* Decode a reply of `size` bytes. The type distinguishes only error replies from others. */
static enum outcome parse_reply(const struct request *request, unsigned type, const unsigned char *bytes, size_t size,
                                struct reply *reply)
{
    if (type == ERROR_TYPE) {
        if (!nomad_decode_tcp_reply(SHAPE_SIMPLE, bytes, size, &wire, reply))
            return close_with_error(request, "the error reply has no code");
        return report_refusal(request, reply);
    }
    if (!nomad_decode_tcp_reply(request->command->tcp_reply, bytes, size, &wire, reply))
        return close_with_error(request, "the reply has the wrong format");
    /* The last of the 45 words of a state is HELD during a hold; C programs do not see it. */
    if (request->command->tcp_reply == SHAPE_STATE && bytes[4 * STATE_ERROR + 3] != HELD)
        is_hold_reported = 0;
    nomad_apply_reply(reply);
    return REPLIED;
}

static enum outcome receive_reply(const struct request *request, struct reply *reply)
{
    static unsigned char bytes[MAX_REPLY];
    milliseconds deadline = nomad_now() + reply_timeout(request);
    int status = receive(bytes, HEAD, deadline);
    unsigned type = (unsigned)bytes[0] << 8 | bytes[1];
    size_t size = 4 * ((size_t)bytes[2] << 8 | bytes[3]);

    if (status == 1 && size > sizeof bytes)
        return close_with_error(request, "the reply is too long");
    if (status == 1)
        status = receive(bytes, size, deadline);
    if (status != 1)
        return close_with_error(request, status == TIMED_OUT ? "no reply in time" : "the server closed the connection");
    return parse_reply(request, type, bytes, size, reply);
}

enum outcome nomad_transact(const struct request *request, struct reply *reply)
{
    unsigned char bytes[MAX_REQUEST];
    size_t size;

    if (request->command->tcp_type < 0 || request->command == &nomad_commands[CMD_PA]) {
        nomad_report_error("%s: available only on a robot's own line", request->command->name);
        return NO_REPLY;
    }
    size = nomad_encode_tcp_request(request, bytes, sizeof bytes);
    if (size == 0) {
        nomad_report_error("%s: the arguments do not fit into a message", request->command->name);
        return NO_REPLY;
    }
    nomad_update_tcp_state(request, &wire);
    if (nomad_send(fd, bytes, size, nomad_now() + nomad_reply_timeout(DEFAULT_TIMEOUT_MS)) != 1)
        return close_with_error(request, "the server closed the connection");
    if (request->command->tcp_reply == SHAPE_NOTHING)
        return REPLIED;
    return receive_reply(request, reply);
}

/* Connecting */

/* Report conflicting robot numbers instead of choosing one: the wrong choice would move another robot. */
static int has_other_robot_id(const struct address *address, long robot_id)
{
    if (!address->robot || address->robot == robot_id)
        return 0;
    nomad_report_error(
        "NOMAD_ROBOT names robot %ld, the program connects to robot %ld: use the same number, or leave it "
        "out of the address",
        address->robot, robot_id);
    return 1;
}

/* Open a connection to the configured server, for robot `robot_id`. */
static int open_server(long robot_id, struct address *address)
{
    int status = SERVER_MACHINE_NAME[0] ? 0 : nomad_parse_address(address),
        timeout_ms = nomad_reply_timeout(DEFAULT_TIMEOUT_MS), found;
    char hostname[256] = "";

    /* 1. the program's own choice, 2. NOMAD_ROBOT, 3. localhost, 4. the name of this machine */
    if (SERVER_MACHINE_NAME[0]) {
        nomad_report_ignored_address(SERVER_MACHINE_NAME);
        return nomad_open_tcp(SERVER_MACHINE_NAME, SERV_TCP_PORT, timeout_ms, 1);
    }
    if (status < 0)
        return -1;
    if (status && strcmp(address->scheme, "nserver") != 0) {
        nomad_report_error("NOMAD_ROBOT begins with %s://, but this program is linked for nserver://; "
                           "link it with -lndirect to use a robot's own line",
                           address->scheme);
        return -1;
    }
    if (status && has_other_robot_id(address, robot_id))
        return -1;
    if (status)
        return nomad_open_tcp(address->location, SERV_TCP_PORT, timeout_ms, 1);
    found = nomad_open_tcp("localhost", SERV_TCP_PORT, timeout_ms, 0);
    if (found >= 0 || gethostname(hostname, sizeof hostname - 1) != 0)
        return found;
    return nomad_open_tcp(hostname, SERV_TCP_PORT, timeout_ms, 1);
}

static int register_client(enum command_id how, long robot_id)
{
    const long numbers[2] = {robot_id, (long)getpid()};
    const struct reply *reply = nomad_request_numbers(how, numbers, 2);
    long port = reply ? reply->values[0] : 0;

    if (reply && port == 0)
        nomad_report_error(how == CMD_CREATE_ROBOT
                               ? "%s: the server cannot create robot number %ld: no free space, or the "
                                 "number of robots is limited (see nserver -v)"
                               : "%s: the server has no robot number %ld",
                           nomad_commands[how].name, robot_id);
    return (int)port;
}

/* Leave the previous connection. A connection that the parent of this process opened is only closed here: DISCONNECT
 * would end it for the parent. */
static void leave(int previous)
{
    struct request request = {.command = &nomad_commands[CMD_DISCONNECT_ROBOT], .args = {robot, (long)getpid()}, .count = 2};
    unsigned char bytes[MAX_REQUEST];

    if (previous >= 0 && owner == getpid())
        nomad_send(previous, bytes, nomad_encode_tcp_request(&request, bytes, sizeof bytes), nomad_now());
    nomad_close(&previous);
}

int nomad_connect(enum command_id how, long robot_id, const struct line_arguments *line)
{
    struct address address = {.tm_s = 0};
    long state[NUM_STATE];
    int laser[2 * NUM_LASER + 1], previous = fd, port, connected;

    (void)line;
    /* 1. Register over a new connection. If that fails, the program keeps the connection it has. */
    fd = open_server(robot_id, &address);
    if (fd < 0)
        nomad_set_error_code(NO_SERVER);
    port = fd < 0 ? 0 : register_client(how, robot_id);
    if (port == 0) {
        nomad_close(&fd);
        fd = previous;
        return FALSE;
    }
    /* 2. Leave the previous one. */
    leave(previous);
    robot = robot_id;
    owner = getpid();
    /* 3. Set up the new one. create_robot leaves State unchanged. */
    wire.laser_mode = DEFAULT_LASER_MODE;
    wire.laser_width = POINTS;
    memcpy(wire.mask, nomad_full_mask, sizeof wire.mask);
    nomad_reset_client_state(nomad_full_mask);
    get_state(state);
    get_laser(laser);
    connected = ct() && (address.tm_s <= 0 || conf_tm((unsigned char)address.tm_s));
    if (connected && how == CMD_CREATE_ROBOT) {
        memcpy(State, state, sizeof state);
        memcpy(Laser, laser, sizeof laser);
    }
    if (!connected)
        nomad_close(&fd);
    return connected ? port : FALSE;
}

int nomad_open_line(const struct line_arguments *line)
{
    (void)line;
    nomad_report_error("open_serial: available only for a robot's own line; link with -lndirect");
    return FALSE;
}

int nomad_disconnect(long robot_id)
{
    const long numbers[2] = {robot_id, (long)getpid()};
    int is_sent;

    if (!nomad_is_connected())
        return FALSE;
    is_sent = nomad_request_numbers(CMD_DISCONNECT_ROBOT, numbers, 2) != NULL;
    nomad_close(&fd);
    return is_sent;
}

int nomad_is_connected(void) { return fd >= 0; }

int nomad_is_ignored(const struct command *command)
{
    (void)command;
    return 0;
}

int nomad_sends_mask(void) { return 1; }
