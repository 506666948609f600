/* Mutates recorded replies and decodes them, built with sanitizers.
 *
 *     fuzz SEED COUNT < corpus        one line per reply: protocol (T or L), command, model, laser mode, laser width,
 *                                     position bits, 43 mask digits, bytes in hex
 *
 * Prints how many replies were decoded and how many rejected. A decoded reply must stay within its buffers.
 */
#include "client_state.h"
#include "serial_framing.h"
#include "message.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { MAX_CASES = 400, MAX_BYTES = 8192 };

struct sample {
    int on_line;
    enum command_id command;
    struct wire_state wire;
    unsigned char *bytes;
    size_t size;
};

static struct sample samples[MAX_CASES];
static int sample_count;
static uint32_t seed;

static uint32_t random_below(uint32_t below)
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

        if (scanf("%3s %31s %d %d %d %d %63s %32767s", language, name, &at->wire.model, &at->wire.laser_mode,
                  &at->wire.laser_width, &position, mask, hex)
            != 8)
            return;
        at->on_line = language[0] == 'L';
        at->command = command_named(name);
        at->wire.mask[0] = position;
        for (int k = 1; k < NUM_MASK; k++)
            at->wire.mask[k] = mask[k - 1] == '1';
        at->size = (strlen(hex) - 1) / 2; /* after a dot, because a reply may be empty */
        at->bytes = malloc(at->size + 1);
        for (size_t k = 0; k < at->size; k++) {
            unsigned byte;
            sscanf(hex + 1 + 2 * k, "%2x", &byte);
            at->bytes[k] = (unsigned char)byte;
        }
        sample_count++;
    }
}

/* Return a mutated copy, allocated with its exact size so that sanitizers detect reads beyond it; the caller frees it.
 */
static unsigned char *mutated(const struct sample *from, size_t *size)
{
    static const unsigned char EDGES[] = {0x00, 0x01, 0x5C, 0x7F, 0x80, 0xFF};
    size_t grown = from->size + (random_below(4) == 0 ? random_below(64) : 0),
           cut = random_below(4) == 0 ? random_below(16) : 0;
    unsigned char *copy;

    *size = grown > cut ? grown - cut : 0;
    copy = malloc(*size ? *size : 1);
    for (size_t k = 0; k < *size; k++)
        copy[k] = k < from->size ? from->bytes[k] : (unsigned char)random_below(256);
    for (uint32_t times = random_below(6); times > 0 && *size; times--)
        copy[random_below((uint32_t)*size)] =
            random_below(2) ? EDGES[random_below(sizeof EDGES)] : (unsigned char)random_below(256);
    return copy;
}

static void check(int truth, const char *what)
{
    if (!truth) {
        fprintf(stderr, "failed: %s\n", what);
        abort();
    }
}

static int read_one(const struct sample *sample, const unsigned char *bytes, size_t size)
{
    static struct reply reply;
    const struct command *command = &nomad_commands[sample->command];
    int good = sample->on_line ? nomad_decode_serial_reply(command->line_reply, bytes, size, &sample->wire, &reply)
                               : nomad_decode_tcp_reply(command->tcp_reply, bytes, size, &sample->wire, &reply);

    if (!good)
        return 0;
    check(reply.laser_size >= 0 && reply.laser_size <= 2 * NUM_LASER + 1, "a laser fits Laser");
    check(!reply.laser_size || (reply.laser[0] >= 0 && reply.laser[0] < reply.laser_size + (reply.laser[0] == 0)),
          "Laser[0] counts what is there");
    check(reply.count >= 0 && reply.count <= MAX_VALUES, "values fit");
    check(!sample->on_line || !(reply.has_slot[0] || reply.has_slot[42] || reply.has_slot[44]),
          "a line leaves State[0], [42], [44] alone");
    nomad_apply_reply(&reply);
    return 1;
}

/* Send a frame in parts after random bytes: exactly this frame must be found. */
static void frame_stream(const struct sample *sample)
{
    static struct serial_buffer frames;
    static struct serial_frame frame;
    unsigned char whole[MAX_BYTES];
    size_t size = sample->size + MIN_FRAME, noise = random_below(40), sent = 0;
    int found = 0;

    whole[0] = FRAME_START;
    whole[1] = (unsigned char)((sample->size + 2) & 0xFF);
    whole[2] = (unsigned char)((sample->size + 2) >> 8);
    whole[3] = (unsigned char)nomad_commands[sample->command].line_type;
    memcpy(whole + 4, sample->bytes, sample->size);
    whole[size - 2] = (unsigned char)nomad_checksum(whole, size - 2);
    whole[size - 1] = FRAME_END;
    frames.held = 0;
    for (size_t k = 0; k < noise; k++)
        frames.bytes[frames.held++] = (unsigned char)random_below(256);
    while (nomad_next_frame(&frames, &frame)) /* random bytes are a valid frame once in 2^32 */
        ;
    while (sent < size) {
        size_t part = 1 + random_below((uint32_t)(size - sent));
        check(nomad_free_space(&frames) >= part, "there is free space for another frame");
        memcpy(frames.bytes + frames.held, whole + sent, part);
        frames.held += part;
        sent += part;
        found += nomad_next_frame(&frames, &frame);
    }
    while (!found && nomad_skip_byte(&frames))
        found += nomad_next_frame(&frames, &frame);
    check(found == 1, "the frame after the random bytes is found");
    check(frame.size == sample->size && memcmp(frame.data, sample->bytes, frame.size) == 0,
          "the frame has the expected data");
}

int main(int count, char **words)
{
    long good = 0, times = count > 2 ? atol(words[2]) : 0;

    seed = count > 1 ? (uint32_t)strtoul(words[1], NULL, 10) : 1;
    read_corpus();
    check(sample_count > 0, "the corpus is not empty");
    for (int k = 0; k < sample_count; k++)
        check(read_one(&samples[k], samples[k].bytes, samples[k].size), "a recorded reply is decoded");
    for (long k = 0; k < times; k++) {
        const struct sample *sample = &samples[random_below((uint32_t)sample_count)];
        size_t size;
        unsigned char *bytes = mutated(sample, &size);

        good += read_one(sample, bytes, size);
        free(bytes);
        if (sample->on_line)
            frame_stream(sample);
    }
    printf("%d recorded, %ld mutated: %ld decoded, %ld rejected\n", sample_count, times, good, times - good);
    for (int k = 0; k < sample_count; k++)
        free(samples[k].bytes);
    return 0;
}
