/* NOMAD_ROBOT, the address that the Python programs of this project take too:
 *
 *     nserver://host[:port][/id]       serial:///dev/ttyUSB0?model=n150&baud=38400     robotd://host[:port]?model=n200
 *
 * tm_s=5 in any of them: connecting says conf_tm 5.
 *
 * It tells a program that names no machine where its robot is. The number of the robot is the program's own: where the
 * address says one, it has to be the same.
 */
#ifndef NOMAD_ADDRESS_H
#define NOMAD_ADDRESS_H

struct address {
    char scheme[16];
    char place[80]; /* host, with its port where given; or a device */
    long robot;     /* of a nserver://; 0: not said */
    int model;      /* -1: not said */
    int baud;       /* 0: not said */
    int tm_s;       /* conf_tm: 2 to 255, 0 for never; -1: not said */
};

/* 1; 0 where the variable is not set; -1 and a complaint where it makes no sense. */
int nomad_address(struct address *address);

#endif
