/* Encodes requests and decodes replies in the TCP protocol of an Nserver.
 *
 *     int16 type | uint16 count | count x int32        high byte first; count is in words
 *
 * There is no I/O and no clock here. The layout of a reply follows from its request and the wire state: the type in the
 * header only marks errors. server.c reads the header.
 */
#include "message.h"

#include <string.h>

enum { FIRST_VELOCITY = 38, FIRST_POSE = 34, LAST_SLOT = 44 };

/* Requests */

static void put_mask(struct writer *to, const int mask[NUM_MASK])
{
    unsigned char bytes[5];
    int position = mask[SMASK_POS_DATA];

    nomad_put_mask(mask, bytes);
    for (int k = 0; k < 5; k++)
        nomad_put_word(to, bytes[k]);
    nomad_put_word(to, (position != 0) | (mask[41] != 0) << 1 | (mask[42] != 0) << 2 | (mask[43] != 0) << 3);
    nomad_put_word(to, position);
}

/* Four characters make a word, the first in the lowest byte: every group of four appears reversed on the wire. */
static void put_text(struct writer *to, const char *text)
{
    size_t length = strlen(text), words = (length + 4) / 4;

    if (length > MAX_TEXT)
        to->failed = 1;
    for (size_t k = 0; k < words && !to->failed; k++) {
        uint32_t word = 0;
        for (size_t i = 4 * k; i < 4 * k + 4 && i < length; i++)
            word |= (uint32_t)(unsigned char)text[i] << 8 * (i - 4 * k);
        nomad_put_word(to, nomad_signed_word(word));
    }
}

static void put_arguments(struct writer *to, const struct request *request)
{
    const char *letters = request->command->tcp_args;

    if (*letters == 'M')
        put_mask(to, request->mask);
    else if (*letters == 'T')
        put_text(to, request->text);
    else if (*letters == 'P')
        for (size_t k = 0; k < request->packet_size; k++)
            nomad_put_word(to, request->packet[k]);
    else
        for (int k = 0; k < request->count; k++)
            nomad_put_word(to, *letters != '*' && letters[k] == 'f' ? request->args[k] != 0 : request->args[k]);
}

size_t nomad_encode_tcp_request(const struct request *request, unsigned char *bytes, size_t size)
{
    struct writer to = nomad_writer(bytes, size), head;
    size_t used;

    nomad_put_word(&to, 0); /* filled in below */
    put_arguments(&to, request);
    if (to.failed)
        return 0;
    used = (size_t)(to.at - bytes);
    head = nomad_writer(bytes, 4);
    nomad_put_uint16_be(&head, (unsigned)request->command->tcp_type);
    nomad_put_uint16_be(&head, (unsigned)(used / 4 - 1));
    return used;
}

/* Wire state: settings that determine the layout of replies */

int nomad_tcp_laser_width(int mode)
{
    if (mode == 1 || mode == 33)
        return LINES;
    return mode == 51 || mode == 50 || mode == 19 ? POINTS : PIXELS;
}

static int get_ls_width(const struct wire_state *wire)
{
    int width = nomad_tcp_laser_width(wire->laser_mode);
    return width == LINES ? POINTS : width;
}

/* The layout of the last laser query stays in force until the next conf_ls: old clients and servers both do so. */
void nomad_update_tcp_state(const struct request *request, struct wire_state *wire)
{
    switch (request->command - nomad_commands) {
    case CMD_CT: memcpy(wire->mask, request->mask, sizeof wire->mask); break;
    case CMD_CONF_LS:
        wire->laser_mode = (int)request->args[0];
        wire->laser_width = nomad_tcp_laser_width(wire->laser_mode);
        break;
    case CMD_GET_SG: wire->laser_width = LINES; break;
    case CMD_GET_LS:
        if (nomad_tcp_laser_width(wire->laser_mode) == LINES)
            wire->laser_width = POINTS;
        break;
    default: break;
    }
}

/* Replies */

static void read_slots(struct reader *from, struct reply *reply, int first, int count)
{
    for (int k = 0; k < count; k++)
        nomad_set_slot(reply, first + k, nomad_get_word(from));
}

static void read_stamps(struct reader *from, struct reply *reply, int wanted, int first, int count)
{
    if (!wanted)
        return;
    for (int k = first; k < first + count; k++) {
        PosData *at = &reply->stamps[k];
        at->config.configX = nomad_get_word(from);
        at->config.configY = nomad_get_word(from);
        at->config.configSteer = nomad_get_word(from);
        at->config.configTurret = nomad_get_word(from);
        at->config.velTrans = nomad_get_word(from);
        at->config.velSteer = nomad_get_word(from);
        at->config.velTurret = nomad_get_word(from);
        at->config.timeStamp = nomad_get_unsigned_word(from);
        at->timeStamp = nomad_get_unsigned_word(from);
        reply->has_stamp[k] = 1;
    }
}

static void read_laser(struct reader *from, struct reply *reply, int width)
{
    long readings = nomad_get_word(from);

    if (!nomad_begin_laser(reply, readings)) {
        from->failed = 1;
        return;
    }
    for (long k = 0; k < readings * width && !from->failed; k++)
        nomad_add_to_laser(reply, nomad_get_word(from));
    nomad_end_laser(reply, readings, width);
}

static void read_clock(struct reader *from, struct reply *reply)
{
    reply->clock_ms = nomad_get_unsigned_word(from);
    reply->has_clock = 1;
}

static void read_state(struct reader *from, struct reply *reply, const struct wire_state *wire)
{
    int position = wire->mask[SMASK_POS_DATA];

    read_slots(from, reply, 0, LAST_SLOT + 1);
    read_laser(from, reply, wire->laser_width);
    read_stamps(from, reply, position & POS_INFRARED, 0, 16);
    read_stamps(from, reply, position & POS_SONAR, STAMP_SONAR, 16);
    read_stamps(from, reply, position & POS_BUMPER, STAMP_BUMPER, 1);
    read_stamps(from, reply, position & POS_LASER, STAMP_LASER, 1);
    read_stamps(from, reply, position & POS_COMPASS, STAMP_COMPASS, 1);
    read_clock(from, reply);
    reply->volts[0] = (int)(nomad_get_unsigned_word(from) & 0xFF);
    reply->volts[1] = (int)(nomad_get_unsigned_word(from) & 0xFF);
    reply->has_volts = 1;
    nomad_set_slot(reply, STATE_ERROR, 0); /* a state reply means no error, whatever its last word is */
}

static void read_sensor(struct reader *from, struct reply *reply, const struct wire_state *wire, int first, int count,
                       int bit, int stamp)
{
    read_slots(from, reply, first, count);
    read_stamps(from, reply, wire->mask[SMASK_POS_DATA] & bit, stamp, count);
    read_clock(from, reply);
}

static void read_laser_reply(struct reader *from, struct reply *reply, const struct wire_state *wire, int width)
{
    read_laser(from, reply, width);
    read_stamps(from, reply, wire->mask[SMASK_POS_DATA] & POS_LASER, STAMP_LASER, 1);
    read_clock(from, reply);
}

static void read_values(struct reader *from, struct reply *reply, size_t min, size_t max)
{
    size_t count = nomad_remaining(from) / 4;

    if (count < min || count > max || count > MAX_VALUES)
        from->failed = 1;
    while (!from->failed && reply->count < (int)count)
        reply->values[reply->count++] = nomad_get_word(from);
}

static void read_reply(struct reader *from, struct reply *reply, const struct wire_state *wire)
{
    switch (reply->shape) {
    case SHAPE_STATE: read_state(from, reply, wire); break;
    case SHAPE_INFRARED: read_sensor(from, reply, wire, STATE_IR_0, 16, POS_INFRARED, 0); break;
    case SHAPE_SONAR: read_sensor(from, reply, wire, STATE_SONAR_0, 16, POS_SONAR, STAMP_SONAR); break;
    case SHAPE_BUMPER: read_sensor(from, reply, wire, STATE_BUMPER, 1, POS_BUMPER, STAMP_BUMPER); break;
    case SHAPE_COMPASS: read_sensor(from, reply, wire, STATE_COMPASS, 1, POS_COMPASS, STAMP_COMPASS); break;
    case SHAPE_LASER: read_laser_reply(from, reply, wire, get_ls_width(wire)); break;
    case SHAPE_SEGMENTS: read_laser_reply(from, reply, wire, LINES); break;
    case SHAPE_POSE: read_slots(from, reply, FIRST_POSE, 4); break;
    case SHAPE_VELOCITY: read_slots(from, reply, FIRST_VELOCITY, 3); break;
    case SHAPE_PREDICTION:
        while (!from->failed && reply->count < STATE_ERROR)
            reply->values[reply->count++] = nomad_get_word(from);
        read_laser(from, reply, wire->laser_width);
        break;
    case SHAPE_SIMPLE: read_values(from, reply, 1, 1); break;
    case SHAPE_LIST: read_values(from, reply, 1, MAX_VALUES); break;
    case SHAPE_COLLISION:
    case SHAPE_CLICKED:
    case SHAPE_CONTROL: read_values(from, reply, 4, 4); break;
    case SHAPE_TRUTH: read_values(from, reply, 8, 8); break;
    case SHAPE_SPECIAL: read_values(from, reply, PACKET_HEAD, MAX_PACKET); break;
    case SHAPE_CALIBRATION:
    case SHAPE_NOTHING: break;
    }
}

int nomad_decode_tcp_reply(enum shape shape, const unsigned char *bytes, size_t size, const struct wire_state *wire,
                           struct reply *reply)
{
    struct reader from = nomad_reader(bytes, size);

    nomad_reset_reply(reply, shape);
    read_reply(&from, reply, wire);
    return !from.failed && nomad_remaining(&from) == 0;
}
