/* What a program holds after the replies it has had: State, Laser, stamps, clock, battery. */
#ifndef NOMAD_HELD_H
#define NOMAD_HELD_H

#include "message.h"

/* A new conversation: stamps, clock and battery of the last are forgotten, the mask is set. */
void nomad_begin_holding(const int mask[NUM_MASK]);

/* Take in a reply, whole. */
void nomad_hold(const struct reply *reply);

/* A server's refusal. */
void nomad_hold_error(long code);

/* All on, position data off; and the fixed packet of N150 and Scout. */
extern const int nomad_everything[NUM_MASK];
extern const int nomad_fixed_mask[NUM_MASK];

#endif
