/* Who answers: an Nserver (server.c, libnclient) or a robot on its own line (direct.c, libndirect).
 *
 * Rules: each library has one of the two, and all calls go through these functions. A failure is said on stderr
 * by who knows why. After nomad_answer the reply is held already.
 */
#ifndef NOMAD_CONVERSATION_H
#define NOMAD_CONVERSATION_H

#include "message.h"

#include <stdarg.h>

enum answer { NO_ANSWER, ANSWERED, NOT_ACKNOWLEDGED };

/* What connect_robot gives back. `more`: what stood behind the robot's number; `known`: whether its end can be told. */
int nomad_connect(enum command_id how, long robot_id, va_list *more, int known);
int nomad_disconnect(long robot_id);
int nomad_is_connected(void);
int nomad_is_running(void);

enum answer nomad_answer(const struct request *request, struct reply *reply);

/* What calls.c and its like use. To connect; once that is done, the lack of a connection is worth a word again. */
int nomad_meet(enum command_id how, long robot_id, va_list *more, int known);

/* The reply to a request, NULL where it failed. Of a NAK it has nothing in it. */
const struct reply *nomad_ask(const struct request *request);
const struct reply *nomad_ask_numbers(enum command_id id, const long *numbers, int count);

#define NUMBERS(...) (const long[]){__VA_ARGS__}, (int)(sizeof((const long[]){__VA_ARGS__}) / sizeof(long))
#define SAY(id, ...) (nomad_ask_numbers(CMD_##id, NUMBERS(__VA_ARGS__)) != NULL)
#define SAY_ALONE(id) (nomad_ask_numbers(CMD_##id, NULL, 0) != NULL)

/* Milliseconds that an answer may take which comes at once. */
int nomad_patience(int usual_ms);

#endif
