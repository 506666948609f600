/* prototypes.c -- declares again what it calls, as programs did that were written for several versions of the header. */
#include <stdio.h>
#include "Nclient.h"

#ifdef __cplusplus
extern "C" {
#endif
int connect_robot(long robot_id, ...);
int create_robot(long);
int disconnect_robot(long);
int server_is_running(void);
int init_sensors(void);
int get_state(long state[45]);
int get_laser(int laser[965]);
int get_mask(int mask[44]);
int set_mask(int mask[44]);
int set_server_machine_name(char *);
int set_serv_tcp_port(int);
int open_serial(char *, unsigned short);
int vm(int, int, int);
int mv(int, int, int, int, int, int);
int ws(unsigned char, unsigned char, unsigned char, unsigned char);
int conf_tm(unsigned char);
int conf_ls(unsigned int, unsigned int, unsigned int, unsigned int, unsigned int);
int conf_sg(unsigned int, unsigned int, unsigned int);
int conf_sn(int, int order[16]);
int arm_zr(short);
int arm_ws(short, short, long, long *);
int arm_mv(long, long, long, long);
int scout_vm(int, int);
int draw_robot(long, long, int, int, int);
int draw_line(long, long, long, long, int);
int draw_arc(long, long, long, long, int, int, int);
int motion_check(long, double, double, double, double, double, double, double, double collide[3]);
int add_Obs(long obs[2*MAX_VERTICES+1]);
int move_Obs(long obs[2*MAX_VERTICES+1], long, long);
int init_send_buffer(unsigned short *);
int stuff_send_buffer_header(unsigned short, unsigned char, unsigned char, unsigned char *);
int stuffchar(signed char, unsigned char *, unsigned short *);
int stuff4byteint(long, unsigned char *, unsigned short *);
int stuffdouble(double, unsigned char *, unsigned short *);
long extract4byteint(unsigned char *, unsigned short *);
double extractdouble(unsigned char *, unsigned short *);
extern long State[NUM_STATE];
extern int Smask[NUM_MASK];
extern int Laser[2*NUM_LASER+1];
extern char SERVER_MACHINE_NAME[];
extern int SERV_TCP_PORT;
extern char ROBOT_MACHINE_NAME[], SERIAL_PORT[];
extern double LASER_CALIBRATION[8], LASER_OFFSET[2];
#ifdef __cplusplus
}
#endif

int main(void)
{
	unsigned char buffer[BUFSIZE];
	unsigned short at;

	init_send_buffer(&at);
	stuffdouble(0.5, buffer, &at);
	at = 4;
	printf(extractdouble(buffer, &at) == 0.5 && State[STATE_ERROR] == 0 ? "prototypes ok\n" : "differs\n");
	return 0;
}
