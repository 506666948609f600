/* Requests, replies, and the wire state that determines the layout of replies.
 *
 *     call -> struct request -> bytes ... bytes -> struct reply -> State, Laser, the caller's buffers
 *
 * tcp_codec.c and serial_codec.c encode and decode the bytes, without sockets or clocks. A reply is decoded completely
 * or not at all: bytes that do not fit exactly change nothing that the program sees.
 */
#ifndef NOMAD_MESSAGE_H
#define NOMAD_MESSAGE_H

#include "Nclient.h"
#include "table.h"
#include "wire.h"

enum {
    MAX_ROBOTS = 10,
    MAX_ARGS = 24,
    MAX_TEXT = 255,
    PACKET_HEAD = 4,
    MAX_PACKET = 254,
    MAX_VALUES = 1024,
    STAMPS = 35, /* 16 infrared, 16 sonar, bumper, laser, compass */
    STAMP_SONAR = 16,
    STAMP_BUMPER = 32,
    STAMP_LASER = 33,
    STAMP_COMPASS = 34,
    POINTS = 2, /* numbers per laser reading, by kind of reading */
    LINES = 4,
    PIXELS = 1,
    DEFAULT_LASER_MODE = 51
};

struct request {
    const struct command *command;
    long args[MAX_ARGS];
    int count;
    const char *text;            /* T */
    const unsigned char *packet; /* P */
    size_t packet_size;
    int mask[NUM_MASK]; /* M */
};

/* Settings that determine the layout of the replies of a session. */
struct wire_state {
    int model;
    int mask[NUM_MASK];
    int laser_mode;
    int laser_width; /* numbers per laser reading in a state reply */
};

struct reply {
    enum shape shape;
    long slots[NUM_STATE];
    unsigned char has_slot[NUM_STATE];
    int laser[2 * NUM_LASER + 1];
    int laser_size; /* numbers in `laser`; 0: the reply has no laser data */
    PosData stamps[STAMPS];
    unsigned char has_stamp[STAMPS];
    int has_clock, has_volts;
    uint32_t clock_ms;
    int volts[2]; /* raw bytes: CPU, motors */
    long values[MAX_VALUES];
    int count;
};

/* Encode a request. Return its size in bytes, or 0 if it does not fit into a message. */
size_t nomad_encode_tcp_request(const struct request *request, unsigned char *bytes, size_t size);
size_t nomad_encode_serial_request(const struct request *request, unsigned char *bytes, size_t size);

/* Decode a reply from its data, without header and checksum. Return 0 if it does not have this shape. */
int nomad_decode_tcp_reply(enum shape shape, const unsigned char *bytes, size_t size, const struct wire_state *wire,
                           struct reply *reply);
int nomad_decode_serial_reply(enum shape shape, const unsigned char *bytes, size_t size, const struct wire_state *wire,
                              struct reply *reply);

/* Apply the changes that a request makes to the layout of later replies. */
void nomad_update_tcp_state(const struct request *request, struct wire_state *wire);
void nomad_update_serial_state(const struct request *request, struct wire_state *wire);
int nomad_tcp_laser_width(int mode);
int nomad_serial_laser_width(int mode);

/* Pack Smask[1..40] into five bytes, lowest bit first. */
void nomad_put_mask(const int mask[NUM_MASK], unsigned char bytes[5]);

/* Shared by both decoders. */
void nomad_reset_reply(struct reply *reply, enum shape shape);
void nomad_set_slot(struct reply *reply, int slot, long value);
int nomad_begin_laser(struct reply *reply, long readings); /* 0: more than a laser can send */
void nomad_add_to_laser(struct reply *reply, long number);
void nomad_end_laser(struct reply *reply, long readings, int width);

#endif
