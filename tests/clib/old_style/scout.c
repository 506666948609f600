/* scout.c -- drives a Scout around a corner; works with either library.  ANSI C. */
#include <stdio.h>
#include <string.h>
#include "Nclient.h"

#ifndef MODEL_SCOUT2
#error "not for this robot"
#endif

/* programs repeated what they used */
extern int scout_vm(int trans, int steer);
extern int scout_pr(int trans, int steer);
extern int connect_robot(long robot_id, ...);
extern int conf_tm(unsigned char timeout);
extern int ws(unsigned char t_ws, unsigned char s_ws, unsigned char r_ws, unsigned char timeout);
extern int arm_zr(short override);
extern int conf_sg(unsigned int threshold, unsigned int min_points, unsigned int gap);

int main(int argc, char *argv[])
{
	int connected, n;

	if (argc > 1)
		connected = connect_robot(1, MODEL_SCOUT2, argv[1], 38400);
	else
		connected = connect_robot(1);	/* NOMAD_ROBOT, or what the variables say */
	if (!connected || !conf_tm(5) || !da(0, 0))
		return 1;
	scout_vm(100, 0);
	for (n = 0; n < 10; n++)
		gs();
	if (State[STATE_VEL_RIGHT] != State[STATE_VEL_LEFT] || State[STATE_VEL_RIGHT] <= 0)
		return 2;
	scout_vm(0, 0);
	ws(1, 1, 0, 5);
	scout_pr(0, 450);
	ws(1, 1, 0, 10);
	printf("turned %s\n", State[STATE_CONF_STEER] > 300 && State[STATE_CONF_STEER] < 600 ? "left" : "not");
	st();
	if (RIGHT(0, 450) != -LEFT(0, 450))
		return 3;
	return disconnect_robot(1) ? 0 : 4;
}
