/* Follow a wall on the right at 20 inches.
 *
 *     make -C clib && cc -std=c99 -Iclib/include examples/wall_follower.c -Lclib/build -lnclient -o wall_follower
 *     NOMAD_ROBOT=nserver://localhost:7019/1 ./wall_follower
 */
#include <stdio.h>

#include "Nclient.h"

#define DISTANCE 20

static long smallest(int from, int to)
{
    long nearest = 255;
    int number;

    for (number = from; number <= to; number++)
        if (State[STATE_SONAR_0 + number] < nearest)
            nearest = State[STATE_SONAR_0 + number];
    return nearest;
}

int main(void)
{
    long sum = 0, right, turn;
    int along = 0, steps;

    if (!connect_robot(1))
        return 1;
    conf_tm(5);
    gs();
    for (steps = 0; steps < 400; steps++) {
        if (smallest(0, 1) < DISTANCE + 5) { /* a corner: turn left on the spot */
            vm(0, 300, 300);
            continue;
        }
        right = smallest(11, 14);
        turn = 30 * (DISTANCE - right); /* too near: to the left */
        turn = turn > 250 ? 250 : turn < -250 ? -250 : turn;
        vm(60, (int)turn, (int)turn);
        sum += right;
        along++;
    }
    st();
    printf("%d steps along walls, %.1f in away on average\n", along, along ? (double)sum / along : 0.0);
    disconnect_robot(1);
    return 0;
}
