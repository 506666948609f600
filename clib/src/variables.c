/* The variables of Nclient.h. They are weak symbols: a program that defines one itself replaces it. This file does not
 * include the header, since Smask has one element more than declared there, for programs that write behind its end. */

#define WEAK __attribute__((weak))
#define SIXTEEN_ON 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1

WEAK long State[45];
WEAK int Smask[44 + 1] = {0, SIXTEEN_ON, SIXTEEN_ON, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1};
WEAK int Laser[2 * 482 + 1];

WEAK char SERVER_MACHINE_NAME[80] = "";
WEAK int SERV_TCP_PORT = 7019;

WEAK int CONN_TYPE = -1;
WEAK char ROBOT_MACHINE_NAME[80] = "";
WEAK int ROBOT_TCP_PORT = -1;
WEAK int CONN_TCP_PORT = 65001;
WEAK char SERIAL_PORT[40] = "";
WEAK int SERIAL_BAUD = -1;
WEAK char NOMAD_SERIAL_PORT[40] = "";
WEAK int NOMAD_SERIAL_BAUD = -1;
WEAK char DEFAULT_SERIAL_PORT[80] = "/dev/ttyS0";
WEAK int DEFAULT_SERIAL_BAUD = 38400;
WEAK int DEFAULT_ROBOT_MODEL = 1; /* MODEL_N150 */

WEAK double LASER_CALIBRATION[8];
WEAK double LASER_OFFSET[2];
