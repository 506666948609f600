/* Mutates recorded replies and has the library read them, in a process that sanitizers watch.
 *
 *     fuzz SEED COUNT < corpus        a line: language (T or L), command, model, laser mode, laser width, position
 *                                     bits, 43 mask digits, bytes in hex
 *
 * It says how many were read and how many refused. A reply that is read must hold no more than fits.
 */
#include "held.h"
#include "line_frames.h"
#include "message.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { MAX_CASES = 400, MAX_BYTES = 8192 };

struct sample {
    int on_line;
    enum command_id command;
    struct terms terms;
    unsigned char *bytes;
    size_t size;
};

static struct sample samples[MAX_CASES];
static int sample_count;
static uint32_t seed;

static uint32_t chance(uint32_t below)
{
    seed ^= seed << 13;
    seed ^= seed >> 17;
    seed ^= seed << 5;
    return seed % below;
}

static enum command_id command_named(const char *name)
{
    for (int k = 0; k < CMD_COUNT; k++)
        if (strcmp(nomad_commands[k].name, name) == 0)
            return (enum command_id)k;
    fprintf(stderr, "no command %s\n", name);
    exit(2);
}

static void read_corpus(void)
{
    static char hex[4 * MAX_BYTES];
    char language[4], name[32], mask[64];
    int position;

    while (sample_count < MAX_CASES) {
        struct sample *at = &samples[sample_count];

        if (scanf("%3s %31s %d %d %d %d %63s %32767s", language, name, &at->terms.model, &at->terms.laser_mode,
                  &at->terms.laser_width, &position, mask, hex) != 8)
            return;
        at->on_line = language[0] == 'L';
        at->command = command_named(name);
        at->terms.mask[0] = position;
        for (int k = 1; k < NUM_MASK; k++)
            at->terms.mask[k] = mask[k - 1] == '1';
        at->size = (strlen(hex) - 1) / 2; /* a dot stands before it, as a reply may be empty */
        at->bytes = malloc(at->size + 1);
        for (size_t k = 0; k < at->size; k++) {
            unsigned byte;
            sscanf(hex + 1 + 2 * k, "%2x", &byte);
            at->bytes[k] = (unsigned char)byte;
        }
        sample_count++;
    }
}

/* A copy in memory of its exact size, so that a byte read beyond is seen; the caller frees it. */
static unsigned char *mutated(const struct sample *from, size_t *size)
{
    static const unsigned char EDGES[] = {0x00, 0x01, 0x5C, 0x7F, 0x80, 0xFF};
    size_t grown = from->size + (chance(4) == 0 ? chance(64) : 0), cut = chance(4) == 0 ? chance(16) : 0;
    unsigned char *copy;

    *size = grown > cut ? grown - cut : 0;
    copy = malloc(*size ? *size : 1);
    for (size_t k = 0; k < *size; k++)
        copy[k] = k < from->size ? from->bytes[k] : (unsigned char)chance(256);
    for (uint32_t times = chance(6); times > 0 && *size; times--)
        copy[chance((uint32_t)*size)] = chance(2) ? EDGES[chance(sizeof EDGES)] : (unsigned char)chance(256);
    return copy;
}

static void must(int truth, const char *what)
{
    if (!truth) {
        fprintf(stderr, "not so: %s\n", what);
        abort();
    }
}

static int read_one(const struct sample *sample, const unsigned char *bytes, size_t size)
{
    static struct reply reply;
    const struct command *command = &nomad_commands[sample->command];
    int good = sample->on_line ? nomad_read_line_reply(command->line_reply, bytes, size, &sample->terms, &reply)
                               : nomad_read_tcp_reply(command->tcp_reply, bytes, size, &sample->terms, &reply);

    if (!good)
        return 0;
    must(reply.laser_size >= 0 && reply.laser_size <= 2 * NUM_LASER + 1, "a laser fits Laser");
    must(!reply.laser_size || (reply.laser[0] >= 0 && reply.laser[0] < reply.laser_size + (reply.laser[0] == 0)),
         "Laser[0] counts what is there");
    must(reply.count >= 0 && reply.count <= MAX_VALUES, "values fit");
    must(!sample->on_line || !(reply.has_slot[0] || reply.has_slot[42] || reply.has_slot[44]),
         "a line leaves State[0], [42], [44] alone");
    nomad_hold(&reply);
    return 1;
}

/* Whole frames among rubbish and pieces, as a line delivers them: none may be lost, none made up. */
static void frame_stream(const struct sample *sample)
{
    static struct line_frames frames;
    static struct line_frame frame;
    unsigned char whole[MAX_BYTES];
    size_t size = sample->size + SMALLEST_FRAME, rubbish = chance(40), sent = 0;
    int found = 0;

    whole[0] = FRAME_START;
    whole[1] = (unsigned char)((sample->size + 2) & 0xFF);
    whole[2] = (unsigned char)((sample->size + 2) >> 8);
    whole[3] = (unsigned char)nomad_commands[sample->command].line_type;
    memcpy(whole + 4, sample->bytes, sample->size);
    whole[size - 2] = (unsigned char)nomad_checksum(whole, size - 2);
    whole[size - 1] = FRAME_END;
    frames.held = 0;
    for (size_t k = 0; k < rubbish; k++)
        frames.bytes[frames.held++] = (unsigned char)chance(256);
    while (nomad_take_frame(&frames, &frame)) /* six bytes of chance may be a frame: 1 in 2^32 */
        ;
    while (sent < size) {
        size_t piece = 1 + chance((uint32_t)(size - sent));
        must(nomad_room(&frames) >= piece, "there is room for a frame behind what is held");
        memcpy(frames.bytes + frames.held, whole + sent, piece);
        frames.held += piece;
        sent += piece;
        found += nomad_take_frame(&frames, &frame);
    }
    while (!found && nomad_give_up(&frames))
        found += nomad_take_frame(&frames, &frame);
    must(found == 1, "the frame behind the rubbish is found");
    must(frame.size == sample->size && memcmp(frame.data, sample->bytes, frame.size) == 0, "and it is that one");
}

int main(int count, char **words)
{
    long good = 0, times = count > 2 ? atol(words[2]) : 0;

    seed = count > 1 ? (uint32_t)strtoul(words[1], NULL, 10) : 1;
    read_corpus();
    must(sample_count > 0, "there is a corpus");
    for (int k = 0; k < sample_count; k++)
        must(read_one(&samples[k], samples[k].bytes, samples[k].size), "what was recorded is read");
    for (long k = 0; k < times; k++) {
        const struct sample *sample = &samples[chance((uint32_t)sample_count)];
        size_t size;
        unsigned char *bytes = mutated(sample, &size);

        good += read_one(sample, bytes, size);
        free(bytes);
        if (sample->on_line)
            frame_stream(sample);
    }
    printf("%d recorded, %ld mutated: %ld read, %ld refused\n", sample_count, times, good, times - good);
    for (int k = 0; k < sample_count; k++)
        free(samples[k].bytes);
    return 0;
}
