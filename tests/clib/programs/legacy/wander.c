/* wander.c -- go where there is room; works with either library */
#include <stdio.h>
#include <signal.h>
#include <stdlib.h>
#include "Nclient.h"
#include <sys/time.h>

#define FRONT	STATE_SONAR_0
#define TOO_NEAR	22

int ticks = 0;

void tick()
{
	ticks++;
}

main(argc, argv)
char **argv;
{
	int n, legs = 0, turning = 0;
	long way = 0, x, y;
	struct sigaction act;
	struct itimerval often;

	/* programs had timers, and the calls are interrupted by them */
	act.sa_handler = tick;
	act.sa_flags = 0;
	sigemptyset(&act.sa_mask);
	sigaction(SIGALRM, &act, NULL);
	often.it_interval.tv_sec = often.it_value.tv_sec = 0;
	often.it_interval.tv_usec = often.it_value.tv_usec = 1000;
	setitimer(ITIMER_REAL, &often, NULL);

	if (argc > 2)
		n = connect_robot(1, MODEL_N150, argv[1], atoi(argv[2]));
	else
		n = connect_robot(1);
	if (n == FALSE) {
		fprintf(stderr, "cannot connect\n");
		return 1;
	}
	zr();
	x = State[STATE_CONF_X];
	y = State[STATE_CONF_Y];
	for (n = 0; legs < 2 && n < 3000; n++) {
		if (!gs())
			return 1;
		way += labs(State[STATE_CONF_X] - x) + labs(State[STATE_CONF_Y] - y);
		x = State[STATE_CONF_X];
		y = State[STATE_CONF_Y];
		if (State[FRONT] < TOO_NEAR || State[FRONT + 1] < TOO_NEAR || State[FRONT + 15] < TOO_NEAR) {
			if (!turning)
				legs++;
			turning = 1;
			vm(0, 300, 300);
		} else {
			turning = 0;
			vm(100, 0, 0);
		}
		usleep(1000);
	}
	vm(0, 0, 0);
	st();
	get_rv();
	printf("still %ld %ld %ld\n", State[38], State[39], State[40]);
	printf("way %ld legs %d interrupted %s\n", way, legs, ticks > 20 ? "often" : "seldom");
	return disconnect_robot(1) ? 0 : 1;
}
