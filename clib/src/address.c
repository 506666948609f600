/* NOMAD_ROBOT, taken apart. */
#include "address.h"

#include "Nclient.h"
#include "complain.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { LAST_ROBOT = 0x7FFFFFFF, LONGEST_TM_S = 255 };

static int model_named(const char *name)
{
    static const char *const NAMES[] = {"n200", "n150", "scout"}; /* by their numbers */

    for (int k = 0; k < 3; k++)
        if (strcmp(name, NAMES[k]) == 0)
            return k;
    return -1;
}

/* What conf_tm takes: 0 for never, 2 to 255; -1 for all else. */
static int seconds_in(const char *text)
{
    size_t digits = strspn(text, "0123456789");
    int seconds = atoi(text);

    return digits && digits <= 3 && !text[digits] && seconds != 1 && seconds <= LONGEST_TM_S ? seconds : -1;
}

static int take_option(struct address *address, const char *option)
{
    if (strncmp(option, "model=", 6) == 0)
        return (address->model = model_named(option + 6)) >= 0;
    if (strncmp(option, "tm_s=", 5) == 0)
        return (address->tm_s = seconds_in(option + 5)) >= 0;
    if (strncmp(option, "baud=", 5) == 0)
        return (address->baud = atoi(option + 5)) > 0;
    return 0;
}

static int take_options(struct address *address, char *options)
{
    for (char *option = strtok(options, "&"); option; option = strtok(NULL, "&"))
        if (!take_option(address, option)) {
            nomad_complain("NOMAD_ROBOT: %s is no option here; there are model=n150, n200 or scout, baud=, "
                           "and tm_s=0 or 2 to 255", option);
            return 0;
        }
    return 1;
}

/* What follows the host: of an Nserver /2, or nothing; of a robot nothing. */
static int take_path(struct address *address, const char *path)
{
    const char *number = path + strspn(path, "/");
    size_t digits = strspn(number, "0123456789");
    long long robot = strtoll(number, NULL, 10);

    if (*number == '\0')
        return 1;
    if (strcmp(address->scheme, "nserver") != 0) {
        nomad_complain("NOMAD_ROBOT: a host and its port follow %s://, not /%s", address->scheme, path);
        return 0;
    }
    if (digits == 0 || number[digits + strspn(number + digits, "/")] != '\0' || robot < 1 || robot > LAST_ROBOT) {
        nomad_complain("NOMAD_ROBOT: what follows the host is the robot's number, 1 or more, not /%s", path);
        return 0;
    }
    address->robot = (long)robot;
    return 1;
}

int nomad_address(struct address *address)
{
    const char *given = getenv("NOMAD_ROBOT"), *place;
    char text[256], *options, *slash;

    memset(address, 0, sizeof *address);
    address->model = address->tm_s = -1;
    if (given == NULL || *given == '\0')
        return 0;
    place = strstr(given, "://");
    if (place == NULL || place - given >= (long)sizeof address->scheme || strlen(given) >= sizeof text) {
        nomad_complain("NOMAD_ROBOT is %.100s, and that is no address such as nserver://host:7019/1", given);
        return -1;
    }
    snprintf(address->scheme, sizeof address->scheme, "%.*s", (int)(place - given), given);
    snprintf(text, sizeof text, "%s", place + 3);
    options = strchr(text, '?');
    if (options)
        *options++ = '\0';
    slash = strchr(text, '/');
    if (slash && strcmp(address->scheme, "serial") != 0)
        *slash++ = '\0';
    if (slash && strcmp(address->scheme, "serial") != 0 && !take_path(address, slash))
        return -1;
    if (strlen(text) >= sizeof address->place) {
        nomad_complain("NOMAD_ROBOT: %.100s is longer than the name of a machine can be", text);
        return -1;
    }
    memcpy(address->place, text, strlen(text) + 1);
    return options && !take_options(address, options) ? -1 : 1;
}
