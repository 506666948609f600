/*
 * twins.c -- two programs in one: the child drives robot 2, the parent robot 1 on the connection it had before.
 *
 *	twins machine port
 */
#include <stdio.h>
#include <string.h>
#include <stdlib.h>
#include <unistd.h>
#include <sys/types.h>
#include <sys/wait.h>
#include "Nclient.h"

static int drive(int speed)
{
	int n;

	if (!vm(0, speed, 0))
		return 0;
	for (n = 0; n < 20; n++)
		if (!gs() || State[STATE_VEL_STEER] != speed)
			return 0;
	return vm(0, 0, 0);
}

int main(int argc, char **argv)
{
	int status;
	pid_t child;

	if (argc < 3)
		return 9;
	strcpy(SERVER_MACHINE_NAME, argv[1]);
	SERV_TCP_PORT = atoi(argv[2]);
	if (!connect_robot(1))
		return 1;
	child = fork();
	if (child == 0) {
		/* the parent's connection goes on while this one begins and ends */
		if (!connect_robot(2) || !drive(300))
			_exit(2);
		_exit(!disconnect_robot(2));
	}
	if (!drive(200))
		return 3;
	waitpid(child, &status, 0);
	if (!drive(100) || status != 0)
		return 4;
	printf("twins ok\n");
	return !disconnect_robot(1);
}
