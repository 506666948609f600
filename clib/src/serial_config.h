/* The connection to a robot's own line: from the arguments of connect_robot, else NOMAD_ROBOT, else the globals.
 *
 * A connection from NOMAD_ROBOT sends conf_tm, so that the robot stops if its program ends. A connection that the
 * program names itself does not, for compatibility with the old library.
 */
#ifndef NOMAD_SERIAL_CONFIG_H
#define NOMAD_SERIAL_CONFIG_H

#include "session.h"

enum { SERIAL_CONNECTION = 1, TCP_CONNECTION = 2 }; /* values of CONN_TYPE */

struct serial_config {
    int is_device; /* a serial device; otherwise a TCP host */
    char name[80];
    int number; /* baud, or TCP port */
    int model;
    int tm_s; /* sent as conf_tm after connecting; 0: not sent */
};

/* Return 1, or 0 after reporting an error. */
int nomad_config_from_arguments(struct serial_config *to, const struct line_arguments *given);

/* Set CONN_TYPE and the variables of the connection in use. */
void nomad_store_config(const struct serial_config *config);

#endif
