/* Waits, sends and receives on a file descriptor of any kind. */
#include "stream.h"

#include <errno.h>
#include <poll.h>
#include <sys/socket.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

enum { MAX_FLUSH_READS = 64 };

milliseconds nomad_now(void)
{
    struct timespec now;

    clock_gettime(CLOCK_MONOTONIC, &now);
    return (milliseconds)now.tv_sec * 1000 + now.tv_nsec / 1000000;
}

/* Wait until the descriptor is ready for these events: 1, TIMED_OUT at the deadline, or DISCONNECTED. */
static int wait_for(int fd, short events, milliseconds deadline)
{
    for (;;) {
        struct pollfd waited = {fd, events, 0};
        milliseconds left = deadline - nomad_now();
        int ready = poll(&waited, 1, left < 0 ? 0 : left > 60000 ? 60000 : (int)left);

        if (ready > 0)
            return 1;
        if (ready < 0 && errno != EINTR)
            return DISCONNECTED;
        if (nomad_now() >= deadline)
            return TIMED_OUT;
    }
}

static int is_temporary_error(void) { return errno == EINTR || errno == EAGAIN || errno == EWOULDBLOCK; }

int nomad_send(int fd, const unsigned char *bytes, size_t size, milliseconds deadline)
{
    while (size > 0) {
        ssize_t sent = send(fd, bytes, size, MSG_NOSIGNAL);

        if (sent < 0 && errno == ENOTSOCK)
            sent = write(fd, bytes, size);
        if (sent > 0) {
            bytes += sent;
            size -= (size_t)sent;
        } else if (!is_temporary_error() || wait_for(fd, POLLOUT, deadline) != 1) {
            return DISCONNECTED;
        }
    }
    return 1;
}

long nomad_receive(int fd, unsigned char *bytes, size_t size, milliseconds deadline)
{
    for (;;) {
        int ready = wait_for(fd, POLLIN, deadline);
        ssize_t got;

        if (ready != 1)
            return ready;
        got = read(fd, bytes, size);
        if (got > 0)
            return (long)got;
        if (got == 0 || !is_temporary_error())
            return DISCONNECTED;
    }
}

void nomad_flush(int fd)
{
    unsigned char discarded[512];

    if (tcflush(fd, TCIFLUSH) == 0)
        return;
    for (int k = 0; k < MAX_FLUSH_READS && nomad_receive(fd, discarded, sizeof discarded, nomad_now()) > 0; k++)
        ;
}

void nomad_close(int *fd)
{
    if (*fd >= 0)
        close(*fd);
    *fd = -1;
}
