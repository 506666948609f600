/* Opens a serial port: 8 data bits, no parity, one stop bit, no flow control, no translation.
 *
 * The port is locked with flock, as the Python package and other serial programs do. The settings of a port that
 * another program has locked are not changed.
 */
#include "error.h"
#include "stream.h"

#include <errno.h>
#include <fcntl.h>
#include <string.h>
#include <sys/file.h>
#include <termios.h>

static const struct {
    int baud;
    speed_t speed;
} SPEEDS[] = {
    {1200, B1200},   {2400, B2400},   {4800, B4800},   {9600, B9600},
    {19200, B19200}, {38400, B38400}, {57600, B57600}, {115200, B115200},
};

static int find_speed(int baud, speed_t *speed)
{
    for (size_t k = 0; k < sizeof SPEEDS / sizeof *SPEEDS; k++)
        if (SPEEDS[k].baud == baud) {
            *speed = SPEEDS[k].speed;
            return 1;
        }
    return 0;
}

static int configure(int fd, speed_t speed)
{
    struct termios port;

    if (tcgetattr(fd, &port) != 0)
        return 0;
    port.c_iflag &= (tcflag_t) ~(IGNBRK | BRKINT | PARMRK | ISTRIP | INLCR | IGNCR | ICRNL | IXON | IXOFF | INPCK);
    port.c_oflag &= (tcflag_t)~OPOST;
    port.c_lflag &= (tcflag_t) ~(ECHO | ECHONL | ICANON | ISIG | IEXTEN);
    port.c_cflag &= (tcflag_t) ~(CSIZE | PARENB | CSTOPB | CRTSCTS);
    port.c_cflag |= CS8 | CLOCAL | CREAD;
    port.c_cc[VMIN] = 1;
    port.c_cc[VTIME] = 0;
    return cfsetispeed(&port, speed) == 0 && cfsetospeed(&port, speed) == 0 && tcsetattr(fd, TCSANOW, &port) == 0
           && tcflush(fd, TCIOFLUSH) == 0;
}

static void report_open_error(const char *device, int error)
{
    if (error == EWOULDBLOCK || error == EBUSY)
        nomad_report_error("%s is in use by another program; only one program at a time can use a robot", device);
    else
        nomad_report_error("%s cannot be opened as a serial port (%s)%s", device, strerror(error),
                           error == EACCES ? "; is your user in the group dialout?" : "");
}

int nomad_open_serial(const char *device, int baud)
{
    speed_t speed;
    int fd;

    if (!find_speed(baud, &speed)) {
        nomad_report_error("%d is not a valid baud rate; the factory setting of robots is 38400", baud);
        return -1;
    }
    fd = open(device, O_RDWR | O_NOCTTY | O_NONBLOCK | O_CLOEXEC);
    /* Lock before configuring: configuring would change the speed and discard the input of a program that uses the
     * port. */
    if (fd < 0 || flock(fd, LOCK_EX | LOCK_NB) != 0 || !configure(fd, speed)) {
        report_open_error(device, errno);
        nomad_close(&fd);
    }
    return fd;
}
