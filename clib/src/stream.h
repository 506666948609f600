/* Byte streams: a TCP connection or a serial port as a non-blocking file descriptor.
 *
 * Every wait has a deadline on the monotonic clock and continues after signals. Writing to a closed connection is an
 * error and raises no SIGPIPE.
 */
#ifndef NOMAD_STREAM_H
#define NOMAD_STREAM_H

#include <stddef.h>

typedef long long milliseconds;

enum { DISCONNECTED = -1, TIMED_OUT = 0 };

milliseconds nomad_now(void);

/* Return a descriptor, or -1 (with an error report if `report_errors`). `host` may include a port: lab:7654,
 * [::1]:7654. */
int nomad_open_tcp(const char *host, int port, milliseconds reply_timeout, int report_errors);
int nomad_open_serial(const char *device, int baud);
void nomad_close(int *fd);

/* Send all bytes: 1, or DISCONNECTED. */
int nomad_send(int fd, const unsigned char *bytes, size_t size, milliseconds deadline);

/* Receive at most `size` bytes. Return their number, TIMED_OUT at the deadline, or DISCONNECTED. */
long nomad_receive(int fd, unsigned char *bytes, size_t size, milliseconds deadline);

/* Discard received bytes that were not read. */
void nomad_flush(int fd);

#endif
