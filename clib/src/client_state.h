/* Data from the replies received so far: State, Laser, position data, clock, battery. */
#ifndef NOMAD_CLIENT_STATE_H
#define NOMAD_CLIENT_STATE_H

#include "message.h"

/* Start a new session: clear position data, clock and battery, and set the mask. */
void nomad_reset_client_state(const int mask[NUM_MASK]);

/* Store all values of a reply. */
void nomad_apply_reply(const struct reply *reply);

/* State[STATE_ERROR] without a connection; the value that programs of the time compared with. */
enum { NO_SERVER = 111 };

/* Store the code of a server's error reply in State. */
void nomad_set_error_code(long code);

/* The mask with everything except position data, and the fixed mask of N150 and Scout. */
extern const int nomad_full_mask[NUM_MASK];
extern const int nomad_fixed_mask[NUM_MASK];

#endif
