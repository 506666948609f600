/* The connection to a robot's own line: from the arguments of connect_robot, else NOMAD_ROBOT, else the globals.
 *
 * A connection from NOMAD_ROBOT sends conf_tm, so that the robot stops if its program ends. A connection that the
 * program names itself does not, for compatibility with the old library.
 */
#ifndef NOMAD_SERIAL_CONFIG_H
#define NOMAD_SERIAL_CONFIG_H

#include <stdarg.h>

struct serial_config {
    int is_device; /* a serial device; otherwise a TCP host */
    char name[80];
    int number; /* baud, or TCP port */
    int model;
    int tm_s; /* sent as conf_tm after connecting; 0: not sent */
};

/* Return 1, or 0 after reporting an error. `has_end_marker` is set if the arguments end with NOMAD_NO_MORE. */
int nomad_config_from_arguments(struct serial_config *to, va_list *extra, int has_end_marker);
int nomad_default_config(struct serial_config *to);

#endif
