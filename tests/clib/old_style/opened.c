/* opened.c -- opens the line itself, and names it in the variables. */
#include <stdio.h>
#include <string.h>
#include "Nclient.h"

int main(int argc, char **argv)
{
	if (argc < 2 || !open_serial(argv[1], 38400) || !gs() || !disconnect_robot(1))
		return 1;
	strcpy(NOMAD_SERIAL_PORT, argv[1]);
	NOMAD_SERIAL_BAUD = 38400;
	SERIAL_PORT[0] = ROBOT_MACHINE_NAME[0] = '\0';
	SERIAL_BAUD = ROBOT_TCP_PORT = -1;
	if (!connect_robot(1) || !gs() || CONN_TYPE != 1 || !disconnect_robot(1))
		return 2;
	printf("opened ok\n");
	return 0;
}
