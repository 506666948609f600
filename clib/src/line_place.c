/* Where a robot's own line is. */
#include "line_place.h"

#include "Nclient.h"
#include "address.h"
#include "complain.h"

#include <string.h>

enum { USUAL_TM_S = 5 };

static int fill(struct place *to, const char *name, int is_port, int number, int model)
{
    if (strlen(name) >= sizeof to->name) {
        nomad_complain("connect_robot: the name of a device or host has at most %d characters",
                       (int)sizeof to->name - 1);
        return 0;
    }
    memcpy(to->name, name, strlen(name) + 1);
    to->is_port = is_port;
    to->number = number;
    to->model = model;
    to->tm_s = 0;
    return 1;
}

static int fill_from(struct place *to, const struct address *address)
{
    int model = address->model >= 0 ? address->model : DEFAULT_ROBOT_MODEL, filled;

    if (strcmp(address->scheme, "serial") == 0)
        filled = fill(to, address->place, 1, address->baud ? address->baud : DEFAULT_SERIAL_BAUD, model);
    else
        filled = fill(to, address->place, 0, CONN_TCP_PORT, model);
    to->tm_s = address->tm_s >= 0 ? address->tm_s : USUAL_TM_S;
    return filled;
}

/* Where a robot is that is named by its number alone: NOMAD_ROBOT, else the globals. */
int nomad_place_from_outside(struct place *to)
{
    struct address address;
    int found = nomad_address(&address), model = DEFAULT_ROBOT_MODEL;

    if (found < 0)
        return 0;
    if (!found)
        return ROBOT_MACHINE_NAME[0] ? fill(to, ROBOT_MACHINE_NAME, 0, CONN_TCP_PORT, model)
                                     : fill(to, DEFAULT_SERIAL_PORT, 1, DEFAULT_SERIAL_BAUD, model);
    if (strcmp(address.scheme, "serial") == 0 || strcmp(address.scheme, "robotd") == 0)
        return fill_from(to, &address);
    nomad_complain("NOMAD_ROBOT begins with %s://, and this program was linked for a robot's own line, serial:// or "
                   "robotd://; link it with -lnclient for an Nserver", address.scheme);
    return 0;
}

int nomad_place_from_arguments(struct place *to, va_list *more, int known)
{
    int model = va_arg(*more, int), number;
    const char *name;

#ifdef NOMAD_NO_MORE
    if (known && model == NOMAD_NO_MORE)
        return nomad_place_from_outside(to);
#endif
    name = va_arg(*more, const char *);
    number = va_arg(*more, int);
    return fill(to, name, name[0] == '/', number, model);
}
