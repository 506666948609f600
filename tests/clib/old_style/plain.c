/* plain.c -- no header at all: everything is declared here, as programs with their own few lines did. */
#include <stdio.h>
#include <string.h>
#include <stdlib.h>

long State[45];
char SERVER_MACHINE_NAME[80] = "nowhere";
int SERV_TCP_PORT;
int Smask[44];

int connect_robot(long robot_id, ...);
int disconnect_robot(long robot_id);
int gs(), st(), get_sn(), vm(), pr(), server_is_running();
int conf_tm(unsigned char timeout);
int ws(unsigned char, unsigned char, unsigned char, unsigned char);
int connect_robot(long, ...);

int main(int argc, char **argv)
{
	int connected, n;

	if (SERV_TCP_PORT != 7019)
		return 9;
	SERVER_MACHINE_NAME[0] = '\0';
	if (argc > 2) {
		strcpy(SERVER_MACHINE_NAME, argv[1]);
		SERV_TCP_PORT = atoi(argv[2]);
		connected = server_is_running();
	} else if (argc > 1)
		connected = connect_robot(1L, 1, argv[1], 38400);
	else
		connected = connect_robot(1L);
	if (!connected)
		return 1;
	for (n = 0; n < 3 && gs(); n++)
		;
	if (n < 3 || State[17] <= 0 || Smask[33] != 1 || !vm(0, 0, 0) || !st() || !conf_tm(5) || !ws(1, 1, 1, 1))
		return 2;
	printf("plain ok\n");
	return !disconnect_robot(1L);
}
