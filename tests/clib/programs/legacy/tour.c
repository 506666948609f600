/*
 * tour.c -- a short tour, the way programs for these robots were written.
 *
 *	tour machine port robot
 */
#include <stdio.h>
#include <string.h>
#include "Nclient.h"

int order[16] = { 0, 2, 15, 1, 14, 3, 13, 4, 12, 5, 11, 6, 10, 7, 9, 8 };
long pos[31];

/* wait until nothing moves any more */
halt()
{
	do {
		get_rv();
	} while (State[STATE_VEL_TRANS] != 0 || State[STATE_VEL_STEER] != 0
		|| State[STATE_VEL_TURRET] != 0);
}

where(text)
char *text;
{
	get_rc();
	printf("%s: x %ld y %ld steer %ld turret %ld\n", text, State[STATE_CONF_X],
		State[STATE_CONF_Y], State[STATE_CONF_STEER], State[STATE_CONF_TURRET]);
}

nearest()
{
	register i;
	int best;

	get_sn();
	for (best = 0, i = 1; i < 16; i++)
		if (State[STATE_SONAR_0 + i] < State[STATE_SONAR_0 + best])
			best = i;
	return (best);
}

main(argc, argv)
int argc;
char *argv[];
{
	int robot, i;

	if (argc < 4)
		exit(2);
	strcpy(SERVER_MACHINE_NAME, argv[1]);
	SERV_TCP_PORT = atoi(argv[2]);
	robot = atoi(argv[3]);
	if (!connect_robot(robot)) {
		printf("no robot\n");
		exit(1);
	}
	conf_sn(15, order);
	conf_tm(5);
	ac(300, 500, 500);
	sp(200, 450, 450);
	zr();
	place_robot(300, 700, 0, 0);
	where("start");

	mv(MV_PR, 240, MV_IGNORE, 0, MV_IGNORE, 0);
	halt();
	where("forward");
	mv(MV_IGNORE, 0, MV_PR, 900, MV_PR, 900);
	halt();
	where("turned");
	pr(-100, 0, 0);
	ws(1, 1, 1, 20);
	where("back");

	i = nearest();
	printf("nearest %d %ld\n", i, State[STATE_SONAR_0 + i]);
	if (get_rpx(pos) && pos[0] >= 1)
		printf("robots %ld\n", pos[0]);
	mv(0, 0, 0, 0, 0, 0);
	vm(-50, 0, 0);
	gs();
	printf("moving %ld\n", State[STATE_VEL_TRANS]);
	st();
	halt();
	printf("battery %.1f clock %s\n", voltCpuGet() > 9.0 ? 12.0 : 0.0, posTimeGet() > 0 ? "runs" : "stands");
	if (get_ir())
		printf("infrareds on a Nomad 150?\n");
	printf("error %ld\n", State[STATE_ERROR]);
	disconnect_robot(robot);
	return (0);
}
