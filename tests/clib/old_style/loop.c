/* loop.c -- looks at nothing but State[STATE_ERROR], so that the loop ends only when the server has gone. */
#include <stdio.h>
#include "Nclient.h"

int main(void)
{
	if (!connect_robot(1))
		return 1;
	printf("begun\n");
	fflush(stdout);
	do {
		gs();
	} while (State[STATE_ERROR] == 0);
	printf("ended %ld\n", State[STATE_ERROR]);
	return 0;
}
