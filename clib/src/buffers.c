/* Stores numbers in user packets byte by byte, and reads them: low byte first, two's complement. */
#include "Nclient.h"

#include <stdint.h>
#include <string.h>

enum { HEADER_SIZE = 4 };

static int put(uint64_t number, int count, unsigned char *buffer, unsigned short *index)
{
    if (*index + count > MAX_USER_BUF)
        return FALSE;
    for (int k = 0; k < count; k++)
        buffer[(*index)++] = (unsigned char)(number >> 8 * k);
    return TRUE;
}

static uint64_t get(int count, const unsigned char *buffer, unsigned short *index)
{
    uint64_t number = 0;

    if (*index + count > MAX_USER_BUF)
        return 0;
    for (int k = 0; k < count; k++)
        number |= (uint64_t)buffer[(*index)++] << 8 * k;
    return number;
}

/* Convert `count` bytes in two's complement. */
static long to_signed(uint64_t number, int count)
{
    uint64_t sign = (uint64_t)1 << (8 * count - 1);
    return (long)((int64_t)(number ^ sign) - (int64_t)sign);
}

int init_send_buffer(unsigned short *index)
{
    *index = HEADER_SIZE;
    return TRUE;
}

int init_receive_buffer(unsigned short *index) { return init_send_buffer(index); }

int stuff_send_buffer_header(unsigned short length, unsigned char serial_number, unsigned char packet_type,
                             unsigned char *buffer)
{
    unsigned short index = 0;

    return put(length, 2, buffer, &index) && put(serial_number, 1, buffer, &index)
           && put(packet_type, 1, buffer, &index);
}

int extract_receive_buffer_header(unsigned short *length, unsigned char *serial_number, unsigned char *packet_type,
                                  unsigned char *buffer)
{
    unsigned short index = 0;

    *length = (unsigned short)get(2, buffer, &index);
    *serial_number = (unsigned char)get(1, buffer, &index);
    *packet_type = (unsigned char)get(1, buffer, &index);
    return TRUE;
}

int stuffchar(signed char data, unsigned char *buffer, unsigned short *index)
{
    return put((uint64_t)data, 1, buffer, index);
}

int stuff2byteint(short data, unsigned char *buffer, unsigned short *index)
{
    return put((uint64_t)data, 2, buffer, index);
}

int stuff4byteint(long data, unsigned char *buffer, unsigned short *index)
{
    return put((uint64_t)data, 4, buffer, index);
}

int stuffuchar(unsigned char data, unsigned char *buffer, unsigned short *index) { return put(data, 1, buffer, index); }

int stuff2byteuint(unsigned short data, unsigned char *buffer, unsigned short *index)
{
    return put(data, 2, buffer, index);
}

int stuff4byteuint(unsigned long data, unsigned char *buffer, unsigned short *index)
{
    return put(data, 4, buffer, index);
}

int stuffdouble(double data, unsigned char *buffer, unsigned short *index)
{
    uint64_t bits;

    memcpy(&bits, &data, sizeof bits);
    return put(bits, 8, buffer, index);
}

signed char extractchar(unsigned char *buffer, unsigned short *index)
{
    return (signed char)to_signed(get(1, buffer, index), 1);
}

short extract2byteint(unsigned char *buffer, unsigned short *index)
{
    return (short)to_signed(get(2, buffer, index), 2);
}

long extract4byteint(unsigned char *buffer, unsigned short *index) { return to_signed(get(4, buffer, index), 4); }

unsigned char extractuchar(unsigned char *buffer, unsigned short *index)
{
    return (unsigned char)get(1, buffer, index);
}

unsigned short extract2byteuint(unsigned char *buffer, unsigned short *index)
{
    return (unsigned short)get(2, buffer, index);
}

unsigned long extract4byteuint(unsigned char *buffer, unsigned short *index)
{
    return (unsigned long)get(4, buffer, index);
}

double extractdouble(unsigned char *buffer, unsigned short *index)
{
    uint64_t bits = get(8, buffer, index);
    double data;

    memcpy(&data, &bits, sizeof data);
    return data;
}
