// robot.cc -- a class around the calls, with methods of the same names, as C++ programs had it.
#include <iostream>
#include <string.h>
#include <stdlib.h>
#include "Nclient.h"

class Robot {
	long id;
	bool connected;
public:
	Robot(long number) : id(number), connected(false) {}
	~Robot() { if (connected) ::disconnect_robot(id); }
	int connect_robot(const char *machine, int port);
	int connect_robot() { return connected = ::connect_robot(id) != 0; }
	int scout_vm(int trans, int turn) { return ::scout_vm(trans, turn); }
	int vm(int t, int s, int r) { return ::vm(t, s, r); }
	int gs() { return ::gs(); }
	long State(int k) const { return ::State[k]; }
};

int Robot::connect_robot(const char *machine, int port)
{
	strcpy(SERVER_MACHINE_NAME, machine);
	SERV_TCP_PORT = port;
	return connect_robot();
}

int main(int argc, char *argv[])
{
	Robot robot(argc > 3 ? atoi(argv[3]) : 1);
	int connected = argc > 2 ? robot.connect_robot(argv[1], atoi(argv[2])) : robot.connect_robot();

	if (!connected)
		return 1;
	if (!robot.vm(0, 50, 0) || !robot.gs() || !robot.vm(0, 0, 0))
		return 2;
	int (*call)(long, ...) = connect_robot;		// taken as a function too
	if (call == 0 || robot.State(STATE_SONAR_0) <= 0)
		return 3;
	std::cout << "robot ok" << std::endl;
	return 0;
}
