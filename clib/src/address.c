/* Parses the environment variable NOMAD_ROBOT. */
#include "address.h"

#include "Nclient.h"
#include "error.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { MAX_ROBOT_ID = 0x7FFFFFFF, MAX_TM_S = 255 };

static int find_model(const char *name)
{
    static const char *const NAMES[] = {"n200", "n150", "scout"}; /* indexed by model number */

    for (int k = 0; k < 3; k++)
        if (strcmp(name, NAMES[k]) == 0)
            return k;
    return -1;
}

/* Return the argument of conf_tm: 0 (no time-out) or 2 to 255 seconds; -1 for any other text. */
static int parse_tm_s(const char *text)
{
    size_t digits = strspn(text, "0123456789");
    int seconds = atoi(text);

    return digits && digits <= 3 && !text[digits] && seconds != 1 && seconds <= MAX_TM_S ? seconds : -1;
}

static int parse_option(struct address *address, const char *option)
{
    if (strncmp(option, "model=", 6) == 0)
        return (address->model = find_model(option + 6)) >= 0;
    if (strncmp(option, "tm_s=", 5) == 0)
        return (address->tm_s = parse_tm_s(option + 5)) >= 0;
    if (strncmp(option, "baud=", 5) == 0)
        return (address->baud = atoi(option + 5)) > 0;
    return 0;
}

static int parse_options(struct address *address, char *options)
{
    for (char *option = strtok(options, "&"); option; option = strtok(NULL, "&"))
        if (!parse_option(address, option)) {
            nomad_report_error("NOMAD_ROBOT: unknown option or value %s; use model=n150, n200 or scout, baud=, "
                               "and tm_s=0 or 2 to 255",
                               option);
            return 0;
        }
    return 1;
}

/* Parse the part after the host: a robot number such as /2 for an Nserver, nothing for a robot. */
static int parse_path(struct address *address, const char *path)
{
    const char *number = path + strspn(path, "/");
    size_t digits = strspn(number, "0123456789");
    long long robot = strtoll(number, NULL, 10);

    if (*number == '\0')
        return 1;
    if (strcmp(address->scheme, "nserver") != 0) {
        nomad_report_error("NOMAD_ROBOT: only a host and a port may follow %s://, not /%s", address->scheme, path);
        return 0;
    }
    if (digits == 0 || number[digits + strspn(number + digits, "/")] != '\0' || robot < 1 || robot > MAX_ROBOT_ID) {
        nomad_report_error("NOMAD_ROBOT: only a robot number, 1 or more, may follow the host, not /%s", path);
        return 0;
    }
    address->robot = (long)robot;
    return 1;
}

int nomad_parse_address(struct address *address)
{
    const char *given = getenv("NOMAD_ROBOT"), *separator;
    char text[256], *options, *slash;

    memset(address, 0, sizeof *address);
    address->model = address->tm_s = -1;
    if (given == NULL || *given == '\0')
        return 0;
    separator = strstr(given, "://");
    if (separator == NULL || separator - given >= (long)sizeof address->scheme || strlen(given) >= sizeof text) {
        nomad_report_error("NOMAD_ROBOT is %.100s, which is not an address such as nserver://host:7019/1", given);
        return -1;
    }
    snprintf(address->scheme, sizeof address->scheme, "%.*s", (int)(separator - given), given);
    snprintf(text, sizeof text, "%s", separator + 3);
    options = strchr(text, '?');
    if (options)
        *options++ = '\0';
    slash = strchr(text, '/');
    if (slash && strcmp(address->scheme, "serial") != 0)
        *slash++ = '\0';
    if (slash && strcmp(address->scheme, "serial") != 0 && !parse_path(address, slash))
        return -1;
    if (strlen(text) >= sizeof address->location) {
        nomad_report_error("NOMAD_ROBOT: %.100s is longer than a host name can be", text);
        return -1;
    }
    memcpy(address->location, text, strlen(text) + 1);
    return options && !parse_options(address, options) ? -1 : 1;
}

void nomad_report_ignored_address(const char *used)
{
    const char *ignored = getenv("NOMAD_ROBOT");

    if (ignored && *ignored && strstr(ignored, used) == NULL)
        nomad_print("Nclient: NOMAD_ROBOT=%.100s is ignored: the program names %.80s", ignored, used);
}
