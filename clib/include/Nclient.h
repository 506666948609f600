/* The C library of the Nomad robots, for old programs on current machines.
 *
 *     #include "Nclient.h"                              cc prog.c -lnclient       robot of an Nserver
 *     strcpy(SERVER_MACHINE_NAME, "lab");               cc prog.c -lndirect       robot on its own line
 *     if (connect_robot(1)) {
 *         vm(100, 0, 0);                                forward at 10 inches a second
 *         while (State[STATE_SONAR_0] > 20) gs();       until 20 inches before a wall
 *         st();
 *         disconnect_robot(1);
 *     }
 *
 * Units: lengths in 1/10 inch, angles in 1/10 degree, counter-clockwise positive, speeds per second, sonar in whole
 * inches. A call returns TRUE, or FALSE if it was rejected, could not be sent, or had no valid reply; the reason is
 * printed to stderr. The code of a server's error reply is in State[STATE_ERROR]: 1 unknown message, 2 wrong number or
 * range of values, 3 not connected, 4 not available on this model, 5 not allowed, 6 the real robot did not reply; 111
 * after a call that found no server or lost it. Calls whose reply has no values (tk, place_robot, add_obstacle,
 * delete_obstacle, new_world, real_robot, simulated_robot, quit_server, draw_ and refresh_ calls) return TRUE and leave
 * State[STATE_ERROR] alone when the server refuses them. Numbers beyond the range of a message are clamped to it.
 *
 * A program may define State, Smask, Laser and the other variables itself; the library then uses those.
 *
 * One program, one thread, one robot. Usable from C89, C99 and C++. Additions to the old library are in nomad.h, to
 * avoid name clashes with old programs. MIT licence; see clib/README.md.
 */
#ifndef NCLIENT_H
#define NCLIENT_H

#ifdef __cplusplus
extern "C" {
#endif

#ifndef TRUE
#define TRUE 1
#endif
#ifndef FALSE
#define FALSE 0
#endif

/* Sizes. */

#define SONARS 16
#define INFRAREDS 16
#define MAX_VERTICES 10 /* of an obstacle */
#define BUFSIZE 4096
#define MAX_USER_BUF 65535
#define USER_BUFFER_LENGTH 65535

/* State: the last reported values of the robot. */

#define NUM_STATE 45
#define STATE_SIM_SPEED 0 /* 10 = real time; not on a robot's own line */
#define STATE_IR_0 1      /* 16 infrareds, 0..15, lower is nearer, 15: nothing */
#define STATE_IR_1 2
#define STATE_IR_2 3
#define STATE_IR_3 4
#define STATE_IR_4 5
#define STATE_IR_5 6
#define STATE_IR_6 7
#define STATE_IR_7 8
#define STATE_IR_8 9
#define STATE_IR_9 10
#define STATE_IR_10 11
#define STATE_IR_11 12
#define STATE_IR_12 13
#define STATE_IR_13 14
#define STATE_IR_14 15
#define STATE_IR_15 16
#define STATE_SONAR_0 17 /* 16 sonars, inches from the ring, 255: nothing; number i at turret + 22.5 deg x i */
#define STATE_SONAR_1 18
#define STATE_SONAR_2 19
#define STATE_SONAR_3 20
#define STATE_SONAR_4 21
#define STATE_SONAR_5 22
#define STATE_SONAR_6 23
#define STATE_SONAR_7 24
#define STATE_SONAR_8 25
#define STATE_SONAR_9 26
#define STATE_SONAR_10 27
#define STATE_SONAR_11 28
#define STATE_SONAR_12 29
#define STATE_SONAR_13 30
#define STATE_SONAR_14 31
#define STATE_SONAR_15 32
#define STATE_BUMPER 33 /* one bit per bumper; 0xF00000 at rest on the line of an N200 or N150 */
#define STATE_CONF_X 34
#define STATE_CONF_Y 35
#define STATE_CONF_STEER 36  /* 0..3599 */
#define STATE_CONF_TURRET 37 /* 0..3599 */
#define STATE_VEL_TRANS 38   /* Scout: right wheel */
#define STATE_VEL_STEER 39   /* Scout: left wheel */
#define STATE_VEL_TURRET 40
#define STATE_VEL_RIGHT STATE_VEL_TRANS
#define STATE_VEL_LEFT STATE_VEL_STEER
#define STATE_MOTOR_STATUS 41 /* bits 0 1 2: translation, steering, turret is moving */
#define STATE_LASER 42        /* laser mode */
#define STATE_COMPASS 43
#define STATE_ERROR 44 /* code of the last error reply, 111: no server; 0 after every state from a server */

extern long State[NUM_STATE];

/* Smask: the values that state replies contain; ct sends it. [0] is a sum of POS_ bits, the others are 0 or 1 for the
 * value of State with that number. connect_robot enables everything except position data. */

#define NUM_MASK 44
#define SMASK_POS_DATA 0
#define SMASK_IR_1 1
#define SMASK_IR_2 2
#define SMASK_IR_3 3
#define SMASK_IR_4 4
#define SMASK_IR_5 5
#define SMASK_IR_6 6
#define SMASK_IR_7 7
#define SMASK_IR_8 8
#define SMASK_IR_9 9
#define SMASK_IR_10 10
#define SMASK_IR_11 11
#define SMASK_IR_12 12
#define SMASK_IR_13 13
#define SMASK_IR_14 14
#define SMASK_IR_15 15
#define SMASK_IR_16 16
#define SMASK_SONAR_1 17
#define SMASK_SONAR_2 18
#define SMASK_SONAR_3 19
#define SMASK_SONAR_4 20
#define SMASK_SONAR_5 21
#define SMASK_SONAR_6 22
#define SMASK_SONAR_7 23
#define SMASK_SONAR_8 24
#define SMASK_SONAR_9 25
#define SMASK_SONAR_10 26
#define SMASK_SONAR_11 27
#define SMASK_SONAR_12 28
#define SMASK_SONAR_13 29
#define SMASK_SONAR_14 30
#define SMASK_SONAR_15 31
#define SMASK_SONAR_16 32
#define SMASK_BUMPER 33
#define SMASK_CONF_X 34
#define SMASK_CONF_Y 35
#define SMASK_CONF_STEER 36
#define SMASK_CONF_TURRET 37
#define SMASK_VEL_TRANS 38
#define SMASK_VEL_STEER 39
#define SMASK_VEL_TURRET 40
#define SMASK_RESERVED 41
#define SMASK_LASER 42
#define SMASK_COMPASS 43

extern int Smask[NUM_MASK];

/* Laser: [0] is a count n; then n readings by laser mode: points (x, y), lines (x1, y1, x2, y2) or pixels. */

#define NUM_LASER 482

extern int Laser[2 * NUM_LASER + 1];

/* Copies of these arrays; set_mask sets Smask, which ct sends. init_mask sets Smask to its initial values, init_sensors
 * also sends it. */

extern int get_state(long state[NUM_STATE]);
extern int get_laser(int laser[2 * NUM_LASER + 1]);
extern int get_mask(int mask[NUM_MASK]);
extern int set_mask(int mask[NUM_MASK]);
extern void init_mask(void);
extern int init_sensors(void);

/* The server to connect to. */

extern char SERVER_MACHINE_NAME[80]; /* host or host:port; if empty, NOMAD_ROBOT; else localhost */
extern int SERV_TCP_PORT;            /* its port, 7019 by default, also if a program defines it without a value */

extern int set_server_machine_name(char *name);
extern int set_serv_tcp_port(int port);

/* The robot to which libndirect connects for connect_robot(1), without further arguments. A connection sets CONN_TYPE
 * and the variables of its type to what it uses. -1 and empty texts: the values named DEFAULT_ apply. */

extern int CONN_TYPE;                /* -1: not connected yet, 1: serial port, 2: TCP */
extern char ROBOT_MACHINE_NAME[80];  /* host that serves the robot's line; if empty, a serial port is used */
extern int ROBOT_TCP_PORT;           /* port of that host; if -1, CONN_TCP_PORT */
extern int CONN_TCP_PORT;            /* 65001 */
extern char SERIAL_PORT[40];
extern int SERIAL_BAUD;
extern char NOMAD_SERIAL_PORT[40];   /* other names of these two, used if SERIAL_PORT is empty, SERIAL_BAUD -1 */
extern int NOMAD_SERIAL_BAUD;
extern char DEFAULT_SERIAL_PORT[80]; /* "/dev/ttyS0" */
extern int DEFAULT_SERIAL_BAUD;      /* 38400 */
extern int DEFAULT_ROBOT_MODEL;      /* MODEL_N150 */

#define MODEL_N200 0
#define MODEL_N150 1
#define MODEL_SCOUT 2
#define MODEL_SCOUT2 2

/* Laser calibration, as programs store it; the library does not use it. */

extern double LASER_CALIBRATION[8];
extern double LASER_OFFSET[2];

/* Connecting. connect_robot(1) returns the server's port (libndirect: TRUE), or FALSE; then an existing connection
 * remains. With libndirect connect_robot(1, MODEL_N150, "/dev/ttyUSB0", 38400) or
 * connect_robot(1, MODEL_N200, "host", 65001) gives the connection; libnclient ignores arguments after the number.
 * server_is_running is the old name of connect_robot(1). open_serial connects to a line, only in libndirect. */

extern int connect_robot(long robot_id, ...);
extern int create_robot(long robot_id);
extern int disconnect_robot(long robot_id);
extern int server_is_running(void);
extern int open_serial(char *port, unsigned short baud);
extern int quit_server(void);
extern int real_robot(void);
extern int simulated_robot(void);

/* Pass the number of arguments, by which libndirect distinguishes connect_robot(1) from a call with a line. This is no
 * macro: connect_robot remains usable in prototypes and as the name of a method. */
extern int nomad_connect_robot(long robot_id, int extra_count, ...);
#if defined(__GNUC__) && !defined(__clang__)
extern __inline __attribute__((__gnu_inline__, __always_inline__, __artificial__)) int connect_robot(long robot_id, ...)
{
    return nomad_connect_robot(robot_id, __builtin_va_arg_pack_len(), __builtin_va_arg_pack());
}
#endif

/* Motion. The axes are translation, steering, turret; Scout: right wheel, left wheel, 0. */

#define MV_IGNORE 0 /* modes of mv: axis unchanged */
#define MV_VM 1     /* velocity */
#define MV_PR 2     /* distance */
#define MV_LP 3     /* limp */
#define MV_AC 4     /* set its acceleration */
#define MV_SP 5     /* set its speed */
#define MV_PA 6     /* these three are not sent: mv returns FALSE */
#define MV_TQ 7
#define MV_MT 8

extern int ac(int t_ac, int s_ac, int r_ac);
extern int sp(int t_sp, int s_sp, int r_sp);
extern int pr(int t_pr, int s_pr, int r_pr);
extern int pa(int t_pa, int s_pa, int r_pa); /* only on the line of an N200 */
extern int vm(int t_vm, int s_vm, int r_vm);
extern int mv(int t_mode, int t_mv, int s_mode, int s_mv, int r_mode, int r_mv);
extern int st(void);
extern int lp(void);
extern int zr(void);
extern int ws(unsigned char t_ws, unsigned char s_ws, unsigned char r_ws, unsigned char timeout); /* seconds */
extern int dp(int x, int y);
extern int da(int th, int tu);
extern int place_robot(int x, int y, int th, int tu);

#define ROTATION_CONSTANT 0.118597 /* inches that a Scout's wheel travels for each degree of turn */
#define RIGHT(trans, steer) ((int)(trans) + (int)((steer)*ROTATION_CONSTANT))
#define LEFT(trans, steer) ((int)(trans) - (int)((steer)*ROTATION_CONSTANT))

extern int scout_vm(int trans, int steer);
extern int scout_pr(int trans, int steer);

/* Configuration. */

extern int ct(void);
extern int conf_ir(int history, int order[16]);
extern int conf_sn(int rate, int order[16]); /* rate in steps of 4 ms; 255 ends the order */
extern int conf_cp(int mode);
extern int conf_ls(unsigned int mode, unsigned int threshold, unsigned int width, unsigned int num_data,
                   unsigned int processing);
extern int conf_tm(unsigned char timeout); /* seconds; 0: no time-out */
extern int conf_sg(unsigned int threshold, unsigned int min_points, unsigned int gap);
extern int conf_ser(int port, int baud); /* only on the line of an N150 or Scout */

/* Queries. */

extern int gs(void);
extern int get_ir(void);
extern int get_sn(void);
extern int get_rc(void); /* x, y, steering, turret */
extern int get_rv(void); /* velocities */
extern int get_ra(void); /* accelerations, stored in place of the velocities */
extern int get_cp(void);
extern int get_ls(void);
extern int get_sg(void);
extern int get_bp(void);
extern int get_rpx(long *robot_pos);     /* long[31]: n, then n times x, y, heading; at most ten robots */
extern int get_robot_conf(long *conf);   /* long[4]: x, y, steering, turret of a click in the server's window */

/* Position data: the encoder pose of the robot when a sensor took its reading. */

typedef unsigned long TimeData; /* ms of the robot's clock */

typedef struct ConfigData {
    long configX, configY, configSteer, configTurret;
    long velTrans, velSteer, velTurret;
    TimeData timeStamp; /* of the pose */
} ConfigData;

typedef struct PosData {
    ConfigData config;
    TimeData timeStamp; /* of the reading */
} PosData;

#define POS_IR_1 0 /* numbers of sensors for posInfraredGet and posSonarGet */
#define POS_IR_2 1
#define POS_IR_3 2
#define POS_IR_4 3
#define POS_IR_5 4
#define POS_IR_6 5
#define POS_IR_7 6
#define POS_IR_8 7
#define POS_IR_9 8
#define POS_IR_10 9
#define POS_IR_11 10
#define POS_IR_12 11
#define POS_IR_13 12
#define POS_IR_14 13
#define POS_IR_15 14
#define POS_IR_16 15
#define POS_SONAR_1 0
#define POS_SONAR_2 1
#define POS_SONAR_3 2
#define POS_SONAR_4 3
#define POS_SONAR_5 4
#define POS_SONAR_6 5
#define POS_SONAR_7 6
#define POS_SONAR_8 7
#define POS_SONAR_9 8
#define POS_SONAR_10 9
#define POS_SONAR_11 10
#define POS_SONAR_12 11
#define POS_SONAR_13 12
#define POS_SONAR_14 13
#define POS_SONAR_15 14
#define POS_SONAR_16 15

#define POS_NONE 0
#define POS_INFRARED 1
#define POS_SONAR 2
#define POS_BUMPER 4
#define POS_LASER 8
#define POS_COMPASS 16
#define POS_ALL 31

#define POS_INFRARED_P ((posDataCheck() & POS_INFRARED) ? 1 : 0) /* is this position data requested? */
#define POS_SONAR_P ((posDataCheck() & POS_SONAR) ? 1 : 0)
#define POS_BUMPER_P ((posDataCheck() & POS_BUMPER) ? 1 : 0)
#define POS_LASER_P ((posDataCheck() & POS_LASER) ? 1 : 0)
#define POS_COMPASS_P ((posDataCheck() & POS_COMPASS) ? 1 : 0)

extern int posDataRequest(int posRequest); /* a sum of POS_ bits; FALSE for other values */
extern int posDataCheck(void);
extern int posInfraredRingGet(PosData posData[16]);
extern int posInfraredGet(PosData *posData, int infraredNumber);
extern int posSonarRingGet(PosData posData[16]);
extern int posSonarGet(PosData *posData, int sonarNumber);
extern int posBumperGet(PosData *posData);
extern int posLaserGet(PosData *posData);
extern int posCompassGet(PosData *posData);
extern int posTimeGet(void); /* the last reported clock of the robot in ms */

extern float voltCpuGet(void);
extern float voltMotorGet(void);

/* Speech, user packets, the arm. A packet is length (low byte, high byte; including the four header bytes), serial,
 * type, data; at most 254 bytes, which is also the required size of the receive buffer. */

extern int tk(char *talk);
extern int special_request(unsigned char *user_send_buffer, unsigned char *user_receive_buffer);
extern int arm_zr(short override);
extern int arm_ws(short lift, short grip, long timeout, long *time_remain);
extern int arm_mv(long l_mode, long l_v, long g_mode, long g_v);

#define ARM_ZR 40 /* types of the arm's packets */
#define ARM_WS 41
#define ARM_MV 42
#define ZR_CHECK 1 /* bits of the override of arm_zr */
#define ZR_ORIENT 2
#define ZR_NO_N_GRIPPER 4

/* Packets byte by byte. The functions init_ set `index` to the first byte after the header. The functions stuff store
 * a number at buffer[*index] and advance *index, the functions extract read one; low byte first. They return FALSE
 * beyond MAX_USER_BUF (extract: 0). */

extern int init_send_buffer(unsigned short *index);
extern int init_receive_buffer(unsigned short *index);
extern int stuff_send_buffer_header(unsigned short length, unsigned char serial_number, unsigned char packet_type,
                                    unsigned char *buffer);
extern int extract_receive_buffer_header(unsigned short *length, unsigned char *serial_number,
                                         unsigned char *packet_type, unsigned char *buffer);
extern int stuffchar(signed char data, unsigned char *buffer, unsigned short *index);
extern int stuff2byteint(short data, unsigned char *buffer, unsigned short *index);
extern int stuff4byteint(long data, unsigned char *buffer, unsigned short *index);
extern int stuffuchar(unsigned char data, unsigned char *buffer, unsigned short *index);
extern int stuff2byteuint(unsigned short data, unsigned char *buffer, unsigned short *index);
extern int stuff4byteuint(unsigned long data, unsigned char *buffer, unsigned short *index);
extern int stuffdouble(double data, unsigned char *buffer, unsigned short *index);
extern signed char extractchar(unsigned char *buffer, unsigned short *index);
extern short extract2byteint(unsigned char *buffer, unsigned short *index);
extern long extract4byteint(unsigned char *buffer, unsigned short *index);
extern unsigned char extractuchar(unsigned char *buffer, unsigned short *index);
extern unsigned short extract2byteuint(unsigned char *buffer, unsigned short *index);
extern unsigned long extract4byteuint(unsigned char *buffer, unsigned short *index);
extern double extractdouble(unsigned char *buffer, unsigned short *index);

/* A number and its bytes, and a message of the server's protocol. */

typedef union double_union {
    double data;
    unsigned char bytes[8];
} double_union;

typedef union long_union {
    int data; /* four bytes, also where a long has eight */
    unsigned char bytes[4];
} long_union;

typedef union ulong_union {
    unsigned int data;
    unsigned char bytes[4];
} ulong_union;

typedef union short_union {
    short data;
    unsigned char bytes[2];
} short_union;

typedef union ushort_union {
    unsigned short data;
    unsigned char bytes[2];
} ushort_union;

typedef struct request_struct {
    short type;
    unsigned short size;
    long mesg[USER_BUFFER_LENGTH];
} request_struct;

typedef struct reply_struct {
    short type;
    unsigned short size;
    long mesg[USER_BUFFER_LENGTH];
} reply_struct;

/* World and display, only with an Nserver. obs is long[21]: n, x1, y1 .. xn, yn; n is at most 10. */

extern int add_obstacle(long obs[21]);
extern int delete_obstacle(long obs[21]);
extern int move_obstacle(long obs[21], long dx, long dy); /* obs receives the new position */
extern int new_world(void);
extern int add_Obs(long obs[21]); /* other names of these three */
extern int delete_Obs(long obs[21]);
extern int move_Obs(long obs[21], long dx, long dy);
extern int predict_sensors(int x, int y, int th, int tu, long *state, int *laser); /* laid out as State and Laser */
extern int motion_check(long type, double a1, double a2, double a3, double a4, double a5, double a6, double a7,
                        double collide[3]); /* 1 on a collision: x, y, inward normal in radians */
extern int draw_robot(long x, long y, int th, int tu, int mode);
extern int draw_line(long x_1, long y_1, long x_2, long y_2, int mode);
extern int draw_arc(long x_0, long y_0, long w, long h, int th1, int th2, int mode);
extern int refresh_all(void);
extern int refresh_all_traces(void);
extern int refresh_actual_trace(void);
extern int refresh_encoder_trace(void);
extern int refresh_all_sensors(void);
extern int refresh_bumper_sensor(void);
extern int refresh_infrared_sensor(void);
extern int refresh_sonar_sensor(void);
extern int refresh_laser_sensor(void);
extern int refresh_client_graphics(void);

#ifdef __cplusplus
}
#endif

#endif
