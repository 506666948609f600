/* What goes between a program's call and the robot: a request, the terms both ends have agreed, and a reply.
 *
 *     call -> struct request -> bytes ... bytes -> struct reply -> State, Laser, the caller's buffers
 *
 * Rules: bytes are made and read by tcp_language.c and line_language.c, without a socket or a clock. A reply is read
 * whole or not at all: what does not fit to its last byte changes nothing that the program sees.
 */
#ifndef NOMAD_MESSAGE_H
#define NOMAD_MESSAGE_H

#include "Nclient.h"
#include "table.h"
#include "wire.h"

enum {
    MAX_VERTICES = 10,
    MAX_ROBOTS = 10,
    MAX_ARGS = 24,
    MAX_TEXT = 255,
    PACKET_HEAD = 4,
    MAX_PACKET = 254,
    MAX_VALUES = 1024,
    STAMPS = 35,           /* 16 infrared, 16 sonar, bumper, laser, compass */
    STAMP_SONAR = 16,
    STAMP_BUMPER = 32,
    STAMP_LASER = 33,
    STAMP_COMPASS = 34,
    POINTS = 2,            /* numbers of a laser reading, by its kind */
    LINES = 4,
    PIXELS = 1,
    DEFAULT_LASER_MODE = 51
};

struct request {
    const struct command *command;
    long args[MAX_ARGS];
    int count;
    const char *text;             /* T */
    const unsigned char *packet;  /* P */
    size_t packet_size;
    int mask[NUM_MASK];           /* M */
};

/* What shapes the replies of a conversation. */
struct terms {
    int model;
    int mask[NUM_MASK];
    int laser_mode;
    int laser_width; /* numbers a reading in a state reply */
};

struct reply {
    enum shape shape;
    long slots[NUM_STATE];
    unsigned char has_slot[NUM_STATE];
    int laser[2 * NUM_LASER + 1];
    int laser_size;                    /* numbers in it; 0: the reply has none */
    PosData stamps[STAMPS];
    unsigned char has_stamp[STAMPS];
    int has_clock, has_volts;
    uint32_t clock_ms;
    int volts[2];                      /* raw bytes: CPU, motors */
    long values[MAX_VALUES];
    int count;
};

/* Bytes of a request; 0 where it cannot be said. */
size_t nomad_tcp_request(const struct request *request, unsigned char *bytes, size_t size);
size_t nomad_line_request(const struct request *request, unsigned char *bytes, size_t size);

/* A reply out of its bytes, without head and checksum; 0 where it is none of this shape. */
int nomad_read_tcp_reply(enum shape shape, const unsigned char *bytes, size_t size, const struct terms *terms,
                         struct reply *reply);
int nomad_read_line_reply(enum shape shape, const unsigned char *bytes, size_t size, const struct terms *terms,
                          struct reply *reply);

/* What a request changes for the replies that follow it. */
void nomad_note_on_tcp(const struct request *request, struct terms *terms);
void nomad_note_on_line(const struct request *request, struct terms *terms);
int nomad_tcp_laser_width(int mode);
int nomad_line_laser_width(int mode);

/* The mask in bytes: b0 .. b4 hold Smask[1..40], lowest bit first. */
void nomad_put_mask(const int mask[NUM_MASK], unsigned char bytes[5]);

/* For both readers. */
void nomad_begin(struct reply *reply, enum shape shape);
void nomad_set_slot(struct reply *reply, int slot, long value);
int nomad_begin_laser(struct reply *reply, long readings); /* 0: no laser sends so many */
void nomad_add_to_laser(struct reply *reply, long number);
void nomad_end_laser(struct reply *reply, long readings, int width);

#endif
