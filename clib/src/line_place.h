/* Where a robot's own line is: as the arguments of connect_robot say, else NOMAD_ROBOT, else the globals.
 *
 * A line that NOMAD_ROBOT names is given conf_tm, so that a robot whose program is gone stops. Where the program names
 * it, what is said is what the old library says: nothing.
 */
#ifndef NOMAD_LINE_PLACE_H
#define NOMAD_LINE_PLACE_H

#include <stdarg.h>

struct place {
    int is_port;   /* a serial port, else a host */
    char name[80];
    int number;    /* baud, or TCP port */
    int model;
    int tm_s;      /* what connecting says of conf_tm; 0: nothing */
};

/* 1, or 0 and a complaint. `known`: whether the end of the arguments can be told. */
int nomad_place_from_arguments(struct place *to, va_list *more, int known);
int nomad_place_from_outside(struct place *to);

#endif
