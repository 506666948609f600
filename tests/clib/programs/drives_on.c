/* Drives and polls the state until the connection is lost, as a control loop does. */
#define _POSIX_C_SOURCE 200809L
#include "Nclient.h"

#include <stdio.h>
#include <time.h>

int main(void)
{
    const struct timespec tenth = {0, 100000000};

    if (!connect_robot(1) || !vm(5, 0, 0))
        return 1;
    puts("driving");
    fflush(stdout);
    while (gs())
        nanosleep(&tenth, NULL);
    return 1;
}
