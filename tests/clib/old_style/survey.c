/*
 * survey.c -- asks a robot everything there is to ask, and gives it every command once.
 *
 *	survey machine port robot	with a server
 *	survey device			on the robot's line
 *
 * K&R C.  The program has its own State, Smask and Laser, as programs had that were built with a header of their own.
 */
#include <stdio.h>
#include "Nclient.h"

long State[NUM_STATE];
int Smask[NUM_MASK];
int Laser[2*NUM_LASER+1];
char SERVER_MACHINE_NAME[80];
int SERV_TCP_PORT;
double LASER_CALIBRATION[8] = { -0.1, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0 };
double LASER_OFFSET[2];

int order[16] = { 0, 2, 15, 1, 14, 3, 13, 4, 12, 5, 11, 6, 10, 7, 9, 8 };
long obs[2*MAX_VERTICES+1] = { 3, 3000, 3000, 3100, 3000, 3100, 3100 };
long list[31], copy[NUM_STATE];
int maskcopy[NUM_MASK], lasercopy[2*NUM_LASER+1];
int wrong;

check(what, good)
char *what;
int good;
{
	if (!good) {
		printf("%s: error %ld\n", what, State[STATE_ERROR]);
		wrong++;
	}
}

motion()
{
	check("ac", ac(300, 500, 500));
	check("sp", sp(200, 450, 450));
	check("zr", zr());
	check("dp", dp(0, 0));
	check("da", da(0, 0));
	check("pr", pr(50, 0, 0));
	check("ws", ws(1, 1, 1, 20));
	check("moved", State[STATE_CONF_X] == 50);
	check("mv", mv(MV_PR, -50, MV_VM, 0, MV_IGNORE, 0));
	check("ws again", ws(TRUE, TRUE, TRUE, 20));
	check("back", State[STATE_CONF_X] == 0);
	check("mv limits", mv(MV_AC, 300, MV_SP, 450, MV_LP, 0));
	check("mv of other robots", !mv(MV_PA, 0, MV_TQ, 0, MV_MT, 0));
	check("vm", vm(0, 100, 0));
	check("turning", State[STATE_VEL_STEER] != 0);
	check("st", st());
	check("lp", lp());
}

settings(n200)
{
	check("conf_ir", conf_ir(0, order) == n200 || !n200);
	check("conf_sn", conf_sn(15, order));
	check("conf_cp", conf_cp(1) == n200 || !n200);
	check("conf_ls", conf_ls(51, 20, 20, 20, 4) == n200 || !n200);
	check("conf_sg", conf_sg(50, 4, 30) == n200 || !n200);
	check("conf_tm", conf_tm(5));
	(void) conf_ser(1, 9600);
}

questions()
{
	PosData ring[16], one;

	check("gs", gs());
	(void) get_ir();
	check("get_sn", get_sn());
	check("get_rc", get_rc());
	check("get_rv", get_rv());
	check("get_ra", get_ra());
	(void) get_cp();
	(void) get_ls();
	(void) get_sg();
	check("get_bp", get_bp());
	check("get_rc", gs());
	check("sonar", State[STATE_SONAR_0] > 0);
	check("posDataRequest", posDataRequest(POS_ALL));
	check("gs with stamps", gs());
	check("ring", posInfraredRingGet(ring) && posSonarRingGet(ring));
	check("infrared", posInfraredGet(&one, POS_IR_16));
	check("sonar", posSonarGet(&one, POS_SONAR_1));
	check("others", posBumperGet(&one) && posLaserGet(&one) && posCompassGet(&one));
	check("no such sonar", !posSonarGet(&one, 16));
	check("none", posDataRequest(POS_NONE) && posDataCheck() == 0);
	check("clock", posTimeGet() > 0);
	check("volts", voltCpuGet() > 9.0 && voltMotorGet() > 9.0);
	check("get_state", get_state(copy) && copy[STATE_CONF_X] == State[STATE_CONF_X]);
	check("get_laser", get_laser(lasercopy) && lasercopy[0] == Laser[0]);
	check("get_mask", get_mask(maskcopy) && maskcopy[SMASK_COMPASS] == Smask[SMASK_COMPASS]);
	check("set_mask", set_mask(maskcopy));
}

others()
{
	unsigned char out[254], in[254];
	long left;

	/* arms and packets: whatever the robot answers, the program goes on */
	out[0] = 4; out[1] = 0; out[2] = 0; out[3] = 200;
	(void) special_request(out, in);
	(void) arm_zr(ZR_CHECK | ZR_ORIENT);
	(void) arm_mv(0L, 0L, 0L, 0L);
	(void) arm_ws(1, 1, 1L, &left);
	(void) tk("hello");
}

world(first)
{
	double hit[3];

	check("init_sensors", init_sensors());
	check("ct", ct());
	check("pa", !pa(0, 0, 0));
	check("simulated_robot", simulated_robot());
	check("real_robot", real_robot());
	check("add", add_obstacle(obs) && move_obstacle(obs, 10L, 10L) && delete_obstacle(obs));
	check("Obs", add_Obs(obs) && move_Obs(obs, -10L, -10L) && delete_Obs(obs));
	check("predict", predict_sensors(0, 0, 0, 0, copy, lasercopy));
	check("check", motion_check(0L, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, hit) >= 0);
	check("draw", draw_robot(0L, 0L, 0, 0, 1) && draw_line(0L, 0L, 9L, 9L, 1)
		&& draw_arc(0L, 0L, 9L, 9L, 0, 900, 1));
	check("refresh", refresh_all() && refresh_all_traces() && refresh_actual_trace() && refresh_encoder_trace()
		&& refresh_all_sensors() && refresh_bumper_sensor() && refresh_infrared_sensor()
		&& refresh_sonar_sensor() && refresh_laser_sensor() && refresh_client_graphics());
	check("get_rpx", get_rpx(list) && list[0] >= 1);
	check("get_robot_conf", get_robot_conf(list));
	check("place_robot", place_robot((int) list[0], (int) list[1], (int) list[2], (int) list[3]));
	check("quit_server", quit_server());	/* refused, and yet TRUE */
	check("create_robot", create_robot((long) first));
	check("new_world", new_world());
}

main(argc, argv)
char **argv;
{
	int robot;

	check("before", !gs() && State[STATE_ERROR] == 111);
	if (argc > 3) {
		robot = atoi(argv[3]);
		check("names", set_server_machine_name(argv[1]) && set_serv_tcp_port(atoi(argv[2])));
		check("no such robot", !connect_robot(99));
		if (!connect_robot(robot))
			exit(1);
		world(robot);
	} else {
		robot = 1;
		if (!connect_robot(1, MODEL_N150, argv[1], 38400))
			exit(1);
		check("line", CONN_TYPE == 1 && strcmp(SERIAL_PORT, argv[1]) == 0 && SERIAL_BAUD == 38400);
		check("nothing to do", real_robot() && simulated_robot() && create_robot(2) && new_world());
	}
	settings(0);
	motion();
	questions();
	others();
	check("disconnect", disconnect_robot(robot));
	check("gone", !gs() && State[STATE_ERROR] == 111);
	if (!wrong)
		printf("survey ok\n");
	return (wrong);
}
