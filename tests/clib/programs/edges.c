/* Calls that replay.c cannot make: extreme packet sizes and doubles, and a server found on localhost by default.
 *
 *     edges PORT        prints each failed check; the exit code is their number
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
    printf("failed: %s (%s)\n", what, nomad_last_error());
    wrong++;
}

static int special(int size)
{
    unsigned char sent[300] = {0}, received[254];

    sent[0] = (unsigned char)size;
    sent[1] = (unsigned char)(size >> 8);
    sent[2] = 77; /* the library sends 0 as serial number */
    sent[3] = 200;
    return special_request(sent, received);
}

int main(int count, char **words)
{
    PosData at;
    double collide[3];

    SERV_TCP_PORT = count > 1 ? atoi(words[1]) : 0;
    nomad_verbose = 0;
    expect(!gs() && strstr(nomad_last_error(), "call connect_robot first") != NULL, "gs before connecting is FALSE");
    expect(connect_robot(1) == 7019, "the default server is localhost");
    expect(connect_robot(2) == 7019, "connecting again closes the first session");
    expect(!posSonarGet(&at, 16) && !posInfraredGet(&at, -1), "there are sixteen sensors");
    expect(posSonarGet(&at, 15) && at.config.configX == 0, "a sensor without a reading has zeros");
    expect(!special(3) && !special(255) && special(4) && special(254), "packets have 4 to 254 bytes");
    expect(motion_check(0, -12.345, 0.29, 1e300, -1e300, 0, 0, 0, collide) == 0, "no collision far away");
    expect(motion_check(1, NAN, HUGE_VAL, 1.57, -3.14, 1, 2, 3, collide) == 0, "NaN causes no crash");
    expect(nomad_sim_control(1, 0), "the simulation pauses");
    expect(disconnect_robot(2) && !disconnect_robot(2), "disconnecting works once");
    return wrong;
}
