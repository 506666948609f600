/* How bytes move: a TCP connection or a serial port, as a file descriptor that never blocks.
 *
 * Rules: every wait has a deadline of the monotonic clock; signals interrupt nothing; a peer that is gone is an error
 * that is said, never a SIGPIPE. Nothing here knows what the bytes mean.
 */
#ifndef NOMAD_STREAM_H
#define NOMAD_STREAM_H

#include <stddef.h>

typedef long long milliseconds;

enum { LOST = -1, SILENT = 0 };

milliseconds nomad_now(void);

/* A descriptor, or -1 and a complaint if `aloud`. `host` may bring its own port: lab:7654 or [::1]:7654. */
int nomad_open_tcp(const char *host, int port, milliseconds patience, int aloud);
int nomad_open_serial(const char *device, int baud);
void nomad_close(int *fd);

/* All of it: 1, or LOST. */
int nomad_send(int fd, const unsigned char *bytes, size_t size, milliseconds deadline);

/* What has come, at most `size`: its size, SILENT at the deadline, or LOST. */
long nomad_receive(int fd, unsigned char *bytes, size_t size, milliseconds deadline);

/* Throw away what has come and was not read. */
void nomad_flush(int fd);

#endif
