/* Checks geu.h with the vectors of the interface control document, both ways. Prints what is wrong. */
#include "geu.h"

#include <stdio.h>
#include <string.h>

static int failures;

static void check(int good, const char *what)
{
    if (!good) {
        printf("%s\n", what);
        failures++;
    }
}

static const uint8_t increments[8] = {0xFF, 0xFE, 0xFF, 0xFE, 0x00, 0x05, 0x00, 0x05};
static const uint8_t status[8] = {0x00, 0x00, 0x0F, 0x07, 0x08, 0x10, 0xDD, 0x5E};
static const uint8_t clock_data[8] = {0x00, 0x00, 0x00, 0x07, 0xA1, 0x20, 0x1B, 0x58};
static const uint8_t serial[28] = {0xEB, 0x90, 0x01, 0x16, 0x00, 0x00, 0xFF, 0xFE, 0xFF, 0xFE, 0x00, 0x05, 0x00, 0x05,
                                   0x0F, 0x07, 0x08, 0x10, 0x00, 0x00, 0x00, 0x07, 0xA1, 0x20, 0x1B, 0x58, 0xF4, 0xC5};

static void vectors(void)
{
    geu_sample h;
    uint8_t a[8], b[8], payload[GEU_DATA_LENGTH], frame[GEU_SERIAL_MAX_FRAME];
    const uint8_t digits[9] = {'1', '2', '3', '4', '5', '6', '7', '8', '9'};
    uint8_t wrong[8];

    check(geu_crc(GEU_CRC_INIT, digits, sizeof digits) == 0x29B1u, "the published check value of the CRC");
    memset(&h, 0, sizeof h);
    check(geu_unpack_increments_and_status(&h, increments, status), "INCREMENTS and STATUS belong together");
    geu_unpack_clock(&h, clock_data);
    check(h.gyrx == -2 && h.gyry == -2 && h.gyrza == 5 && h.gyrzb == 5, "increments");
    check(h.sequence == 0 && h.gyro_flags == 0x0F && h.unit_flags == 0x07, "sequence and flags");
    check((h.gyro_flags & GEU_GYRZB_VALID) && !(h.gyro_flags & GEU_GYRX_SATURATED), "masks of the gyro flags");
    check((h.unit_flags & GEU_CLOCK_LOCKED) && !(h.unit_flags & GEU_POLLED), "masks of the unit flags");
    check(h.electronics_centi_c == 2064 && h.sensor_centi_c == 7000, "temperatures");
    check(h.clock_count == GEU_CLOCK_PER_SAMPLE, "clock count");

    geu_pack_increments_and_status(&h, a, b);
    check(!memcmp(a, increments, 8) && !memcmp(b, status, 8), "INCREMENTS and STATUS packed");
    geu_pack_clock(&h, a);
    check(!memcmp(a, clock_data, 8), "CLOCK packed");
    geu_pack_data(&h, payload);
    check(geu_pack_frame(frame, GEU_SERIAL_DATA, payload, sizeof payload) == 28 && !memcmp(frame, serial, 28),
          "DATA frame");
    check(geu_pack_frame(frame, GEU_SERIAL_DATA, payload, 21) == 0, "a DATA payload that is too short is refused");

    memcpy(wrong, status, 8);
    wrong[0] ^= 1;
    h.sequence = 7;
    check(!geu_unpack_increments_and_status(&h, increments, wrong) && h.sequence == 7, "a wrong CRC is refused");
}

static void commands(void)
{
    uint8_t data[8], frame[GEU_SERIAL_MAX_FRAME], gyros = 0, samples = 0, major = 9, minor = 9;
    const uint8_t self_test[5] = {0x04, 0x03, 0xFF, 0x9C, 0x14};
    const uint8_t ping_frame[7] = {0xEB, 0x90, 0x10, 0x01, 0x01, 0x4F, 0x13};
    const uint8_t pong[4] = {0x01, 0x00, 0x01, 0x00};
    int16_t counts = 0;
    geu_reply reply;
    size_t length = geu_pack_self_test(data, GEU_GYRX | GEU_GYRY, -100, 20);

    check(length == 5 && !memcmp(data, self_test, 5), "SELF_TEST packed");
    check(geu_unpack_self_test(data, 5, &gyros, &counts, &samples) == GEU_RESULT_DONE && gyros == 3
              && counts == -100 && samples == 20, "SELF_TEST unpacked");
    check(geu_unpack_self_test(data, 4, &gyros, &counts, &samples) == GEU_RESULT_BAD_ARGUMENT, "a cut SELF_TEST");
    geu_pack_self_test(data, 16, 0, 1);
    check(geu_unpack_self_test(data, 5, &gyros, &counts, &samples) == GEU_RESULT_BAD_ARGUMENT, "a mask of 16");
    length = geu_pack_ping(data);
    check(length == 1, "PING packed");
    length = geu_pack_frame(frame, GEU_SERIAL_COMMAND, data, length);
    check(length == 7 && !memcmp(frame, ping_frame, 5), "PING frame");
    check(geu_get_u16(frame + 5) == geu_crc(GEU_CRC_INIT, frame + 2, 3), "CRC of the PING frame");
    check(geu_unpack_reply(&reply, pong, 4) && reply.opcode == GEU_OPCODE_PING, "REPLY unpacked");
    check(geu_unpack_ping_values(&reply, &major, &minor) && major == GEU_LINK_VERSION_MAJOR
              && minor == GEU_LINK_VERSION_MINOR, "values of PING");
    check(geu_pack_reply(&reply, data) == 4 && !memcmp(data, pong, 4), "REPLY packed");
    check(!geu_unpack_reply(&reply, pong, 1), "a REPLY of one byte is refused");
}

static void hunting(void)
{
    /* Noise that begins like a DATA frame and swallows two good frames, then the frame of the document. */
    uint8_t line[128], data[8];
    size_t length = 0, at;
    int frames = 0, last_is_data = 0;
    geu_deframer deframer;
    geu_frame frame;

    line[length++] = 0xEB;
    line[length++] = 0x90;
    line[length++] = GEU_SERIAL_DATA;
    line[length++] = GEU_DATA_LENGTH;
    length += geu_pack_frame(line + length, GEU_SERIAL_COMMAND, data, geu_pack_ping(data));
    length += geu_pack_frame(line + length, GEU_SERIAL_COMMAND, data, geu_pack_heater(data, 1));
    line[length++] = 0xEB;
    memcpy(line + length, serial, sizeof serial);
    length += sizeof serial;

    memset(&deframer, 0, sizeof deframer);
    for (at = 0; at < length; at++) {
        geu_deframer_push(&deframer, line[at]);
        while (geu_deframer_next(&deframer, &frame)) {
            frames++;
            last_is_data = frame.type == GEU_SERIAL_DATA && !memcmp(frame.payload, serial + 4, GEU_DATA_LENGTH);
        }
    }
    check(frames == 3 && last_is_data, "no good frame behind noise is lost");
    check(deframer.skipped == 5 && deframer.used == 0, "every byte is accounted for");
}

int main(void)
{
    vectors();
    commands();
    hunting();
    return failures != 0;
}
