/* Motion, configuration, questions: the calls of Nclient.h that are a request of numbers and an answer in State. */
#include "complain.h"
#include "conversation.h"
#include "nomad.h"

#include <string.h>

/* Connecting */

int nomad_connect_robot(long robot_id, ...)
{
    va_list more;
    int connected;

    va_start(more, robot_id);
    connected = nomad_meet(CMD_CONNECT_ROBOT, robot_id, &more, 1);
    va_end(more);
    return connected;
}

#undef connect_robot
int connect_robot(long robot_id, ...)
{
    va_list more;
    int connected;

    va_start(more, robot_id);
    connected = nomad_meet(CMD_CONNECT_ROBOT, robot_id, &more, 0);
    va_end(more);
    return connected;
}

int create_robot(long robot_id) { return nomad_meet(CMD_CREATE_ROBOT, robot_id, NULL, 1); }
int disconnect_robot(long robot_id) { return nomad_disconnect(robot_id); }
int server_is_running(void) { return nomad_is_running(); }
int quit_server(void) { return SAY_ALONE(QUIT_SERVER); }
int real_robot(void) { return SAY_ALONE(REAL_ROBOT); }
int simulated_robot(void) { return SAY_ALONE(SIMULATED_ROBOT); }

/* Motion */

int ac(int t_ac, int s_ac, int r_ac) { return SAY(AC, t_ac, s_ac, r_ac); }
int sp(int t_sp, int s_sp, int r_sp) { return SAY(SP, t_sp, s_sp, r_sp); }
int pr(int t_pr, int s_pr, int r_pr) { return SAY(PR, t_pr, s_pr, r_pr); }
int pa(int t_pa, int s_pa, int r_pa) { return SAY(PA, t_pa, s_pa, r_pa); }
int vm(int t_vm, int s_vm, int r_vm) { return SAY(VM, t_vm, s_vm, r_vm); }

static int is_refused(int mode)
{
    return mode >= 6 && mode <= 8;
}

int mv(int t_mode, int t_mv, int s_mode, int s_mv, int r_mode, int r_mv)
{
    if (is_refused(t_mode) || is_refused(s_mode) || is_refused(r_mode)) {
        nomad_complain("mv: modes 6, 7 and 8 are not sent");
        return FALSE;
    }
    return SAY(MV, t_mode, t_mv, s_mode, s_mv, r_mode, r_mv);
}

int scout_vm(int trans, int steer) { return vm(RIGHT(trans, steer), LEFT(trans, steer), 0); }
int scout_pr(int trans, int steer) { return pr(RIGHT(trans, steer), LEFT(trans, steer), 0); }
int st(void) { return SAY_ALONE(ST); }
int lp(void) { return SAY_ALONE(LP); }
int zr(void) { return SAY_ALONE(ZR); }
int ws(int t_ws, int s_ws, int r_ws, int timeout) { return SAY(WS, t_ws, s_ws, r_ws, timeout < 0 ? 0 : timeout); }
int dp(int x, int y) { return SAY(DP, x, y); }
int da(int th, int tu) { return SAY(DA, th, tu); }
int place_robot(int x, int y, int th, int tu) { return SAY(PLACE_ROBOT, x, y, th, tu); }

/* Configuration */

int ct(void)
{
    struct request request = {0};

    if (Smask[SMASK_POS_DATA] < 0 || Smask[SMASK_POS_DATA] > POS_ALL) {
        nomad_complain("ct: Smask[0] is %d, and no sum of 1, 2, 4, 8, 16", Smask[SMASK_POS_DATA]);
        return FALSE;
    }
    request.command = &nomad_commands[CMD_CT];
    memcpy(request.mask, Smask, sizeof request.mask);
    return nomad_ask(&request) != NULL;
}

static int send_order(enum command_id id, int first, const int order[16])
{
    long numbers[17] = {first};

    for (int k = 0; k < 16; k++)
        numbers[1 + k] = order[k];
    return nomad_ask_numbers(id, numbers, 17) != NULL;
}

int conf_ir(int history, int order[16]) { return send_order(CMD_CONF_IR, history, order); }
int conf_sn(int rate, int order[16]) { return send_order(CMD_CONF_SN, rate, order); }

/* A robot on its own line answers with three scores, a server with its state. */
int conf_cp(int mode)
{
    const struct reply *reply = nomad_ask_numbers(CMD_CONF_CP, NUMBERS(mode));

    if (reply && reply->shape == SHAPE_CALIBRATION)
        nomad_remark("compass calibration score x: %ld y: %ld z: %ld", reply->values[0], reply->values[1],
                     reply->values[2]);
    return reply != NULL;
}

int conf_ls(int mode, int threshold, int width, int num_data, int processing)
{
    return SAY(CONF_LS, mode, threshold, width, num_data, processing);
}

int conf_tm(int timeout) { return SAY(CONF_TM, timeout); }
int conf_sg(int threshold, int min_points, int gap) { return SAY(CONF_SG, threshold, min_points, gap); }
int conf_ser(int port, int baud) { return SAY(CONF_SER, port, baud); }

int posDataRequest(int posRequest)
{
    if (posRequest < 0 || posRequest > POS_ALL) {
        nomad_complain("posDataRequest: %d is no sum of 1, 2, 4, 8, 16", posRequest);
        return FALSE;
    }
    Smask[SMASK_POS_DATA] = posRequest;
    return ct();
}

/* Questions */

int gs(void) { return SAY_ALONE(GS); }
int get_ir(void) { return SAY_ALONE(GET_IR); }
int get_sn(void) { return SAY_ALONE(GET_SN); }
int get_rc(void) { return SAY_ALONE(GET_RC); }
int get_rv(void) { return SAY_ALONE(GET_RV); }
int get_ra(void) { return SAY_ALONE(GET_RA); }
int get_cp(void) { return SAY_ALONE(GET_CP); }
int get_ls(void) { return SAY_ALONE(GET_LS); }
int get_sg(void) { return SAY_ALONE(GET_SG); }
int get_bp(void) { return SAY_ALONE(GET_BP); }

/* Our own simulation */

int nomad_sim_control(int verb, int value) { return SAY(SIM_CONTROL, verb, value); }

int nomad_sim_truth(long truth[8])
{
    const struct reply *reply = nomad_ask_numbers(CMD_SIM_TRUTH, NULL, 0);

    if (reply)
        memcpy(truth, reply->values, (size_t)reply->count * sizeof *truth);
    return reply != NULL;
}
