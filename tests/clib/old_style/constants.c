/*
 * constants.c -- the numbers that programs were compiled with, and where things are in State and Smask.
 *
 * ANSI C, no robot.  Exit status: the number of constants that are wrong.
 */
#include <stdio.h>
#include <string.h>
#include "Nclient.h"

static int wrong = 0;

static void want(const char *name, long value, long expected)
{
	if (value != expected) {
		printf("%s is %ld, not %ld\n", name, value, expected);
		wrong++;
	}
}

#define WANT(name, value) want(#name, (long) (name), (long) (value))

static void rings(void)
{
	static const int ir[] = { STATE_IR_0, STATE_IR_1, STATE_IR_2, STATE_IR_3, STATE_IR_4, STATE_IR_5, STATE_IR_6,
		STATE_IR_7, STATE_IR_8, STATE_IR_9, STATE_IR_10, STATE_IR_11, STATE_IR_12, STATE_IR_13, STATE_IR_14,
		STATE_IR_15 };
	static const int sonar[] = { STATE_SONAR_0, STATE_SONAR_1, STATE_SONAR_2, STATE_SONAR_3, STATE_SONAR_4,
		STATE_SONAR_5, STATE_SONAR_6, STATE_SONAR_7, STATE_SONAR_8, STATE_SONAR_9, STATE_SONAR_10,
		STATE_SONAR_11, STATE_SONAR_12, STATE_SONAR_13, STATE_SONAR_14, STATE_SONAR_15 };
	static const int mask_ir[] = { SMASK_IR_1, SMASK_IR_2, SMASK_IR_3, SMASK_IR_4, SMASK_IR_5, SMASK_IR_6,
		SMASK_IR_7, SMASK_IR_8, SMASK_IR_9, SMASK_IR_10, SMASK_IR_11, SMASK_IR_12, SMASK_IR_13, SMASK_IR_14,
		SMASK_IR_15, SMASK_IR_16 };
	static const int mask_sonar[] = { SMASK_SONAR_1, SMASK_SONAR_2, SMASK_SONAR_3, SMASK_SONAR_4, SMASK_SONAR_5,
		SMASK_SONAR_6, SMASK_SONAR_7, SMASK_SONAR_8, SMASK_SONAR_9, SMASK_SONAR_10, SMASK_SONAR_11,
		SMASK_SONAR_12, SMASK_SONAR_13, SMASK_SONAR_14, SMASK_SONAR_15, SMASK_SONAR_16 };
	static const int pos_ir[] = { POS_IR_1, POS_IR_2, POS_IR_3, POS_IR_4, POS_IR_5, POS_IR_6, POS_IR_7, POS_IR_8,
		POS_IR_9, POS_IR_10, POS_IR_11, POS_IR_12, POS_IR_13, POS_IR_14, POS_IR_15, POS_IR_16 };
	static const int pos_sonar[] = { POS_SONAR_1, POS_SONAR_2, POS_SONAR_3, POS_SONAR_4, POS_SONAR_5, POS_SONAR_6,
		POS_SONAR_7, POS_SONAR_8, POS_SONAR_9, POS_SONAR_10, POS_SONAR_11, POS_SONAR_12, POS_SONAR_13,
		POS_SONAR_14, POS_SONAR_15, POS_SONAR_16 };
	int i;

	for (i = 0; i < INFRAREDS; i++) {
		want("infrared", ir[i], 1 + i);
		want("infrared mask", mask_ir[i], 1 + i);
		want("infrared position", pos_ir[i], i);
	}
	for (i = 0; i < SONARS; i++) {
		want("sonar", sonar[i], 17 + i);
		want("sonar mask", mask_sonar[i], 17 + i);
		want("sonar position", pos_sonar[i], i);
	}
}

static void slots(void)
{
	WANT(STATE_SIM_SPEED, 0);
	WANT(STATE_BUMPER, 33);
	WANT(STATE_CONF_X, 34);
	WANT(STATE_CONF_Y, 35);
	WANT(STATE_CONF_STEER, 36);
	WANT(STATE_CONF_TURRET, 37);
	WANT(STATE_VEL_TRANS, 38);
	WANT(STATE_VEL_STEER, 39);
	WANT(STATE_VEL_TURRET, 40);
	WANT(STATE_VEL_RIGHT, 38);
	WANT(STATE_VEL_LEFT, 39);
	WANT(STATE_MOTOR_STATUS, 41);
	WANT(STATE_LASER, 42);
	WANT(STATE_COMPASS, 43);
	WANT(STATE_ERROR, 44);
	WANT(SMASK_POS_DATA, 0);
	WANT(SMASK_BUMPER, 33);
	WANT(SMASK_CONF_X, 34);
	WANT(SMASK_CONF_Y, 35);
	WANT(SMASK_CONF_STEER, 36);
	WANT(SMASK_CONF_TURRET, 37);
	WANT(SMASK_VEL_TRANS, 38);
	WANT(SMASK_VEL_STEER, 39);
	WANT(SMASK_VEL_TURRET, 40);
	WANT(SMASK_RESERVED, 41);
	WANT(SMASK_LASER, 42);
	WANT(SMASK_COMPASS, 43);
}

static void values(void)
{
	WANT(TRUE, 1);
	WANT(FALSE, 0);
	WANT(NUM_STATE, 45);
	WANT(NUM_MASK, 44);
	WANT(NUM_LASER, 482);
	WANT(SONARS, 16);
	WANT(INFRAREDS, 16);
	WANT(MAX_VERTICES, 10);
	WANT(BUFSIZE, 4096);
	WANT(MAX_USER_BUF, 65535);
	WANT(USER_BUFFER_LENGTH, 65535);
	WANT(MODEL_N200, 0);
	WANT(MODEL_N150, 1);
	WANT(MODEL_SCOUT, 2);
	WANT(MODEL_SCOUT2, 2);
	WANT(MV_IGNORE, 0);
	WANT(MV_VM, 1);
	WANT(MV_PR, 2);
	WANT(MV_LP, 3);
	WANT(MV_AC, 4);
	WANT(MV_SP, 5);
	WANT(MV_PA, 6);
	WANT(MV_TQ, 7);
	WANT(MV_MT, 8);
	WANT(ARM_ZR, 40);
	WANT(ARM_WS, 41);
	WANT(ARM_MV, 42);
	WANT(ZR_CHECK, 1);
	WANT(ZR_ORIENT, 2);
	WANT(ZR_NO_N_GRIPPER, 4);
	WANT(POS_NONE, 0);
	WANT(POS_INFRARED, 1);
	WANT(POS_SONAR, 2);
	WANT(POS_BUMPER, 4);
	WANT(POS_LASER, 8);
	WANT(POS_COMPASS, 16);
	WANT(POS_ALL, 31);
	WANT(1000000 * ROTATION_CONSTANT, 118597);
	WANT(RIGHT(100, -450), 47);
	WANT(LEFT(100, -450), 153);
}

/* what the variables hold when a program starts */
static void start(void)
{
	int i;

	WANT(strlen(SERVER_MACHINE_NAME), 0);
	WANT(SERV_TCP_PORT, 7019);
	WANT(strlen(ROBOT_MACHINE_NAME), 0);
	WANT(sizeof(ROBOT_MACHINE_NAME), 80);
	WANT(strlen(SERIAL_PORT), 0);
	WANT(sizeof(SERIAL_PORT), 40);
	WANT(strlen(NOMAD_SERIAL_PORT), 0);
	WANT(CONN_TYPE, -1);
	WANT(SERIAL_BAUD, -1);
	WANT(NOMAD_SERIAL_BAUD, -1);
	WANT(ROBOT_TCP_PORT, -1);
	WANT(sizeof(LASER_CALIBRATION), 8 * sizeof(double));
	WANT(sizeof(LASER_OFFSET), 2 * sizeof(double));
	WANT(sizeof(State), 45 * sizeof(long));
	WANT(sizeof(Laser), 965 * sizeof(int));
	for (i = 1; i < NUM_MASK; i++)
		want("Smask", Smask[i], 1);
	WANT(posDataCheck(), 0);
	WANT(POS_INFRARED_P + POS_SONAR_P + POS_BUMPER_P + POS_LASER_P + POS_COMPASS_P, 0);
	Smask[SMASK_POS_DATA] = POS_SONAR + POS_LASER;
	WANT(POS_INFRARED_P, 0);
	WANT(POS_SONAR_P, 1);
	WANT(POS_BUMPER_P, 0);
	WANT(POS_LASER_P, 1);
	WANT(POS_COMPASS_P, 0);
	/* programs did that: one behind the end */
	i = NUM_MASK;
	Smask[i] = 1;
	init_mask();
	WANT(Smask[SMASK_POS_DATA], 0);
	WANT(CONN_TYPE, -1);
}

int main(void)
{
	rings();
	slots();
	values();
	start();
	printf("constants %s\n", wrong ? "differ" : "ok");
	return wrong;
}
