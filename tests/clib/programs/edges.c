/* Calls that replay.c cannot make: wild pointers' sizes, wild doubles, and a server on this machine that is not named.
 *
 *     edges PORT        what is not as it should be is said, and counted in what it returns
 */
#include "Nclient.h"
#include "nomad.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static int wrong;

static void expect(int truth, const char *what)
{
    if (truth)
        return;
    printf("not so: %s (%s)\n", what, nomad_last_error());
    wrong++;
}

static int special(int size)
{
    unsigned char sent[300] = {0}, received[254];

    sent[0] = (unsigned char)size;
    sent[1] = (unsigned char)(size >> 8);
    sent[2] = 77; /* a serial is sent as 0 */
    sent[3] = 200;
    return special_request(sent, received);
}

int main(int count, char **words)
{
    PosData at;
    double collide[3];

    SERV_TCP_PORT = count > 1 ? atoi(words[1]) : 0;
    nomad_verbose = 0;
    expect(!gs() && strstr(nomad_last_error(), "connect_robot comes first") != NULL, "gs before connecting is FALSE");
    expect(connect_robot(1) == 7019, "a server that is not named is looked for on this machine");
    expect(connect_robot(2) == 7019, "connecting again leaves the first");
    expect(!posSonarGet(&at, 16) && !posInfraredGet(&at, -1), "there are sixteen sensors");
    expect(posSonarGet(&at, 15) && at.x == 0, "a sensor that has not read has zeros");
    expect(!special(3) && !special(255) && special(4) && special(254), "packets have 4 to 254 bytes");
    expect(motion_check(0, -12.345, 0.29, 1e300, -1e300, 0, 0, 0, collide) == 0, "far away nothing is hit");
    expect(motion_check(1, NAN, HUGE_VAL, 1.57, -3.14, 1, 2, 3, collide) == 0, "what is no number is no crash");
    expect(nomad_sim_control(1, 0), "the simulation pauses");
    expect(disconnect_robot(2) && !disconnect_robot(2), "it is left once");
    return wrong;
}
