/* Reads calls from stdin, one per line, and prints the result and the client state after each as JSON.
 *
 *     replay PORT                     libnclient, a server on this machine
 *     replay MODEL DEVICE CONN        libndirect, as connect_robot(1, MODEL, DEVICE, CONN)
 */
#include "Nclient.h"
#include "nomad.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static char line[4096];
static long a[64];
static int argument_count;
static long predicted_laser[7];
static int predicted_count; /* number of values; 0: no prediction */
static const char *extra_name;
static double extra[64];
static int extra_count;

static void print_longs(const char *name, const long *values, int count)
{
    printf(", \"%s\": [", name);
    for (int k = 0; k < count; k++)
        printf("%s%ld", k ? ", " : "", values[k]);
    printf("]");
}

static void print_stamp(const char *name, const PosData *at)
{
    long values[9];

    memcpy(values, at, sizeof values); /* a PosData consists of nine numbers */
    print_longs(name, values, 9);
}

static void print_state(int returned)
{
    PosData at, ring[16];
    long laser[7];

    for (int k = 0; k < 7; k++)
        laser[k] = Laser[k];
    printf("{\"return\": %d, \"pos\": %d, \"time\": %d, \"volt_cpu\": %.6f, \"volt_motor\": %.6f", returned,
           posDataCheck(), posTimeGet(), voltCpuGet(), voltMotorGet());
    print_longs("State", State, NUM_STATE);
    print_longs("Laser", laser, 7);
    posSonarGet(&at, 0);
    print_stamp("pos_sonar_0", &at);
    posSonarRingGet(ring);
    print_stamp("pos_sonar_15", &ring[15]);
    posInfraredGet(&at, 0);
    print_stamp("pos_ir_0", &at);
    posInfraredRingGet(ring);
    print_stamp("pos_ir_15", &ring[15]);
    posBumperGet(&at);
    print_stamp("pos_bumper", &at);
    posLaserGet(&at);
    print_stamp("pos_laser", &at);
    posCompassGet(&at);
    print_stamp("pos_compass", &at);
    if (extra_name) {
        printf(", \"%s\": [", extra_name);
        for (int k = 0; k < extra_count; k++)
            printf("%s%.12g", k ? ", " : "", extra[k]);
        printf("]");
    }
    if (predicted_count)
        print_longs("pred_laser", predicted_laser, predicted_count);
    printf(", \"error\": \"%s\"}\n", nomad_last_error());
    fflush(stdout);
}

static void set_extra(const char *name, const long *values, int count)
{
    extra_name = name;
    extra_count = count;
    for (int k = 0; k < count; k++)
        extra[k] = (double)values[k];
}

static void read_numbers(char *text)
{
    char *end;

    memset(a, 0, sizeof a);
    for (argument_count = 0; argument_count < 64; argument_count++, text = end) {
        a[argument_count] = strtol(text, &end, 10);
        if (end == text)
            break;
    }
}

static int with_order(int (*function)(int, int *))
{
    int order[16];

    for (int k = 0; k < 16; k++)
        order[k] = (int)a[k + 1];
    return function((int)a[0], order);
}

static int is_list(const char *name)
{
    static const char *const LISTS[] = {"get_rpx",         "get_robot_conf", "add_obstacle",
                                        "delete_obstacle", "move_obstacle",  "sim_truth"};

    for (size_t k = 0; k < sizeof LISTS / sizeof *LISTS; k++)
        if (strcmp(name, LISTS[k]) == 0)
            return 1;
    return 0;
}

static int call_list(const char *name)
{
    long list[40] = {0};
    int returned;

    if (strcmp(name, "get_rpx") == 0)
        returned = get_rpx(list);
    else if (strcmp(name, "get_robot_conf") == 0)
        returned = get_robot_conf(list);
    else if (strcmp(name, "sim_truth") == 0)
        returned = nomad_sim_truth(list);
    else {
        memcpy(list, a, 21 * sizeof *list);
        returned = strcmp(name, "add_obstacle") == 0      ? add_obstacle(list)
                   : strcmp(name, "delete_obstacle") == 0 ? delete_obstacle(list)
                                                          : move_obstacle(list, a[argument_count - 2],
                                                                          a[argument_count - 1]);
    }
    set_extra("obs", list, 31);
    return returned;
}

static int call_held_by(void)
{
    const char *name = nomad_held_by();
    long bytes[31] = {0};

    for (int k = 0; k < 31 && name[k]; k++)
        bytes[k] = name[k];
    set_extra("obs", bytes, 31);
    return TRUE;
}

static int call_prediction(void)
{
    long state[NUM_STATE] = {0};
    int laser[2 * NUM_LASER + 1] = {0};
    int returned = predict_sensors((int)a[0], (int)a[1], (int)a[2], (int)a[3], state, laser);

    set_extra("pred_state", state, NUM_STATE);
    predicted_count = 7;
    for (int k = 0; k < predicted_count; k++)
        predicted_laser[k] = laser[k];
    return returned;
}

static int call_motion_check(void)
{
    double c[3] = {0, 0, 0};
    int returned = motion_check(a[0], (double)a[1] / 1000, (double)a[2] / 1000, (double)a[3] / 1000,
                                (double)a[4] / 1000, (double)a[5] / 1000, (double)a[6] / 1000, (double)a[7] / 1000, c);

    extra_name = "collide";
    extra_count = 3;
    memcpy(extra, c, sizeof c);
    return returned;
}

static int call_special(void)
{
    unsigned char sent[300] = {0}, received[254] = {0};
    long bytes[32];
    int returned;

    sent[0] = (unsigned char)(4 + argument_count);
    sent[1] = (unsigned char)((4 + argument_count) >> 8);
    sent[3] = 200; /* the packet type used in the recordings */
    for (int k = 0; k < argument_count; k++)
        sent[4 + k] = (unsigned char)a[k];
    returned = special_request(sent, received);
    for (int k = 0; k < 32; k++)
        bytes[k] = received[k];
    set_extra("special", bytes, 32);
    return returned;
}

static int call_arm_ws(void)
{
    long remaining = 0;
    int returned = arm_ws((int)a[0], (int)a[1], a[2], &remaining);

    set_extra("remain", &remaining, 1);
    return returned;
}

static int call_mask(void)
{
    for (int k = 0; k < NUM_MASK; k++)
        Smask[k] = (int)a[k];
    return ct();
}

#define PLAIN(function) {#function, function}

static const struct {
    const char *name;
    int (*function)(void);
} PLAIN_CALLS[] = {
    PLAIN(server_is_running),
    PLAIN(quit_server),
    PLAIN(real_robot),
    PLAIN(simulated_robot),
    PLAIN(st),
    PLAIN(lp),
    PLAIN(zr),
    PLAIN(ct),
    PLAIN(gs),
    PLAIN(get_ir),
    PLAIN(get_sn),
    PLAIN(get_rc),
    PLAIN(get_rv),
    PLAIN(get_ra),
    PLAIN(get_cp),
    PLAIN(get_ls),
    PLAIN(get_sg),
    PLAIN(get_bp),
    PLAIN(new_world),
    PLAIN(refresh_all),
    PLAIN(refresh_all_traces),
    PLAIN(refresh_actual_trace),
    PLAIN(refresh_encoder_trace),
    PLAIN(refresh_all_sensors),
    PLAIN(refresh_bumper_sensor),
    PLAIN(refresh_infrared_sensor),
    PLAIN(refresh_sonar_sensor),
    PLAIN(refresh_laser_sensor),
    PLAIN(refresh_client_graphics),
};

#define I(k) ((int)a[k])
#define CALL(function, ...) \
    if (strcmp(name, #function) == 0) \
        return function(__VA_ARGS__)

static int call(const char *name, char *rest, char **words, int count)
{
    if (strcmp(name, "connect_robot") == 0)
        return count == 4 ? connect_robot(a[0], atoi(words[1]), words[2], atoi(words[3])) : connect_robot(a[0]);
    if (strcmp(name, "tk") == 0)
        return tk(rest);
    if (strcmp(name, "mask") == 0)
        return call_mask();
    if (is_list(name))
        return call_list(name);
    if (strcmp(name, "predict_sensors") == 0)
        return call_prediction();
    if (strcmp(name, "motion_check") == 0)
        return call_motion_check();
    if (strcmp(name, "held_by") == 0)
        return call_held_by();
    if (strcmp(name, "special_request") == 0)
        return call_special();
    if (strcmp(name, "arm_ws") == 0)
        return call_arm_ws();
    if (strcmp(name, "conf_ir") == 0)
        return with_order(conf_ir);
    if (strcmp(name, "conf_sn") == 0)
        return with_order(conf_sn);
    for (size_t k = 0; k < sizeof PLAIN_CALLS / sizeof *PLAIN_CALLS; k++)
        if (strcmp(name, PLAIN_CALLS[k].name) == 0)
            return PLAIN_CALLS[k].function();
    CALL(create_robot, a[0]);
    CALL(disconnect_robot, a[0]);
    CALL(ac, I(0), I(1), I(2));
    CALL(sp, I(0), I(1), I(2));
    CALL(pr, I(0), I(1), I(2));
    CALL(pa, I(0), I(1), I(2));
    CALL(vm, I(0), I(1), I(2));
    CALL(mv, I(0), I(1), I(2), I(3), I(4), I(5));
    CALL(ws, I(0), I(1), I(2), I(3));
    CALL(dp, I(0), I(1));
    CALL(da, I(0), I(1));
    CALL(place_robot, I(0), I(1), I(2), I(3));
    CALL(scout_vm, I(0), I(1));
    CALL(scout_pr, I(0), I(1));
    CALL(conf_cp, I(0));
    CALL(conf_ls, I(0), I(1), I(2), I(3), I(4));
    CALL(conf_tm, I(0));
    CALL(conf_sg, I(0), I(1), I(2));
    CALL(conf_ser, I(0), I(1));
    CALL(posDataRequest, I(0));
    CALL(arm_zr, I(0));
    CALL(arm_mv, a[0], a[1], a[2], a[3]);
    CALL(draw_robot, a[0], a[1], I(2), I(3), I(4));
    CALL(draw_line, a[0], a[1], a[2], a[3], I(4));
    CALL(draw_arc, a[0], a[1], a[2], a[3], I(4), I(5), I(6));
    if (strcmp(name, "sim_control") == 0)
        return nomad_sim_control(I(0), I(1));
    fprintf(stderr, "no call %s\n", name);
    exit(2);
}

int main(int count, char **words)
{
    if (count == 2) {
        strcpy(SERVER_MACHINE_NAME, "127.0.0.1");
        SERV_TCP_PORT = atoi(words[1]);
    }
    if (getenv("REPLAY_TIMEOUT_MS"))
        nomad_timeout_ms = atoi(getenv("REPLAY_TIMEOUT_MS"));
    while (fgets(line, sizeof line, stdin)) {
        char *rest;

        line[strcspn(line, "\n")] = '\0';
        rest = strchr(line, ' ');
        rest = rest ? (*rest = '\0', rest + 1) : line + strlen(line);
        read_numbers(rest);
        extra_name = NULL;
        predicted_count = 0;
        print_state(call(line, rest, words, count));
    }
    return 0;
}
