/* Session with a robot on its own line: a serial port, or a TCP port connected to the line.
 *
 * Commands that the model does not have are rejected here and not sent. After a ct or conf_ls without a reply the
 * layout of state replies is unknown; it is sent again before any other command. serial_session.c does a single
 * exchange.
 */
#include "error.h"
#include "session.h"
#include "client_state.h"
#include "serial_session.h"
#include "serial_config.h"
#include "stream.h"

#include <stdio.h>
#include <string.h>

enum {
    HANDSHAKE_MS = 5000,
    OPEN_MS = 5000,
    HANDSHAKE_SIZE = 11, /* an N200 first sends its mask and laser mode over TCP */
    HANDSHAKE_ATTEMPTS = 3
};

static struct robot_line line = {.fd = -1};
static char device[80]; /* of the open line; "" for TCP */
static struct request unconfirmed[2]; /* ct and conf_ls without a reply: the robot may or may not have received them */

/* Return the entry for a request that changes the layout of states; NULL for other requests. */
static struct request *unconfirmed_slot(const struct request *request)
{
    if (request->command == &nomad_commands[CMD_CT])
        return &unconfirmed[0];
    return request->command == &nomad_commands[CMD_CONF_LS] ? &unconfirmed[1] : NULL;
}

/* Exchange a request that changes the layout of states, and remember it until the robot has replied. */
static enum outcome exchange_layout(const struct request *request, struct reply *reply)
{
    struct wire_state before = line.wire;
    struct request *slot = unconfirmed_slot(request), sent = *request;
    enum outcome outcome;

    nomad_update_serial_state(&sent, &line.wire);
    outcome = nomad_serial_transact(&line, &sent, reply);
    if (outcome == NOT_ACKNOWLEDGED)
        line.wire = before;
    if (outcome == NO_REPLY)
        *slot = sent;
    else
        slot->command = NULL;
    return outcome;
}

/* Send unconfirmed layout requests again before any other command. Return 0 if one still has no reply. */
static int confirm_layout(const struct request *request, struct reply *reply)
{
    for (int k = 0; k < 2; k++)
        if (line.fd >= 0 && unconfirmed[k].command && unconfirmed_slot(request) != &unconfirmed[k]
            && exchange_layout(&unconfirmed[k], reply) == NO_REPLY) {
            nomad_report_error("%s: not sent, because the earlier %s has no reply", request->command->name,
                               unconfirmed[k].command ? unconfirmed[k].command->name : "a command");
            return 0;
        }
    return line.fd >= 0;
}

static int report_unavailable(const struct command *command)
{
    static const char *const NAMES[] = {"N200", "N150", "Scout"};

    if (command->line_type < 0)
        nomad_report_error("%s: available only with an Nserver", command->name);
    else if (!(command->models >> line.wire.model & 1))
        nomad_report_error("%s: not available on the serial line of model %s", command->name, NAMES[line.wire.model]);
    else
        return 0;
    return 1;
}

static enum outcome transact_checked(const struct request *request, struct reply *reply)
{
    if (report_unavailable(request->command) || !confirm_layout(request, reply))
        return NO_REPLY;
    return unconfirmed_slot(request) ? exchange_layout(request, reply) : nomad_serial_transact(&line, request, reply);
}

static enum outcome place_robot_in_two_steps(const struct request *request, struct reply *reply)
{
    struct request step = *request;
    enum outcome outcome;

    step.command = &nomad_commands[CMD_DP];
    step.count = 2;
    outcome = transact_checked(&step, reply);
    if (outcome != REPLIED)
        return outcome;
    step.command = &nomad_commands[CMD_DA];
    memcpy(step.args, request->args + 2, 2 * sizeof *step.args);
    return transact_checked(&step, reply);
}

enum outcome nomad_transact(const struct request *request, struct reply *reply)
{
    if (request->command == &nomad_commands[CMD_PLACE_ROBOT])
        return place_robot_in_two_steps(request, reply);
    return transact_checked(request, reply);
}

/* Connecting */

/* Handshake: bytes 0-4 of the mask | bit 0: compass | bit 0: laser, bits 1-5: position data | laser mode | 3 unused */
static int read_handshake(void)
{
    unsigned char handshake[HANDSHAKE_SIZE];
    milliseconds deadline = nomad_now() + HANDSHAKE_MS;

    for (size_t held = 0; held < sizeof handshake;) {
        long got = nomad_receive(line.fd, handshake + held, sizeof handshake - held, deadline);
        if (got <= 0) {
            nomad_report_error("connect_robot: the %d handshake bytes of an N200 did not arrive; is the robot of this "
                               "model?",
                               HANDSHAKE_SIZE);
            return 0;
        }
        held += (size_t)got;
    }
    for (int k = 0; k < 40; k++)
        line.wire.mask[1 + k] = handshake[k / 8] >> k % 8 & 1;
    line.wire.mask[41] = 1;
    line.wire.mask[SMASK_COMPASS] = handshake[5] & 1;
    line.wire.mask[SMASK_LASER] = handshake[6] & 1;
    line.wire.mask[SMASK_POS_DATA] = handshake[6] >> 1 & POS_ALL;
    line.wire.laser_mode = handshake[7];
    line.wire.laser_width = nomad_serial_laser_width(handshake[7]);
    nomad_reset_client_state(line.wire.mask);
    return 1;
}

static int perform_handshake(const struct serial_config *config)
{
    if (config->model != MODEL_N200)
        return 1; /* the mask of the other models is fixed and never sent */
    if (!config->is_device)
        return read_handshake();
    for (int k = 0; k < HANDSHAKE_ATTEMPTS && line.fd >= 0; k++)
        if (ct())
            return 1;
    return 0;
}

static void begin(const struct serial_config *config)
{
    const int *mask = config->model == MODEL_N200 ? nomad_full_mask : nomad_fixed_mask;

    line.wire.model = config->model;
    memcpy(line.wire.mask, mask, sizeof line.wire.mask);
    line.wire.laser_mode = DEFAULT_LASER_MODE;
    line.wire.laser_width = PIXELS;
    line.frames.held = 0;
    memset(line.pending, 0, sizeof line.pending);
    unconfirmed[0].command = unconfirmed[1].command = NULL;
    nomad_reset_client_state(mask);
}

/* Return 1 if the connection is to the device that is open already, which is locked and must be closed first. */
static int is_open_device(const struct serial_config *config)
{
    return line.fd >= 0 && config->is_device && strcmp(config->name, device) == 0;
}

static int open_line(const struct serial_config *config)
{
    int previous = line.fd, opened;

    if (config->model < 0 || config->model > MODEL_SCOUT) {
        nomad_report_error("connect_robot: the model number must be 0 (N200), 1 (N150) or 2 (Scout), not %d",
                           config->model);
        return FALSE;
    }
    if (is_open_device(config))
        nomad_close(&line.fd);
    opened = config->is_device ? nomad_open_serial(config->name, config->number)
                               : nomad_open_tcp(config->name, config->number, nomad_reply_timeout(OPEN_MS), 1);
    if (opened < 0) {
        nomad_set_error_code(NO_SERVER);
        return FALSE;
    }
    if (line.fd >= 0)
        nomad_close(&previous);
    line.fd = opened;
    snprintf(device, sizeof device, "%s", config->is_device ? config->name : "");
    begin(config);
    if (perform_handshake(config) && (!config->tm_s || conf_tm((unsigned char)config->tm_s))) {
        nomad_set_error_code(0);
        nomad_store_config(config);
        return TRUE;
    }
    nomad_close(&line.fd);
    return FALSE;
}

int nomad_connect(enum command_id how, long robot_id, const struct line_arguments *given)
{
    struct serial_config config;

    (void)robot_id;
    if (how != CMD_CONNECT_ROBOT)
        return TRUE; /* create_robot has no effect */
    return nomad_config_from_arguments(&config, given) && open_line(&config);
}

int nomad_open_line(const struct line_arguments *given) { return nomad_open_session(CMD_CONNECT_ROBOT, 1, given); }

int nomad_disconnect(long robot_id)
{
    (void)robot_id;
    if (!nomad_is_connected())
        return FALSE;
    nomad_close(&line.fd);
    return TRUE;
}

int nomad_is_connected(void) { return line.fd >= 0; }

/* Calls for a simulation, which programs make before they drive a real robot as well. */
int nomad_is_ignored(const struct command *command)
{
    static const enum command_id IGNORED[] = {CMD_REAL_ROBOT,   CMD_SIMULATED_ROBOT, CMD_PREDICT_SENSORS,
                                              CMD_ADD_OBSTACLE, CMD_NEW_WORLD,       CMD_GET_ROBOT_CONF};

    for (size_t k = 0; k < sizeof IGNORED / sizeof *IGNORED; k++)
        if (command == &nomad_commands[IGNORED[k]])
            return 1;
    return 0;
}

int nomad_sends_mask(void) { return !nomad_is_connected() || line.wire.model == MODEL_N200; }
