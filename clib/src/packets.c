/* Speech, user packets and the arm. A packet: length (2 bytes, low byte first, including the header) | serial | type |
 * data */
#include "error.h"
#include "session.h"

#include <string.h>

enum { MAX_ARM_PACKET = 32, RESULT = 4, RESULT_AND_REST = 8 };

int tk(char *talk)
{
    struct request request = {0};

    if (strlen(talk) > MAX_TEXT) {
        nomad_report_error("tk: the text may have at most %d characters", MAX_TEXT);
        return FALSE;
    }
    request.command = &nomad_commands[CMD_TK];
    request.text = talk;
    return nomad_request(&request) != NULL;
}

static const struct reply *send_packet(enum command_id id, const unsigned char *packet, size_t size)
{
    struct request request = {0};

    request.command = &nomad_commands[id];
    request.packet = packet;
    request.packet_size = size;
    return nomad_request(&request);
}

int special_request(unsigned char *user_send_buffer, unsigned char *user_receive_buffer)
{
    unsigned char packet[MAX_PACKET];
    size_t size = user_send_buffer[0] | (size_t)user_send_buffer[1] << 8;
    const struct reply *reply;

    if (size < PACKET_HEAD || size > MAX_PACKET) {
        nomad_report_error("special_request: a packet must have %d to %d bytes, not %lu", PACKET_HEAD, MAX_PACKET,
                           (unsigned long)size);
        return FALSE;
    }
    memcpy(packet, user_send_buffer, size);
    packet[2] = 0; /* serial number: clients send 0 */
    reply = send_packet(CMD_SPECIAL_REQUEST, packet, size);
    for (int k = 0; reply && k < reply->count; k++)
        user_receive_buffer[k] = (unsigned char)reply->values[k];
    return reply != NULL;
}

/* Send an arm packet. Return its result, or 0 if it failed; `rest` receives the remaining time of a wait. */
static int arm(enum command_id id, const long *numbers, long *rest)
{
    const struct command *command = &nomad_commands[id];
    unsigned char packet[MAX_ARM_PACKET], data[RESULT_AND_REST] = {0};
    struct writer to = nomad_writer(packet, sizeof packet), head = nomad_writer(packet, 2);
    struct reader from = nomad_reader(data, sizeof data);
    const struct reply *reply;
    int result;

    nomad_put_unsigned(&to, 0);
    nomad_put_byte(&to, 0);
    nomad_put_byte(&to, command->packet_type);
    for (const char *letter = command->packet_data; *letter; letter++, numbers++) {
        if (*letter == 'u')
            nomad_put_unsigned(&to, *numbers);
        else
            nomad_put_four_bytes(&to, (uint32_t)*numbers);
    }
    nomad_put_unsigned(&head, to.at - packet);
    reply = send_packet(id, packet, (size_t)(to.at - packet));
    for (int k = 0; reply && k < RESULT_AND_REST && k + PACKET_HEAD < reply->count; k++)
        data[k] = (unsigned char)reply->values[k + PACKET_HEAD];
    result = (int)nomad_signed_word(nomad_get_bytes(&from, RESULT));
    if (rest)
        *rest = (long)nomad_get_bytes(&from, 4);
    return result;
}

int arm_zr(short override) { return arm(CMD_ARM_ZR, (const long[]){override}, NULL); }

int arm_ws(short lift, short grip, long timeout, long *time_remain)
{
    return arm(CMD_ARM_WS, (const long[]){lift, grip, timeout}, time_remain);
}

int arm_mv(long l_mode, long l_v, long g_mode, long g_v)
{
    return arm(CMD_ARM_MV, (const long[]){l_mode, l_v, g_mode, g_v}, NULL);
}
