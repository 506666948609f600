/* Motion, configuration and query calls of Nclient.h: a request of numbers, with the reply stored in State. */
#include "error.h"
#include "session.h"
#include "nomad.h"

#include <stdarg.h>
#include <string.h>

/* Connecting */

/* Read the arguments after the robot number; `count` is -1 if their number is unknown. */
static int connect_to(long robot_id, int count, va_list *extra)
{
    struct line_arguments line = {.count = count};

    if (count == 0 || count == 1 || count == 2)
        return nomad_open_session(CMD_CONNECT_ROBOT, robot_id, count ? &line : NULL);
    line.model = va_arg(*extra, int);
    line.name = va_arg(*extra, const char *);
    line.number = va_arg(*extra, int);
    return nomad_open_session(CMD_CONNECT_ROBOT, robot_id, &line);
}

int nomad_connect_robot(long robot_id, int extra_count, ...)
{
    va_list extra;
    int connected;

    va_start(extra, extra_count);
    connected = connect_to(robot_id, extra_count, &extra);
    va_end(extra);
    return connected;
}

/* Called by programs that do not include Nclient.h, and by those of other compilers than gcc. */
int connect_robot(long robot_id, ...)
{
    va_list extra;
    int connected;

    va_start(extra, robot_id);
    connected = connect_to(robot_id, -1, &extra);
    va_end(extra);
    return connected;
}

int open_serial(char *port, unsigned short baud)
{
    const struct line_arguments line = {DEFAULT_ROBOT_MODEL, port, baud, 3};
    return nomad_open_line(&line);
}

int create_robot(long robot_id) { return nomad_open_session(CMD_CREATE_ROBOT, robot_id, NULL); }
int disconnect_robot(long robot_id) { return nomad_disconnect(robot_id); }
int server_is_running(void) { return nomad_open_session(CMD_CONNECT_ROBOT, 1, NULL); }
int quit_server(void) { return SEND_EMPTY(QUIT_SERVER); }
int real_robot(void) { return SEND_EMPTY(REAL_ROBOT); }
int simulated_robot(void) { return SEND_EMPTY(SIMULATED_ROBOT); }

/* Motion */

int ac(int t_ac, int s_ac, int r_ac) { return SEND(AC, t_ac, s_ac, r_ac); }
int sp(int t_sp, int s_sp, int r_sp) { return SEND(SP, t_sp, s_sp, r_sp); }
int pr(int t_pr, int s_pr, int r_pr) { return SEND(PR, t_pr, s_pr, r_pr); }
int pa(int t_pa, int s_pa, int r_pa) { return SEND(PA, t_pa, s_pa, r_pa); }
int vm(int t_vm, int s_vm, int r_vm) { return SEND(VM, t_vm, s_vm, r_vm); }

static int is_invalid(int mode) { return mode >= 6 && mode <= 8; }

int mv(int t_mode, int t_mv, int s_mode, int s_mv, int r_mode, int r_mv)
{
    if (is_invalid(t_mode) || is_invalid(s_mode) || is_invalid(r_mode)) {
        nomad_report_error("mv: modes 6, 7 and 8 are not sent");
        return FALSE;
    }
    return SEND(MV, t_mode, t_mv, s_mode, s_mv, r_mode, r_mv);
}

int scout_vm(int trans, int steer) { return vm(RIGHT(trans, steer), LEFT(trans, steer), 0); }
int scout_pr(int trans, int steer) { return pr(RIGHT(trans, steer), LEFT(trans, steer), 0); }
int st(void) { return SEND_EMPTY(ST); }
int lp(void) { return SEND_EMPTY(LP); }
int zr(void) { return SEND_EMPTY(ZR); }

int ws(unsigned char t_ws, unsigned char s_ws, unsigned char r_ws, unsigned char timeout)
{
    return SEND(WS, t_ws, s_ws, r_ws, timeout);
}

int dp(int x, int y) { return SEND(DP, x, y); }
int da(int th, int tu) { return SEND(DA, th, tu); }
int place_robot(int x, int y, int th, int tu) { return SEND(PLACE_ROBOT, x, y, th, tu); }

/* Configuration */

int ct(void)
{
    struct request request = {0};

    if (Smask[SMASK_POS_DATA] < 0 || Smask[SMASK_POS_DATA] > POS_ALL) {
        nomad_report_error("ct: Smask[0] is %d, which is not a sum of 1, 2, 4, 8, 16", Smask[SMASK_POS_DATA]);
        return FALSE;
    }
    request.command = &nomad_commands[CMD_CT];
    get_mask(request.mask);
    return nomad_request(&request) != NULL;
}

int init_sensors(void)
{
    init_mask();
    return ct();
}

static int send_order(enum command_id id, int first, const int order[16])
{
    long numbers[17] = {first};

    for (int k = 0; k < 16; k++)
        numbers[1 + k] = order[k];
    return nomad_request_numbers(id, numbers, 17) != NULL;
}

int conf_ir(int history, int order[16]) { return send_order(CMD_CONF_IR, history, order); }
int conf_sn(int rate, int order[16]) { return send_order(CMD_CONF_SN, rate, order); }

/* A robot on its own line replies with three scores, a server with its state. */
int conf_cp(int mode)
{
    const struct reply *reply = nomad_request_numbers(CMD_CONF_CP, NUMBERS(mode));

    if (reply && reply->shape == SHAPE_CALIBRATION)
        nomad_print("compass calibration score x: %ld y: %ld z: %ld", reply->values[0], reply->values[1],
                    reply->values[2]);
    return reply != NULL;
}

int conf_ls(unsigned int mode, unsigned int threshold, unsigned int width, unsigned int num_data,
            unsigned int processing)
{
    return SEND(CONF_LS, (int)mode, (int)threshold, (int)width, (int)num_data, (int)processing);
}

int conf_tm(unsigned char timeout) { return SEND(CONF_TM, timeout); }

int conf_sg(unsigned int threshold, unsigned int min_points, unsigned int gap)
{
    return SEND(CONF_SG, (int)threshold, (int)min_points, (int)gap);
}

int conf_ser(int port, int baud) { return SEND(CONF_SER, port, baud); }

int posDataRequest(int posRequest)
{
    if (posRequest < 0 || posRequest > POS_ALL) {
        nomad_report_error("posDataRequest: %d is not a sum of 1, 2, 4, 8, 16", posRequest);
        return FALSE;
    }
    if (!nomad_sends_mask()) /* the line of an N150 or Scout has no position data */
        return TRUE;
    Smask[SMASK_POS_DATA] = posRequest;
    return ct();
}

/* Queries */

int gs(void) { return SEND_EMPTY(GS); }
int get_ir(void) { return SEND_EMPTY(GET_IR); }
int get_sn(void) { return SEND_EMPTY(GET_SN); }
int get_rc(void) { return SEND_EMPTY(GET_RC); }
int get_rv(void) { return SEND_EMPTY(GET_RV); }
int get_ra(void) { return SEND_EMPTY(GET_RA); }
int get_cp(void) { return SEND_EMPTY(GET_CP); }
int get_ls(void) { return SEND_EMPTY(GET_LS); }
int get_sg(void) { return SEND_EMPTY(GET_SG); }
int get_bp(void) { return SEND_EMPTY(GET_BP); }

/* Commands of this project's simulator only */

int nomad_sim_control(int verb, int value) { return SEND(SIM_CONTROL, verb, value); }

const char *nomad_held_by(void)
{
    static char name[201];
    const struct reply *reply = nomad_request_numbers(CMD_HELD_BY, NULL, 0);
    size_t count = reply && reply->count > 0 ? (size_t)reply->count - 1 : 0, k;

    /* The number of bytes, then the bytes. */
    for (k = 0; k < count && k < sizeof name - 1; k++)
        name[k] = (char)reply->values[1 + k];
    name[k] = '\0';
    return name;
}

int nomad_sim_truth(long truth[8])
{
    const struct reply *reply = nomad_request_numbers(CMD_SIM_TRUTH, NULL, 0);

    if (reply)
        memcpy(truth, reply->values, (size_t)reply->count * sizeof *truth);
    return reply != NULL;
}
