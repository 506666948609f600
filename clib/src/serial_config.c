/* Determines the serial port or TCP host of a robot's own line. */
#include "serial_config.h"

#include "Nclient.h"
#include "address.h"
#include "error.h"

#include <string.h>

enum { DEFAULT_TM_S = 5 };

static int set_config(struct serial_config *to, const char *name, int is_device, int number, int model)
{
    if (strlen(name) >= sizeof to->name) {
        nomad_report_error("connect_robot: a device or host name may have at most %d characters",
                           (int)sizeof to->name - 1);
        return 0;
    }
    memcpy(to->name, name, strlen(name) + 1);
    to->is_device = is_device;
    to->number = number;
    to->model = model;
    to->tm_s = 0;
    return 1;
}

static int config_from_address(struct serial_config *to, const struct address *address)
{
    int model = address->model >= 0 ? address->model : DEFAULT_ROBOT_MODEL, filled;

    if (strcmp(address->scheme, "serial") == 0)
        filled = set_config(to, address->location, 1, address->baud ? address->baud : DEFAULT_SERIAL_BAUD, model);
    else
        filled = set_config(to, address->location, 0, CONN_TCP_PORT, model);
    to->tm_s = address->tm_s >= 0 ? address->tm_s : DEFAULT_TM_S;
    return filled;
}

/* Connection of a robot given by its number alone: NOMAD_ROBOT, else the globals of Nclient.h. */
int nomad_default_config(struct serial_config *to)
{
    struct address address;
    int found = nomad_parse_address(&address), model = DEFAULT_ROBOT_MODEL;

    if (found < 0)
        return 0;
    if (!found)
        return ROBOT_MACHINE_NAME[0] ? set_config(to, ROBOT_MACHINE_NAME, 0, CONN_TCP_PORT, model)
                                     : set_config(to, DEFAULT_SERIAL_PORT, 1, DEFAULT_SERIAL_BAUD, model);
    if (strcmp(address.scheme, "serial") == 0 || strcmp(address.scheme, "robotd") == 0)
        return config_from_address(to, &address);
    nomad_report_error("NOMAD_ROBOT begins with %s://, but this program is linked for a robot's own line (serial:// or "
                       "robotd://); link it with -lnclient to use an Nserver",
                       address.scheme);
    return 0;
}

int nomad_config_from_arguments(struct serial_config *to, va_list *extra, int has_end_marker)
{
    int model = va_arg(*extra, int), number;
    const char *name;

#ifdef NOMAD_NO_MORE
    if (has_end_marker && model == NOMAD_NO_MORE)
        return nomad_default_config(to);
#endif
    name = va_arg(*extra, const char *);
    number = va_arg(*extra, int);
    return set_config(to, name, name[0] == '/', number, model);
}
