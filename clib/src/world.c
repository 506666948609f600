/* World and display calls, available only with an Nserver: obstacles, predictions, collisions, drawing, other robots.
 */
#include "error.h"
#include "session.h"

#include <string.h>

enum { OBSTACLE = 1 + 2 * MAX_VERTICES };

static const struct reply *send_obstacle(enum command_id id, const long *obs, const long *shift)
{
    long numbers[OBSTACLE + 2];
    int count;

    if (obs[0] < 1 || obs[0] > MAX_VERTICES) {
        nomad_report_error("%s: an obstacle must have 1 to %d vertices, not %ld", nomad_commands[id].name, MAX_VERTICES,
                           obs[0]);
        return NULL;
    }
    count = 1 + 2 * (int)obs[0];
    memcpy(numbers, obs, (size_t)count * sizeof *numbers);
    if (shift) {
        numbers[count++] = shift[0];
        numbers[count++] = shift[1];
    }
    return nomad_request_numbers(id, numbers, count);
}

int add_obstacle(long obs[21]) { return send_obstacle(CMD_ADD_OBSTACLE, obs, NULL) != NULL; }
int delete_obstacle(long obs[21]) { return send_obstacle(CMD_DELETE_OBSTACLE, obs, NULL) != NULL; }
int add_Obs(long obs[21]) { return add_obstacle(obs); }
int delete_Obs(long obs[21]) { return delete_obstacle(obs); }
int move_Obs(long obs[21], long dx, long dy) { return move_obstacle(obs, dx, dy); }
int new_world(void) { return SEND_EMPTY(NEW_WORLD); }

/* Copy n and its n elements of `width` numbers each. Return FALSE if the reply has another number of elements. */
static int copy_list(const struct reply *reply, const char *name, int width, long min, long max, long *to)
{
    long n = reply && reply->count ? reply->values[0] : -1;

    if (reply == NULL)
        return FALSE;
    if (n < min || n > (reply->count - 1) / width || 1 + n * width != reply->count) {
        nomad_report_error("%s: the reply counts %ld elements but has %d numbers", name, n, reply->count);
        return FALSE;
    }
    n = n < max ? n : max;
    to[0] = n;
    memcpy(to + 1, reply->values + 1, (size_t)(n * width) * sizeof *to);
    return TRUE;
}

int move_obstacle(long obs[21], long dx, long dy)
{
    const long shift[2] = {dx, dy};
    const struct reply *reply = send_obstacle(CMD_MOVE_OBSTACLE, obs, shift);

    return copy_list(reply, "move_obstacle", 2, obs[0], obs[0], obs);
}

int get_rpx(long *robot_pos)
{
    return copy_list(nomad_request_numbers(CMD_GET_RPX, NULL, 0), "get_rpx", 3, 0, MAX_ROBOTS, robot_pos);
}

int get_robot_conf(long *conf)
{
    const struct reply *reply = nomad_request_numbers(CMD_GET_ROBOT_CONF, NULL, 0);

    if (reply)
        memcpy(conf, reply->values, (size_t)reply->count * sizeof *conf);
    return reply != NULL;
}

int predict_sensors(int x, int y, int th, int tu, long *state, int *laser)
{
    const struct reply *reply = nomad_request_numbers(CMD_PREDICT_SENSORS, NUMBERS(x, y, th, tu));

    if (reply == NULL || reply->shape != SHAPE_PREDICTION)
        return reply != NULL;
    memcpy(state + STATE_IR_0, reply->values + STATE_IR_0, 32 * sizeof *state);
    memcpy(laser, reply->laser, (size_t)reply->laser_size * sizeof *laser);
    return TRUE;
}

/* Truncate toward zero. A value within 1e-6 of an integer counts as that integer: 0.29 x 100 is below 29 in doubles. */
static long to_scaled(double number, double scale)
{
    double value = number * scale, nearly = value < 0 ? value - 1e-6 : value + 1e-6;

    if (!(nearly > -2147483647.0))
        return -2147483647L;
    return nearly < 2147483647.0 ? (long)nearly : 2147483647L;
}

int motion_check(long type, double a1, double a2, double a3, double a4, double a5, double a6, double a7,
                 double collide[3])
{
    const int is_arc = type == 1;
    const double angle = is_arc ? 1e6 : 100;
    const long numbers[8] = {type,
                             to_scaled(a1, 100),
                             to_scaled(a2, 100),
                             to_scaled(a3, angle),
                             to_scaled(a4, angle),
                             is_arc ? to_scaled(a5, 100) : 0,
                             is_arc ? to_scaled(a6, 100) : 0,
                             is_arc ? to_scaled(a7, 100) : 0};
    const struct reply *reply = nomad_request_numbers(CMD_MOTION_CHECK, numbers, 8);

    if (reply == NULL)
        return FALSE;
    collide[0] = (double)reply->values[1] / 100;
    collide[1] = (double)reply->values[2] / 100;
    collide[2] = (double)reply->values[3] / 1e6;
    return (int)reply->values[0];
}

int draw_robot(long x, long y, int th, int tu, int mode) { return SEND(DRAW_ROBOT, x, y, th, tu, mode); }
int draw_line(long x_1, long y_1, long x_2, long y_2, int mode) { return SEND(DRAW_LINE, x_1, y_1, x_2, y_2, mode); }

int draw_arc(long x_0, long y_0, long w, long h, int th1, int th2, int mode)
{
    return SEND(DRAW_ARC, x_0, y_0, w, h, th1, th2, mode);
}

int refresh_all(void) { return SEND_EMPTY(REFRESH_ALL); }
int refresh_all_traces(void) { return SEND_EMPTY(REFRESH_ALL_TRACES); }
int refresh_actual_trace(void) { return SEND_EMPTY(REFRESH_ACTUAL_TRACE); }
int refresh_encoder_trace(void) { return SEND_EMPTY(REFRESH_ENCODER_TRACE); }
int refresh_all_sensors(void) { return SEND_EMPTY(REFRESH_ALL_SENSORS); }
int refresh_bumper_sensor(void) { return SEND_EMPTY(REFRESH_BUMPER_SENSOR); }
int refresh_infrared_sensor(void) { return SEND_EMPTY(REFRESH_INFRARED_SENSOR); }
int refresh_sonar_sensor(void) { return SEND_EMPTY(REFRESH_SONAR_SENSOR); }
int refresh_laser_sensor(void) { return SEND_EMPTY(REFRESH_LASER_SENSOR); }
int refresh_client_graphics(void) { return SEND_EMPTY(REFRESH_CLIENT_GRAPHICS); }
