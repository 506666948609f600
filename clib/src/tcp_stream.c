/* Opens TCP connections. */
#include "error.h"
#include "stream.h"

#include <errno.h>
#include <fcntl.h>
#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

enum { MAX_PORT = 65535 };

/* Return the start of the port in "lab:7654" or "[::1]:7654"; NULL if there is none. Several colons without brackets
 * are an IPv6 address without a port. */
static const char *find_port(const char *given)
{
    const char *colon = strrchr(given, ':');

    return colon && colon[1] != '\0' && (strchr(given, ':') == colon || colon[-1] == ']') ? colon + 1 : NULL;
}

/* Return the port, or 0 if it is invalid: the system would silently use 72555 modulo 65536. */
static int parse_port(const char *given, const char *digits, int report_errors)
{
    long port = digits[strspn(digits, "0123456789")] == '\0' ? strtol(digits, NULL, 10) : 0;

    if (port >= 1 && port <= MAX_PORT)
        return (int)port;
    if (report_errors)
        nomad_report_error("%s: the port must be 1 to %d, not %s", given, MAX_PORT, digits);
    return 0;
}

static void copy_host(char *host, size_t size, const char *given, const char *port)
{
    size_t length = port ? (size_t)(port - given - 1) : strlen(given);

    if (length > 1 && given[0] == '[' && given[length - 1] == ']') {
        given++;
        length -= 2;
    }
    snprintf(host, size, "%.*s", (int)length, given);
}

/* Wait for a connection. Return 0, or an errno value. */
static int wait_for_connection(int fd, const struct addrinfo *at, milliseconds deadline)
{
    int error = 0;
    socklen_t size = sizeof error;

    if (connect(fd, at->ai_addr, at->ai_addrlen) == 0)
        return 0;
    if (errno != EINPROGRESS && errno != EINTR)
        return errno;
    for (;;) {
        struct pollfd waited = {fd, POLLOUT, 0};
        milliseconds left = deadline - nomad_now();
        int ready = poll(&waited, 1, left < 0 ? 0 : (int)left);

        if (ready > 0)
            return getsockopt(fd, SOL_SOCKET, SO_ERROR, &error, &size) == 0 ? error : errno;
        if (ready == 0)
            return ETIMEDOUT;
        if (errno != EINTR)
            return errno;
    }
}

static int open_socket(const struct addrinfo *at, milliseconds deadline, int *error)
{
    int fd = socket(at->ai_family, at->ai_socktype, at->ai_protocol), on = 1;

    if (fd < 0) {
        *error = errno;
        return -1;
    }
    fcntl(fd, F_SETFD, FD_CLOEXEC);
    fcntl(fd, F_SETFL, O_NONBLOCK);
    *error = wait_for_connection(fd, at, deadline);
    if (*error == 0)
        setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
    else
        nomad_close(&fd);
    return fd;
}

int nomad_open_tcp(const char *given, int port, milliseconds reply_timeout, int report_errors)
{
    struct addrinfo wanted, *found = NULL;
    const char *brought = find_port(given);
    char host[256], service[16];
    int fd = -1, error = 0, unknown;

    snprintf(service, sizeof service, "%d", port);
    port = parse_port(given, brought ? brought : service, report_errors);
    if (port == 0)
        return -1;
    snprintf(service, sizeof service, "%d", port);
    copy_host(host, sizeof host, given, brought);
    memset(&wanted, 0, sizeof wanted);
    wanted.ai_socktype = SOCK_STREAM;
    unknown = getaddrinfo(host, service, &wanted, &found);
    if (unknown) {
        if (report_errors)
            nomad_report_error("unknown host %s (%s); check the name and the network connection", host,
                               gai_strerror(unknown));
        return -1;
    }
    for (const struct addrinfo *at = found; at && fd < 0; at = at->ai_next)
        fd = open_socket(at, nomad_now() + reply_timeout, &error);
    freeaddrinfo(found);
    if (fd < 0 && report_errors)
        nomad_report_error("cannot connect to %s:%d (%s); is nserver running there?", host, port, strerror(error));
    return fd;
}
