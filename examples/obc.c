/* The smallest on-board software: prints the samples of a link, and switches off a gyro with a constant count.
 *
 *     cc -I protocol examples/obc.c -o obc
 *     ./obc LINK SAMPLES
 *
 * LINK is a pty or a serial port of `geu run`. protocol/geu.h has the frames, checks and commands. */
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

#include "geu.h"

/* Repeats of a count, larger than the limit cycle gives, from which the gyro is taken as failed. */
enum { STUCK_REPEATS = 3, STUCK_COUNT = 50 };

/* Gyros that are powered. */
static uint8_t powered = GEU_GYRX | GEU_GYRY | GEU_GYRZA | GEU_GYRZB;

static void switch_off(int link, unsigned gyro)
{
    uint8_t command[GEU_COMMAND_MAX_LENGTH], frame[GEU_SERIAL_MAX_FRAME];
    size_t length;
    powered &= (uint8_t)~(1u << gyro);
    length = geu_pack_gyro_power(command, powered);
    length = geu_pack_frame(frame, GEU_SERIAL_COMMAND, command, length);
    if (write(link, frame, length) == (ssize_t)length)
        printf("gyro %u switched off\n", gyro);
}

static void process(int link, const geu_sample *sample)
{
    static int16_t last[4];
    static unsigned repeats[4];
    const int16_t counts[4] = {sample->gyrx, sample->gyry, sample->gyrza, sample->gyrzb};
    unsigned gyro;
    printf("%5u %6d %6d %6d %6d\n", sample->sequence, counts[0], counts[1], counts[2], counts[3]);
    for (gyro = 0; gyro < 4; gyro++) {
        const int is_stuck = counts[gyro] == last[gyro] && abs(counts[gyro]) > STUCK_COUNT;
        repeats[gyro] = is_stuck ? repeats[gyro] + 1 : 0;
        last[gyro] = counts[gyro];
        if (repeats[gyro] == STUCK_REPEATS)
            switch_off(link, gyro);
    }
}

int main(int count, char **arguments)
{
    const int link = count == 3 ? open(arguments[1], O_RDWR | O_NOCTTY) : -1;
    long samples = count == 3 ? atol(arguments[2]) : 0;
    geu_deframer deframer = {0};
    geu_frame frame;
    geu_sample sample;
    uint8_t byte;
    if (link < 0) {
        fprintf(stderr, "usage: obc LINK SAMPLES\n");
        return 2;
    }
    setvbuf(stdout, NULL, _IOLBF, 0);
    while (samples > 0 && read(link, &byte, 1) == 1) {
        geu_deframer_push(&deframer, byte);
        while (geu_deframer_next(&deframer, &frame))
            if (frame.type == GEU_SERIAL_DATA) {
                geu_unpack_data(&sample, frame.payload);
                process(link, &sample);
                samples--;
            }
    }
    close(link);
    return samples > 0;
}
