/* How replies update the variables of Nclient.h, and the calls that only read and write these. */
#include "client_state.h"

#include "error.h"

#include <string.h>

#define SIXTEEN_ON 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1
#define SIXTEEN_OFF 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0
#define FULL_MASK {0, SIXTEEN_ON, SIXTEEN_ON, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1}

const int nomad_full_mask[NUM_MASK] = FULL_MASK;
const int nomad_fixed_mask[NUM_MASK] = {0, SIXTEEN_OFF, SIXTEEN_ON, 1, 1, 1, 1, 1, 1, 1, 1, 0, 0, 1};

static PosData stamps[STAMPS];
static uint32_t clock_ms;
static int volts[2];

void nomad_reset_client_state(const int mask[NUM_MASK])
{
    memcpy(Smask, mask, NUM_MASK * sizeof *mask);
    memset(stamps, 0, sizeof stamps);
    memset(volts, 0, sizeof volts);
    clock_ms = 0;
}

void nomad_apply_reply(const struct reply *reply)
{
    for (int slot = 0; slot < NUM_STATE; slot++)
        if (reply->has_slot[slot])
            State[slot] = reply->slots[slot];
    if (reply->shape != SHAPE_PREDICTION && reply->laser_size)
        memcpy(Laser, reply->laser, (size_t)reply->laser_size * sizeof *Laser);
    for (int k = 0; k < STAMPS; k++)
        if (reply->has_stamp[k])
            stamps[k] = reply->stamps[k];
    if (reply->has_clock)
        clock_ms = reply->clock_ms;
    if (reply->has_volts)
        memcpy(volts, reply->volts, sizeof volts);
}

void nomad_set_error_code(long code) { State[STATE_ERROR] = code; }

/* A program that defines SERV_TCP_PORT without a value has 0 there. */
static void __attribute__((constructor)) set_default_port(void)
{
    if (SERV_TCP_PORT == 0)
        SERV_TCP_PORT = 7019;
}

/* Copies of the arrays */

int get_state(long state[NUM_STATE])
{
    memcpy(state, State, NUM_STATE * sizeof *state);
    return TRUE;
}

int get_laser(int laser[2 * NUM_LASER + 1])
{
    memcpy(laser, Laser, (2 * NUM_LASER + 1) * sizeof *laser);
    return TRUE;
}

int get_mask(int mask[NUM_MASK])
{
    memcpy(mask, Smask, NUM_MASK * sizeof *mask);
    return TRUE;
}

int set_mask(int mask[NUM_MASK])
{
    memcpy(Smask, mask, NUM_MASK * sizeof *mask);
    return TRUE;
}

void init_mask(void) { memcpy(Smask, nomad_full_mask, sizeof nomad_full_mask); }

int set_server_machine_name(char *name)
{
    if (strlen(name) >= sizeof SERVER_MACHINE_NAME) {
        nomad_report_error("set_server_machine_name: the name may have at most %d characters",
                           (int)sizeof SERVER_MACHINE_NAME - 1);
        return FALSE;
    }
    memcpy(SERVER_MACHINE_NAME, name, strlen(name) + 1);
    return TRUE;
}

int set_serv_tcp_port(int port)
{
    SERV_TCP_PORT = port;
    return TRUE;
}

/* Position data, clock, battery */

static int copy_stamp(PosData *to, int first, int number, int count)
{
    if (number < 0 || number >= count) {
        nomad_report_error("there is no sensor with number %d", number);
        return FALSE;
    }
    *to = stamps[first + number];
    return TRUE;
}

int posDataCheck(void) { return Smask[SMASK_POS_DATA]; }
int posInfraredGet(PosData *posData, int infraredNumber) { return copy_stamp(posData, 0, infraredNumber, 16); }
int posSonarGet(PosData *posData, int sonarNumber) { return copy_stamp(posData, STAMP_SONAR, sonarNumber, 16); }
int posBumperGet(PosData *posData) { return copy_stamp(posData, STAMP_BUMPER, 0, 1); }
int posLaserGet(PosData *posData) { return copy_stamp(posData, STAMP_LASER, 0, 1); }
int posCompassGet(PosData *posData) { return copy_stamp(posData, STAMP_COMPASS, 0, 1); }

int posInfraredRingGet(PosData posData[16])
{
    memcpy(posData, stamps, 16 * sizeof *stamps);
    return TRUE;
}

int posSonarRingGet(PosData posData[16])
{
    memcpy(posData, stamps + STAMP_SONAR, 16 * sizeof *stamps);
    return TRUE;
}

int posTimeGet(void) { return (int)nomad_signed_word(clock_ms); }

/* The voltage is (2 + 3 raw / 255) x range / 5. */
static float to_volts(int raw, double range) { return (float)((2 + 3 * raw / 255.0) * range / 5); }

float voltCpuGet(void) { return to_volts(volts[0], 12.0); }
float voltMotorGet(void) { return to_volts(volts[1], 12.85); }
