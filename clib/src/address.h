/* The address in NOMAD_ROBOT, in the format that the project's Python programs also use:
 *
 *     nserver://host[:port][/id]       serial:///dev/ttyUSB0?model=n150&baud=38400     robotd://host[:port]?model=n200
 *
 * With tm_s=5 in any of them, connecting sends conf_tm 5.
 *
 * The address is used when the program itself names no machine. The program always gives the robot's number; if the
 * address contains one too, the two must be equal.
 */
#ifndef NOMAD_ADDRESS_H
#define NOMAD_ADDRESS_H

struct address {
    char scheme[16];
    char location[80]; /* host with optional port, or a device */
    long robot;        /* for nserver://; 0: not given */
    int model;         /* -1: not given */
    int baud;          /* 0: not given */
    int tm_s;          /* conf_tm in seconds: 2 to 255, 0: no time-out; -1: not given */
};

/* Parse NOMAD_ROBOT. Return 1; 0 if it is not set; -1 after reporting an error if it is invalid. */
int nomad_parse_address(struct address *address);

/* Print a note if NOMAD_ROBOT names another place than `used`, which the program itself names. */
void nomad_report_ignored_address(const char *used);

#endif
