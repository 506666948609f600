/*
 * packets.c -- numbers in user packets, and the structures of messages.  ANSI C, no robot.
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include "Nclient.h"

unsigned char out[BUFSIZE], in[BUFSIZE];

static void check(int line, int good)
{
	if (!good) {
		printf("packets.c:%d is wrong\n", line);
		exit(1);
	}
}

#define CHECK(what) check(__LINE__, what)

int main(void)
{
	unsigned short at, length;
	unsigned char serial, type;
	double_union d;
	long_union l;
	ulong_union ul;
	short_union s;
	ushort_union us;
	request_struct *request;
	struct reply_struct *reply;
	PosData where;
	ConfigData config;
	TimeData when;

	CHECK(init_send_buffer(&at) && at == 4);
	CHECK(stuffchar(-2, out, &at));
	CHECK(stuff2byteint(-300, out, &at));
	CHECK(stuff4byteint(-70000L, out, &at));
	CHECK(stuffuchar(200, out, &at));
	CHECK(stuff2byteuint(60000, out, &at));
	CHECK(stuff4byteuint(4000000000UL, out, &at));
	CHECK(stuffdouble(-1.5, out, &at));
	CHECK(at == 26 && out[5] == 0xd4 && out[6] == 0xfe);
	CHECK(stuff_send_buffer_header(at, 7, 200, out));
	CHECK(out[0] == 26 && out[1] == 0 && out[2] == 7 && out[3] == 200);

	memcpy(in, out, at);
	CHECK(init_receive_buffer(&at) && at == 4);
	CHECK(extract_receive_buffer_header(&length, &serial, &type, in));
	CHECK(length == 26 && serial == 7 && type == 200);
	CHECK(extractchar(in, &at) == -2);
	CHECK(extract2byteint(in, &at) == -300);
	CHECK(extract4byteint(in, &at) == -70000L);
	CHECK(extractuchar(in, &at) == 200);
	CHECK(extract2byteuint(in, &at) == 60000);
	CHECK(extract4byteuint(in, &at) == 4000000000UL);
	CHECK(extractdouble(in, &at) == -1.5 && at == 26);
	at = MAX_USER_BUF - 1;
	CHECK(!stuff2byteint(1, out, &at) && extract2byteint(in, &at) == 0 && at == MAX_USER_BUF - 1);

	CHECK(sizeof d == 8 && sizeof l == 4 && sizeof ul == 4 && sizeof s == 2 && sizeof us == 2);
	request = (request_struct *) malloc(sizeof(request_struct));
	reply = (struct reply_struct *) malloc(sizeof(struct reply_struct));
	CHECK(request != NULL && reply != NULL);
	request->type = 15;
	request->size = USER_BUFFER_LENGTH;
	request->mesg[USER_BUFFER_LENGTH - 1] = reply->type = (short) request->type;
	reply->size = request->size;
	reply->mesg[0] = request->mesg[USER_BUFFER_LENGTH - 1];
	CHECK(reply->mesg[0] == 15 && reply->size == 65535);
	free(request);
	free(reply);

	memset(&where, 0, sizeof where);
	config = where.config;
	when = where.timeStamp;
	CHECK(config.configX + config.configY + config.configSteer + config.configTurret + (long) when == 0);
	CHECK(sizeof(PosData) == 9 * sizeof(long));
	printf("packets ok\n");
	return 0;
}
