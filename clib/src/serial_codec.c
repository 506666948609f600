/* Encodes requests and decodes replies in the serial protocol of a robot.
 *
 *     0x01 | length, 2 bytes low first | type | data ... | checksum | 0x5C
 *
 * length counts type, data and checksum; the checksum is the sum of all bytes before it, modulo 256. There is no I/O
 * and no clock here. serial_framing.c finds frames in the received bytes.
 */
#include "serial_framing.h"
#include "message.h"

#include <string.h>

/* Requests */

static void put_argument(struct writer *to, char letter, long number)
{
    switch (letter) {
    case 's': nomad_put_signed(to, number); break;
    case 'u': nomad_put_unsigned(to, number); break;
    case 'f': nomad_put_byte(to, number != 0); break;
    case 'h': nomad_put_byte(to, number > 10 ? 10 : number); break;
    case 'm': nomad_put_byte(to, number == 51 ? 35 : number); break;
    default: nomad_put_byte(to, number); break;
    }
}

static void put_mask(struct writer *to, const int mask[NUM_MASK])
{
    unsigned char bytes[5];

    nomad_put_mask(mask, bytes);
    for (int k = 0; k < 5; k++)
        nomad_put_byte(to, bytes[k]);
    nomad_put_byte(to, mask[SMASK_LASER] != 0);
    nomad_put_byte(to, (mask[SMASK_COMPASS] != 0) | mask[SMASK_POS_DATA] << 1);
}

static void put_data(struct writer *to, const struct request *request)
{
    const char *letters = request->command->line_args;

    if (*letters == 'M')
        put_mask(to, request->mask);
    else if (*letters == 'T')
        for (size_t k = 0; k <= strlen(request->text); k++) /* including the NUL */
            nomad_put_byte(to, (unsigned char)request->text[k]);
    else if (*letters == 'P')
        for (size_t k = 0; k < request->packet_size; k++)
            nomad_put_byte(to, request->packet[k]);
    else
        for (int k = 0; k < request->count; k++)
            put_argument(to, letters[k], request->args[k]);
}

size_t nomad_encode_serial_request(const struct request *request, unsigned char *bytes, size_t size)
{
    struct writer to = nomad_writer(bytes, size < MAX_HOST_FRAME ? size : MAX_HOST_FRAME), head;
    size_t used;

    nomad_put_four_bytes(&to, 0); /* filled in below */
    put_data(&to, request);
    if (to.failed || to.end - to.at < 2)
        return 0;
    used = (size_t)(to.at - bytes);
    head = nomad_writer(bytes, 4);
    nomad_put_byte(&head, FRAME_START);
    nomad_put_unsigned(&head, (long)used - 2);
    nomad_put_byte(&head, request->command->line_type);
    nomad_put_byte(&to, nomad_checksum(bytes, used));
    nomad_put_byte(&to, FRAME_END);
    return used + 2;
}

/* Wire state: settings that determine the layout of replies */

int nomad_serial_laser_width(int mode) { return (mode & 0x1E) == 0 ? LINES : PIXELS; }

void nomad_update_serial_state(const struct request *request, struct wire_state *wire)
{
    if (request->command == &nomad_commands[CMD_CT]) {
        memcpy(wire->mask, request->mask, sizeof wire->mask);
    } else if (request->command == &nomad_commands[CMD_CONF_LS]) {
        wire->laser_mode = (int)request->args[0];
        wire->laser_width = nomad_serial_laser_width(wire->laser_mode);
    }
}

/* Replies. `mask` selects the values present; NULL for the reply to a get_ request, which has all values of its sensor.
 */

static int is_there(const int *mask, int slot) { return mask == NULL || mask[slot]; }

static void read_nibbles(struct reader *from, struct reply *reply, const int *mask)
{
    int byte = 0, found = 0;

    for (int slot = STATE_IR_0; slot < STATE_IR_0 + 16; slot++) {
        if (!is_there(mask, slot))
            continue;
        if (found % 2 == 0)
            byte = nomad_get_byte(from);
        nomad_set_slot(reply, slot, found % 2 ? byte >> 4 : byte & 15);
        found++;
    }
}

static void read_sonars(struct reader *from, struct reply *reply, const int *mask)
{
    for (int slot = STATE_SONAR_0; slot < STATE_SONAR_0 + 16; slot++)
        if (is_there(mask, slot))
            nomad_set_slot(reply, slot, nomad_get_byte(from));
}

static void read_bumpers(struct reader *from, struct reply *reply, const int *mask, int model)
{
    if (is_there(mask, STATE_BUMPER)) {
        int b0 = nomad_get_byte(from), b1 = nomad_get_byte(from), b2 = nomad_get_byte(from);
        nomad_set_slot(reply, STATE_BUMPER, model == MODEL_SCOUT ? b0 | b1 << 8 | b2 << 16 : b2 | b1 << 8 | b0 << 16);
    }
}

static void read_signed(struct reader *from, struct reply *reply, const int *mask, int first, int last)
{
    for (int slot = first; slot <= last; slot++)
        if (is_there(mask, slot))
            nomad_set_slot(reply, slot, nomad_get_signed(from, 2));
}

static void read_stamp(struct reader *from, struct reply *reply, int which)
{
    PosData *at = &reply->stamps[which];

    at->config.configX = nomad_get_signed(from, 4);
    at->config.configY = nomad_get_signed(from, 4);
    at->config.configSteer = nomad_get_signed(from, 4);
    at->config.configTurret = nomad_get_signed(from, 4);
    at->config.velTrans = nomad_get_signed(from, 4);
    at->config.velSteer = nomad_get_signed(from, 4);
    at->config.velTurret = nomad_get_signed(from, 4);
    at->config.timeStamp = nomad_get_bytes(from, 4);
    at->timeStamp = nomad_get_bytes(from, 4);
    reply->has_stamp[which] = 1;
}

/* Read the stamps of `count` sensors whose first slot is `slot`, if `wanted`. */
static void read_stamps(struct reader *from, struct reply *reply, int wanted, int first, int count, int slot,
                       const int *mask)
{
    for (int k = 0; wanted && k < count; k++)
        if (is_there(mask, slot + k))
            read_stamp(from, reply, first + k);
}

static void read_laser(struct reader *from, struct reply *reply, int width)
{
    long readings = (long)nomad_get_bytes(from, 2);

    if (!nomad_begin_laser(reply, readings)) {
        from->failed = 1;
        return;
    }
    for (long k = 0; k < readings * width && !from->failed; k++)
        nomad_add_to_laser(reply, width == PIXELS ? (long)nomad_get_bytes(from, 2) : nomad_get_signed(from, 2));
    nomad_end_laser(reply, readings, width);
}

static void read_clock(struct reader *from, struct reply *reply)
{
    reply->clock_ms = nomad_get_bytes(from, 4);
    reply->has_clock = 1;
}

static void read_state(struct reader *from, struct reply *reply, const struct wire_state *wire)
{
    const int *mask = wire->mask;
    int position = mask[SMASK_POS_DATA];

    read_nibbles(from, reply, mask);
    read_stamps(from, reply, position & POS_INFRARED, 0, 16, STATE_IR_0, mask);
    read_sonars(from, reply, mask);
    read_stamps(from, reply, position & POS_SONAR, STAMP_SONAR, 16, STATE_SONAR_0, mask);
    read_bumpers(from, reply, mask, wire->model);
    read_stamps(from, reply, position & POS_BUMPER, STAMP_BUMPER, 1, STATE_BUMPER, mask);
    read_signed(from, reply, mask, STATE_CONF_X, STATE_VEL_TURRET);
    read_signed(from, reply, mask, STATE_COMPASS, STATE_COMPASS);
    read_stamps(from, reply, position & POS_COMPASS, STAMP_COMPASS, 1, STATE_COMPASS, mask);
    if (mask[SMASK_LASER])
        read_laser(from, reply, wire->laser_width);
    read_stamps(from, reply, position & POS_LASER, STAMP_LASER, 1, STATE_LASER, mask);
    nomad_set_slot(reply, STATE_MOTOR_STATUS, nomad_get_byte(from));
    read_clock(from, reply);
    reply->volts[0] = nomad_get_byte(from);
    reply->volts[1] = nomad_get_byte(from);
    reply->has_volts = 1;
}

static void read_values(struct reader *from, struct reply *reply, size_t min, size_t max)
{
    size_t count = nomad_remaining(from);

    if (count < min || count > max || count > MAX_VALUES)
        from->failed = 1;
    while (!from->failed && reply->count < (int)count)
        reply->values[reply->count++] = nomad_get_byte(from);
}

static void read_reply(struct reader *from, struct reply *reply, const struct wire_state *wire)
{
    int position = wire->mask[SMASK_POS_DATA];

    switch (reply->shape) {
    case SHAPE_STATE: read_state(from, reply, wire); return;
    case SHAPE_INFRARED:
        read_nibbles(from, reply, NULL);
        read_stamps(from, reply, position & POS_INFRARED, 0, 16, 0, NULL);
        break;
    case SHAPE_SONAR:
        read_sonars(from, reply, NULL);
        read_stamps(from, reply, position & POS_SONAR, STAMP_SONAR, 16, 0, NULL);
        break;
    case SHAPE_BUMPER:
        read_bumpers(from, reply, NULL, wire->model);
        read_stamps(from, reply, position & POS_BUMPER, STAMP_BUMPER, 1, 0, NULL);
        break;
    case SHAPE_COMPASS:
        nomad_set_slot(reply, STATE_COMPASS, (long)nomad_get_bytes(from, 2));
        read_stamps(from, reply, position & POS_COMPASS, STAMP_COMPASS, 1, 0, NULL);
        break;
    case SHAPE_LASER:
    case SHAPE_SEGMENTS:
        read_laser(from, reply, reply->shape == SHAPE_SEGMENTS ? LINES : PIXELS);
        read_stamps(from, reply, position & POS_LASER, STAMP_LASER, 1, 0, NULL);
        break;
    case SHAPE_POSE: read_signed(from, reply, NULL, STATE_CONF_X, STATE_CONF_TURRET); return;
    case SHAPE_VELOCITY: read_signed(from, reply, NULL, STATE_VEL_TRANS, STATE_VEL_TURRET); return;
    case SHAPE_CALIBRATION: read_values(from, reply, 3, 3); return;
    case SHAPE_SPECIAL: read_values(from, reply, PACKET_HEAD, MAX_PACKET); return;
    default: return; /* get_ra has no reply data */
    }
    read_clock(from, reply);
}

int nomad_decode_serial_reply(enum shape shape, const unsigned char *bytes, size_t size, const struct wire_state *wire,
                              struct reply *reply)
{
    struct reader from = nomad_reader(bytes, size);

    nomad_reset_reply(reply, shape);
    read_reply(&from, reply, wire);
    return !from.failed && nomad_remaining(&from) == 0;
}
