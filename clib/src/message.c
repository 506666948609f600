/* Masks and replies: the functions that both codecs share. */
#include "message.h"

#include <string.h>

void nomad_put_mask(const int mask[NUM_MASK], unsigned char bytes[5])
{
    memset(bytes, 0, 5);
    for (int k = 0; k < 40; k++)
        if (mask[1 + k])
            bytes[k / 8] |= (unsigned char)(1u << k % 8);
}

void nomad_reset_reply(struct reply *reply, enum shape shape)
{
    memset(reply, 0, sizeof *reply);
    reply->shape = shape;
}

void nomad_set_slot(struct reply *reply, int slot, long value)
{
    reply->slots[slot] = value;
    reply->has_slot[slot] = 1;
}

int nomad_begin_laser(struct reply *reply, long readings)
{
    reply->laser_size = 1;
    return readings >= 0 && readings <= NUM_LASER;
}

void nomad_add_to_laser(struct reply *reply, long number)
{
    if (reply->laser_size < 2 * NUM_LASER + 1)
        reply->laser[reply->laser_size++] = (int)number;
}

/* Omit lines that do not fit into Laser; the count gives the lines stored. */
void nomad_end_laser(struct reply *reply, long readings, int width)
{
    long room = 2 * NUM_LASER / width;

    if (readings > room)
        reply->laser_size = 1 + (int)room * width;
    reply->laser[0] = (int)(readings < room ? readings : room);
}
