/* A session with an Nserver (server.c, in libnclient) or with a robot on its own line (direct.c, in libndirect).
 *
 * Each library contains one of the two, and all calls go through these functions. The function that detects a failure
 * reports it. When nomad_transact returns, the reply is already stored in State, Laser and the position data.
 */
#ifndef NOMAD_SESSION_H
#define NOMAD_SESSION_H

#include "message.h"

enum outcome { NO_REPLY, REPLIED, NOT_ACKNOWLEDGED };

/* The arguments of connect_robot after the robot number. */
struct line_arguments {
    int model;
    const char *name; /* device or host */
    int number;       /* baud, or TCP port */
    int count;        /* -1: unknown; the three are random if the call had only the robot number */
};

/* Return the result of connect_robot; `line` is NULL if the call has only the robot number. After a failure an existing
 * connection remains. */
int nomad_connect(enum command_id how, long robot_id, const struct line_arguments *line);
int nomad_open_line(const struct line_arguments *line); /* open_serial; 0: not in this library */
int nomad_disconnect(long robot_id);
int nomad_is_connected(void);

/* Return 1 for a call that a session of this kind does not send and answers with success. */
int nomad_is_ignored(const struct command *command);

/* Return 1 if the robot has a mask that ct sends. */
int nomad_sends_mask(void);

enum outcome nomad_transact(const struct request *request, struct reply *reply);

/* Connect; after success, the next lost connection is reported again. */
int nomad_open_session(enum command_id how, long robot_id, const struct line_arguments *line);

/* Return the reply to a request, or NULL if it failed. The reply is empty after a NAK. */
const struct reply *nomad_request(const struct request *request);
const struct reply *nomad_request_numbers(enum command_id id, const long *numbers, int count);

#define NUMBERS(...) (const long[]){__VA_ARGS__}, (int)(sizeof((const long[]){__VA_ARGS__}) / sizeof(long))
#define SEND(id, ...) (nomad_request_numbers(CMD_##id, NUMBERS(__VA_ARGS__)) != NULL)
#define SEND_EMPTY(id) (nomad_request_numbers(CMD_##id, NULL, 0) != NULL)

/* Return the reply time-out in ms: nomad_timeout_ms if it is set, else the default given. */
int nomad_reply_timeout(int default_ms);

#endif
