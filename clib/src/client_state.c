/* The globals of Nclient.h, how replies update them, and the calls that only read stored data. */
#include "client_state.h"

#include "error.h"

#include <string.h>

long State[NUM_STATE];
int Laser[2 * NUM_LASER + 1];
char SERVER_MACHINE_NAME[80] = "";
int SERV_TCP_PORT = 7019;
char ROBOT_MACHINE_NAME[80] = "";
int CONN_TCP_PORT = 65001;
char DEFAULT_SERIAL_PORT[80] = "/dev/ttyS0";
int DEFAULT_SERIAL_BAUD = 38400;
int DEFAULT_ROBOT_MODEL = MODEL_N150;

#define SIXTEEN_ON 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1
#define SIXTEEN_OFF 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0
#define FULL_MASK {0, SIXTEEN_ON, SIXTEEN_ON, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1}

int Smask[NUM_MASK] = FULL_MASK;
const int nomad_full_mask[NUM_MASK] = FULL_MASK;
const int nomad_fixed_mask[NUM_MASK] = {0, SIXTEEN_OFF, SIXTEEN_ON, 1, 1, 1, 1, 1, 1, 1, 1, 0, 0, 1};

static PosData stamps[STAMPS];
static uint32_t clock_ms;
static int volts[2];

void nomad_reset_client_state(const int mask[NUM_MASK])
{
    memcpy(Smask, mask, sizeof Smask);
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
