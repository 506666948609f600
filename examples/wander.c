/* Wander for 30 seconds: drive ahead, turn away from what is near.
 *
 *     make -C clib && cc -std=c99 -Iclib/include examples/wander.c -Lclib/build -lnclient -o wander
 *     NOMAD_ROBOT=nserver://localhost:7019/1 ./wander
 */
#include <stdio.h>

#include "Nclient.h"

static long nearest_ahead(void)
{
    long ahead = State[STATE_SONAR_0], left = State[STATE_SONAR_1], right = State[STATE_SONAR_15];
    long nearest = left < right ? left : right;

    return ahead < nearest ? ahead : nearest; /* inches; 255: nothing */
}

int main(void)
{
    int turns = 0, steps;

    if (!connect_robot(1))
        return 1;
    conf_tm(5); /* the robot stops by itself if this program dies */
    gs();
    for (steps = 0; steps < 300; steps++) {
        if (nearest_ahead() > 20) {
            vm(80, 0, 0); /* tenths of an inch a second */
        } else {
            vm(0, 400, 400); /* tenths of a degree a second: steering and turret */
            turns++;
        }
    }
    st();
    ws(1, 1, 1, 5);
    printf("%d of %d steps were turns, at %ld, %ld tenths of an inch\n", turns, steps, State[STATE_CONF_X],
           State[STATE_CONF_Y]);
    disconnect_robot(1);
    return 0;
}
