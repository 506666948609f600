/* Determines the serial port or TCP host of a robot's own line. */
#include "serial_config.h"

#include "Nclient.h"
#include "address.h"
#include "error.h"

#include <errno.h>
#include <string.h>
#include <unistd.h>

enum { DEFAULT_TM_S = 5, MAX_NUMBER = 115200 /* the fastest baud rate */ };

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

static int is_set(int number) { return number > 0; }

/* The variables of Nclient.h: a host, else a serial port. */
static int config_from_variables(struct serial_config *to)
{
    const char *port = SERIAL_PORT[0] ? SERIAL_PORT : NOMAD_SERIAL_PORT[0] ? NOMAD_SERIAL_PORT : DEFAULT_SERIAL_PORT;
    int baud = is_set(SERIAL_BAUD)         ? SERIAL_BAUD
               : is_set(NOMAD_SERIAL_BAUD) ? NOMAD_SERIAL_BAUD
                                           : DEFAULT_SERIAL_BAUD;

    if (ROBOT_MACHINE_NAME[0])
        return set_config(to, ROBOT_MACHINE_NAME, 0, is_set(ROBOT_TCP_PORT) ? ROBOT_TCP_PORT : CONN_TCP_PORT,
                          DEFAULT_ROBOT_MODEL);
    return set_config(to, port, 1, baud, DEFAULT_ROBOT_MODEL);
}

/* Connection of a robot given by its number alone: NOMAD_ROBOT, else the variables. */
static int default_config(struct serial_config *to)
{
    struct address address;
    int found = nomad_parse_address(&address);

    if (found < 0)
        return 0;
    if (!found)
        return config_from_variables(to);
    if (strcmp(address.scheme, "serial") == 0 || strcmp(address.scheme, "robotd") == 0)
        return config_from_address(to, &address);
    nomad_report_error("NOMAD_ROBOT begins with %s://, but this program is linked for a robot's own line (serial:// or "
                       "robotd://); link it with -lnclient to use an Nserver",
                       address.scheme);
    return 0;
}

/* Return 1 for a device or host name. `name` may point anywhere: access reports an address that cannot be read. */
static int is_name(const char *name)
{
    static const char *const HOST = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789.:[]-";

    if (access(name, F_OK) != 0 && errno == EFAULT)
        return 0;
    return name[0] == '/' || (name[0] != '\0' && name[strspn(name, HOST)] == '\0');
}

/* Return 1 if a call had arguments after the robot number. Without them a variable-argument function reads random
 * numbers, which are not at once a model, a name, and a baud rate or port. */
static int has_arguments(const struct line_arguments *given)
{
    if (given == NULL || given->count >= 0)
        return given != NULL;
    return given->model >= 0 && given->model <= MODEL_SCOUT && given->number > 0 && given->number <= MAX_NUMBER
           && is_name(given->name);
}

int nomad_config_from_arguments(struct serial_config *to, const struct line_arguments *given)
{
    if (!has_arguments(given))
        return default_config(to);
    if (given->name == NULL) {
        nomad_report_error("connect_robot: after the robot's number give model, line and baud rate, or nothing");
        return 0;
    }
    nomad_report_ignored_address(given->name);
    return set_config(to, given->name, given->name[0] == '/', given->number, given->model);
}

static void store(char *variable, size_t size, const char *name)
{
    if (strlen(name) < size)
        memcpy(variable, name, strlen(name) + 1);
}

void nomad_store_config(const struct serial_config *config)
{
    CONN_TYPE = config->is_device ? SERIAL_CONNECTION : TCP_CONNECTION;
    if (config->is_device) {
        store(SERIAL_PORT, sizeof SERIAL_PORT, config->name);
        SERIAL_BAUD = config->number;
    } else {
        store(ROBOT_MACHINE_NAME, sizeof ROBOT_MACHINE_NAME, config->name);
        ROBOT_TCP_PORT = config->number;
    }
}
