/* Where a robot's own line is: as the arguments of connect_robot say, else NOMAD_ROBOT, else the globals. */
#ifndef NOMAD_LINE_PLACE_H
#define NOMAD_LINE_PLACE_H

#include <stdarg.h>

struct place {
    int is_port;   /* a serial port, else a host */
    char name[80];
    int number;    /* baud, or TCP port */
    int model;
};

/* 1, or 0 and a complaint. `known`: whether the end of the arguments can be told. */
int nomad_place_from_arguments(struct place *to, va_list *more, int known);
int nomad_place_from_outside(struct place *to);

#endif
