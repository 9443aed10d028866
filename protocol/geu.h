/* Link of the gyro electronics unit, for on-board software. Generated: geu describe header. Do not edit.
 *
 * Header only, C99 and C++, no allocation, no state but what the caller passes. Numbers on the wire are big-endian.
 * CAN: classic, 11-bit identifiers, each GEU_CAN_… is relative to the base. Serial: EB 90 | type | length | payload |
 * CRC over type, length and payload; 8N1. */
#ifndef GEU_H
#define GEU_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

#ifdef __cplusplus
extern "C" {
#endif

#define GEU_LINK_VERSION_MAJOR 1u
#define GEU_LINK_VERSION_MINOR 0u

#define GEU_CLOCK_PER_SAMPLE 500000u

#define GEU_CAN_BASE_DEFAULT 0x1A0u
#define GEU_CAN_INCREMENTS 0u
#define GEU_CAN_STATUS 1u
#define GEU_CAN_CLOCK 2u
#define GEU_CAN_COMMAND 8u
#define GEU_CAN_REPLY 9u

#define GEU_INCREMENTS_LENGTH 8u
#define GEU_STATUS_LENGTH 8u
#define GEU_CLOCK_LENGTH 8u
#define GEU_DATA_LENGTH 22u
#define GEU_COMMAND_MIN_LENGTH 1u
#define GEU_COMMAND_MAX_LENGTH 8u
#define GEU_REPLY_MIN_LENGTH 2u
#define GEU_REPLY_MAX_LENGTH 8u

#define GEU_SERIAL_SYNC_0 0xEBu
#define GEU_SERIAL_SYNC_1 0x90u
#define GEU_SERIAL_DATA 0x01u
#define GEU_SERIAL_COMMAND 0x10u
#define GEU_SERIAL_REPLY 0x11u
#define GEU_SERIAL_MAX_PAYLOAD 22u
#define GEU_SERIAL_MAX_FRAME 28u
#define GEU_SERIAL_DEFAULT_BAUD 115200u

/* Masks of the gyros in commands. */
#define GEU_GYRX 0x01u
#define GEU_GYRY 0x02u
#define GEU_GYRZA 0x04u
#define GEU_GYRZB 0x08u

/* Bits of gyro_flags. */
#define GEU_GYRX_VALID 0x01u /* GYRX runs, is spun up and its increment is a measurement */
#define GEU_GYRY_VALID 0x02u /* GYRY runs, is spun up and its increment is a measurement */
#define GEU_GYRZA_VALID 0x04u /* GYRZA runs, is spun up and its increment is a measurement */
#define GEU_GYRZB_VALID 0x08u /* GYRZB runs, is spun up and its increment is a measurement */
#define GEU_GYRX_SATURATED 0x10u /* GYRX increment was clipped to 16 bits */
#define GEU_GYRY_SATURATED 0x20u /* GYRY increment was clipped to 16 bits */
#define GEU_GYRZA_SATURATED 0x40u /* GYRZA increment was clipped to 16 bits */
#define GEU_GYRZB_SATURATED 0x80u /* GYRZB increment was clipped to 16 bits */

/* Bits of unit_flags. */
#define GEU_HEATER_IN_BAND 0x01u /* sensor heater in 70 +- 1 degC */
#define GEU_MOTORS_SYNCHRONOUS 0x02u /* spin motor of every powered gyro synchronous */
#define GEU_CLOCK_LOCKED 0x04u /* clock locked */
#define GEU_SELF_TEST 0x08u /* self-test running */
#define GEU_POLLED 0x10u /* polled mode */

typedef enum {
    GEU_OPCODE_PING = 0x01, /* asks for the link version */
    GEU_OPCODE_SET_MODE = 0x02, /* chooses whether data are sent each sample or when polled */
    GEU_OPCODE_POLL = 0x03, /* polled mode only: the last completed sample's messages follow the REPLY */
    GEU_OPCODE_SELF_TEST = 0x04, /* torquers add that many counts, unit flag 3 set meanwhile */
    GEU_OPCODE_RESET_SEQUENCE = 0x05, /* sequence and clock count restart at 0 at the end of the running sample interval */
    GEU_OPCODE_GYRO_POWER = 0x06, /* a stopped gyro reads 0 and not valid; spin-up takes 60 s */
    GEU_OPCODE_HEATER = 0x07, /* off, the sensor cools towards the electronics temperature with a time constant of 20 min */
    GEU_OPCODE_MAX = 0xFF
} geu_opcode;

typedef enum {
    GEU_RESULT_DONE = 0,
    GEU_RESULT_UNKNOWN_OPCODE = 1,
    GEU_RESULT_BAD_ARGUMENT = 2,
    GEU_RESULT_NOT_POSSIBLE_NOW = 3,
    GEU_RESULT_MAX = 0xFF
} geu_result;

/* ---- numbers and CRC ---- */

static inline void geu_put_u8(uint8_t *at, uint8_t value) { at[0] = value; }

static inline void geu_put_u16(uint8_t *at, uint16_t value)
{
    at[0] = (uint8_t)(value >> 8);
    at[1] = (uint8_t)(value & 0xFFu);
}

static inline void geu_put_i16(uint8_t *at, int16_t value) { geu_put_u16(at, (uint16_t)value); }

static inline void geu_put_u48(uint8_t *at, uint64_t value)
{
    for (int byte = 0; byte < 6; byte++)
        at[byte] = (uint8_t)((value >> (8 * (5 - byte))) & 0xFFu);
}

static inline uint8_t geu_get_u8(const uint8_t *at) { return at[0]; }

static inline uint16_t geu_get_u16(const uint8_t *at) { return (uint16_t)(((unsigned)at[0] << 8) | at[1]); }

static inline int16_t geu_get_i16(const uint8_t *at)
{
    const int32_t value = geu_get_u16(at);
    return (int16_t)(value >= 0x8000 ? value - 0x10000 : value);
}

static inline uint64_t geu_get_u48(const uint8_t *at)
{
    uint64_t value = 0;
    for (int byte = 0; byte < 6; byte++)
        value = (value << 8) | at[byte];
    return value;
}

/* CRC-16/IBM-3740 of `length` bytes, going on from `crc` (GEU_CRC_INIT at the beginning). */
#define GEU_CRC_INIT 0xFFFFu
static inline uint16_t geu_crc(uint16_t crc, const uint8_t *bytes, size_t length)
{
    for (size_t at = 0; at < length; at++) {
        crc = (uint16_t)(crc ^ (uint16_t)(bytes[at] << 8));
        for (int bit = 0; bit < 8; bit++)
            crc = (uint16_t)((crc & 0x8000u) ? (uint16_t)(crc << 1) ^ 0x1021u : (uint16_t)(crc << 1));
    }
    return crc;
}

/* ---- the sample ---- */

/* One sample of the unit. */
typedef struct {
    int16_t gyrx; /* GYRX angular increment over the sample interval just ended; clipped, never wrapped, count */
    int16_t gyry; /* GYRY angular increment over the sample interval just ended; clipped, never wrapped, count */
    int16_t gyrza; /* GYRZA angular increment over the sample interval just ended; clipped, never wrapped, count */
    int16_t gyrzb; /* GYRZB angular increment over the sample interval just ended; clipped, never wrapped, count */
    uint16_t sequence; /* +1 each sample, wraps */
    uint8_t gyro_flags; /* validity and saturation of each gyro */
    uint8_t unit_flags; /* state of the unit */
    int16_t electronics_centi_c; /* electronics temperature, 0.01 degC */
    uint64_t clock_count; /* cycle of the nominal 1 MHz unit clock at the end of the sample interval; exactly +500000 each sample, cycle */
    int16_t sensor_centi_c; /* sensor temperature, 0.01 degC */
} geu_sample;

/* The 8 bytes of data of INCREMENTS: increments of the sample just ended; used only with the STATUS that follows it. */
static inline void geu_pack_increments(const geu_sample *sample, uint8_t *data)
{
    geu_put_i16(data, sample->gyrx);
    geu_put_i16(data + 2, sample->gyry);
    geu_put_i16(data + 4, sample->gyrza);
    geu_put_i16(data + 6, sample->gyrzb);
}

static inline void geu_unpack_increments(geu_sample *sample, const uint8_t *data)
{
    sample->gyrx = geu_get_i16(data);
    sample->gyry = geu_get_i16(data + 2);
    sample->gyrza = geu_get_i16(data + 4);
    sample->gyrzb = geu_get_i16(data + 6);
}

/* The 8 bytes of data of STATUS, its CRC left out: state, and CRC over the 8 bytes of INCREMENTS then the first 6 of STATUS. */
static inline void geu_pack_status(const geu_sample *sample, uint8_t *data)
{
    geu_put_u16(data, sample->sequence);
    geu_put_u8(data + 2, sample->gyro_flags);
    geu_put_u8(data + 3, sample->unit_flags);
    geu_put_i16(data + 4, sample->electronics_centi_c);
}

static inline void geu_unpack_status(geu_sample *sample, const uint8_t *data)
{
    sample->sequence = geu_get_u16(data);
    sample->gyro_flags = geu_get_u8(data + 2);
    sample->unit_flags = geu_get_u8(data + 3);
    sample->electronics_centi_c = geu_get_i16(data + 4);
}

/* The 8 bytes of data of CLOCK: clock count and sensor temperature, of the STATUS before it. */
static inline void geu_pack_clock(const geu_sample *sample, uint8_t *data)
{
    geu_put_u48(data, sample->clock_count);
    geu_put_i16(data + 6, sample->sensor_centi_c);
}

static inline void geu_unpack_clock(geu_sample *sample, const uint8_t *data)
{
    sample->clock_count = geu_get_u48(data);
    sample->sensor_centi_c = geu_get_i16(data + 6);
}

/* The 22 bytes of payload of DATA: all fields of one sample. */
static inline void geu_pack_data(const geu_sample *sample, uint8_t *data)
{
    geu_put_u16(data, sample->sequence);
    geu_put_i16(data + 2, sample->gyrx);
    geu_put_i16(data + 4, sample->gyry);
    geu_put_i16(data + 6, sample->gyrza);
    geu_put_i16(data + 8, sample->gyrzb);
    geu_put_u8(data + 10, sample->gyro_flags);
    geu_put_u8(data + 11, sample->unit_flags);
    geu_put_i16(data + 12, sample->electronics_centi_c);
    geu_put_u48(data + 14, sample->clock_count);
    geu_put_i16(data + 20, sample->sensor_centi_c);
}

static inline void geu_unpack_data(geu_sample *sample, const uint8_t *data)
{
    sample->sequence = geu_get_u16(data);
    sample->gyrx = geu_get_i16(data + 2);
    sample->gyry = geu_get_i16(data + 4);
    sample->gyrza = geu_get_i16(data + 6);
    sample->gyrzb = geu_get_i16(data + 8);
    sample->gyro_flags = geu_get_u8(data + 10);
    sample->unit_flags = geu_get_u8(data + 11);
    sample->electronics_centi_c = geu_get_i16(data + 12);
    sample->clock_count = geu_get_u48(data + 14);
    sample->sensor_centi_c = geu_get_i16(data + 20);
}

/* The CRC in STATUS: over the 8 bytes of INCREMENTS then the first 6 of STATUS. */
static inline uint16_t geu_status_crc(const uint8_t *increments, const uint8_t *status)
{
    return geu_crc(geu_crc(GEU_CRC_INIT, increments, GEU_INCREMENTS_LENGTH), status, GEU_STATUS_LENGTH - 2);
}

/* The data of INCREMENTS and STATUS of one sample, CRC included. */
static inline void geu_pack_increments_and_status(const geu_sample *sample, uint8_t *increments,
                                                  uint8_t *status)
{
    geu_pack_increments(sample, increments);
    geu_pack_status(sample, status);
    geu_put_u16(status + GEU_STATUS_LENGTH - 2, geu_status_crc(increments, status));
}

/* Takes an INCREMENTS and the STATUS that came next, no other INCREMENTS between. 1: they belong together and
 * `sample` has their fields. 0: the CRC does not match, `sample` is as it was. */
static inline int geu_unpack_increments_and_status(geu_sample *sample, const uint8_t *increments,
                                                   const uint8_t *status)
{
    if (geu_status_crc(increments, status) != geu_get_u16(status + GEU_STATUS_LENGTH - 2))
        return 0;
    geu_unpack_increments(sample, increments);
    geu_unpack_status(sample, status);
    return 1;
}

/* ---- commands ---- */

/* PING: asks for the link version. */
static inline size_t geu_pack_ping(uint8_t *data)
{
    geu_put_u8(data, GEU_OPCODE_PING);
    return 1;
}

/* The arguments in the data of such a COMMAND; the result a unit replies with. */
static inline geu_result geu_unpack_ping(const uint8_t *data, size_t length)
{
    if (length < 1 || data[0] != GEU_OPCODE_PING)
        return GEU_RESULT_UNKNOWN_OPCODE;
    if (length != 1)
        return GEU_RESULT_BAD_ARGUMENT;
    return GEU_RESULT_DONE;
}

/* SET_MODE: chooses whether data are sent each sample or when polled.
 * mode: 0 cyclic, 1 polled, 0 to 1. */
static inline size_t geu_pack_set_mode(uint8_t *data, uint8_t mode)
{
    geu_put_u8(data, GEU_OPCODE_SET_MODE);
    geu_put_u8(data + 1, mode);
    return 2;
}

/* The arguments in the data of such a COMMAND; the result a unit replies with. */
static inline geu_result geu_unpack_set_mode(const uint8_t *data, size_t length, uint8_t *mode)
{
    if (length < 1 || data[0] != GEU_OPCODE_SET_MODE)
        return GEU_RESULT_UNKNOWN_OPCODE;
    if (length != 2)
        return GEU_RESULT_BAD_ARGUMENT;
    *mode = geu_get_u8(data + 1);
    if (*mode > 1)
        return GEU_RESULT_BAD_ARGUMENT;
    return GEU_RESULT_DONE;
}

/* POLL: polled mode only: the last completed sample's messages follow the REPLY. */
static inline size_t geu_pack_poll(uint8_t *data)
{
    geu_put_u8(data, GEU_OPCODE_POLL);
    return 1;
}

/* The arguments in the data of such a COMMAND; the result a unit replies with. */
static inline geu_result geu_unpack_poll(const uint8_t *data, size_t length)
{
    if (length < 1 || data[0] != GEU_OPCODE_POLL)
        return GEU_RESULT_UNKNOWN_OPCODE;
    if (length != 1)
        return GEU_RESULT_BAD_ARGUMENT;
    return GEU_RESULT_DONE;
}

/* SELF_TEST: torquers add that many counts, unit flag 3 set meanwhile.
 * gyros: mask of gyros under test, bit 0 GYRX, 1 to 15.
 * counts: counts added each sample, -32768 to 32767.
 * half_seconds: duration, 1 to 255. */
static inline size_t geu_pack_self_test(uint8_t *data, uint8_t gyros, int16_t counts, uint8_t half_seconds)
{
    geu_put_u8(data, GEU_OPCODE_SELF_TEST);
    geu_put_u8(data + 1, gyros);
    geu_put_i16(data + 2, counts);
    geu_put_u8(data + 4, half_seconds);
    return 5;
}

/* The arguments in the data of such a COMMAND; the result a unit replies with. */
static inline geu_result geu_unpack_self_test(const uint8_t *data, size_t length, uint8_t *gyros, int16_t *counts, uint8_t *half_seconds)
{
    if (length < 1 || data[0] != GEU_OPCODE_SELF_TEST)
        return GEU_RESULT_UNKNOWN_OPCODE;
    if (length != 5)
        return GEU_RESULT_BAD_ARGUMENT;
    *gyros = geu_get_u8(data + 1);
    *counts = geu_get_i16(data + 2);
    *half_seconds = geu_get_u8(data + 4);
    if (*gyros < 1 || *gyros > 15 || *half_seconds < 1)
        return GEU_RESULT_BAD_ARGUMENT;
    return GEU_RESULT_DONE;
}

/* RESET_SEQUENCE: sequence and clock count restart at 0 at the end of the running sample interval. */
static inline size_t geu_pack_reset_sequence(uint8_t *data)
{
    geu_put_u8(data, GEU_OPCODE_RESET_SEQUENCE);
    return 1;
}

/* The arguments in the data of such a COMMAND; the result a unit replies with. */
static inline geu_result geu_unpack_reset_sequence(const uint8_t *data, size_t length)
{
    if (length < 1 || data[0] != GEU_OPCODE_RESET_SEQUENCE)
        return GEU_RESULT_UNKNOWN_OPCODE;
    if (length != 1)
        return GEU_RESULT_BAD_ARGUMENT;
    return GEU_RESULT_DONE;
}

/* GYRO_POWER: a stopped gyro reads 0 and not valid; spin-up takes 60 s.
 * gyros: mask of gyros that run, bit 0 GYRX, 0 to 15. */
static inline size_t geu_pack_gyro_power(uint8_t *data, uint8_t gyros)
{
    geu_put_u8(data, GEU_OPCODE_GYRO_POWER);
    geu_put_u8(data + 1, gyros);
    return 2;
}

/* The arguments in the data of such a COMMAND; the result a unit replies with. */
static inline geu_result geu_unpack_gyro_power(const uint8_t *data, size_t length, uint8_t *gyros)
{
    if (length < 1 || data[0] != GEU_OPCODE_GYRO_POWER)
        return GEU_RESULT_UNKNOWN_OPCODE;
    if (length != 2)
        return GEU_RESULT_BAD_ARGUMENT;
    *gyros = geu_get_u8(data + 1);
    if (*gyros > 15)
        return GEU_RESULT_BAD_ARGUMENT;
    return GEU_RESULT_DONE;
}

/* HEATER: off, the sensor cools towards the electronics temperature with a time constant of 20 min.
 * on: 0 off, 1 on, 0 to 1. */
static inline size_t geu_pack_heater(uint8_t *data, uint8_t on)
{
    geu_put_u8(data, GEU_OPCODE_HEATER);
    geu_put_u8(data + 1, on);
    return 2;
}

/* The arguments in the data of such a COMMAND; the result a unit replies with. */
static inline geu_result geu_unpack_heater(const uint8_t *data, size_t length, uint8_t *on)
{
    if (length < 1 || data[0] != GEU_OPCODE_HEATER)
        return GEU_RESULT_UNKNOWN_OPCODE;
    if (length != 2)
        return GEU_RESULT_BAD_ARGUMENT;
    *on = geu_get_u8(data + 1);
    if (*on > 1)
        return GEU_RESULT_BAD_ARGUMENT;
    return GEU_RESULT_DONE;
}

/* A REPLY: command, result, values. */
typedef struct {
    uint8_t opcode;
    uint8_t result; /* GEU_RESULT_… */
    uint8_t value_length;
    uint8_t values[GEU_REPLY_MAX_LENGTH - 2];
} geu_reply;

/* Reads the data of a REPLY. 1: well-formed. 0: too short or too long. */
static inline int geu_unpack_reply(geu_reply *reply, const uint8_t *data, size_t length)
{
    if (length < GEU_REPLY_MIN_LENGTH || length > GEU_REPLY_MAX_LENGTH)
        return 0;
    reply->opcode = data[0];
    reply->result = data[1];
    reply->value_length = (uint8_t)(length - 2);
    memset(reply->values, 0, sizeof reply->values);
    memcpy(reply->values, data + 2, length - 2);
    return 1;
}

/* Writes the data of a REPLY and returns their length. `data` holds GEU_REPLY_MAX_LENGTH bytes. */
static inline size_t geu_pack_reply(const geu_reply *reply, uint8_t *data)
{
    const size_t values = reply->value_length <= sizeof reply->values ? reply->value_length : sizeof reply->values;
    data[0] = reply->opcode;
    data[1] = reply->result;
    memcpy(data + 2, reply->values, values);
    return 2 + values;
}

/* The values of a REPLY to PING. 1: read. 0: another command, not done, or another length. */
static inline int geu_unpack_ping_values(const geu_reply *reply, uint8_t *major, uint8_t *minor)
{
    if (reply->opcode != GEU_OPCODE_PING || reply->result != GEU_RESULT_DONE || reply->value_length != 2)
        return 0;
    *major = geu_get_u8(reply->values + 0);
    *minor = geu_get_u8(reply->values + 1);
    return 1;
}

/* ---- serial frames ---- */

/* 1: payloads of that type have that length. */
static inline int geu_serial_length_fits(uint8_t type, uint8_t length)
{
    switch (type) {
    case GEU_SERIAL_DATA:
        return length == GEU_DATA_LENGTH;
    case GEU_SERIAL_COMMAND:
        return length >= GEU_COMMAND_MIN_LENGTH && length <= GEU_COMMAND_MAX_LENGTH;
    case GEU_SERIAL_REPLY:
        return length >= GEU_REPLY_MIN_LENGTH && length <= GEU_REPLY_MAX_LENGTH;
    default:
        return 0;
    }
}

/* Writes the frame around `payload` and returns its length, 0 where type and length do not fit. `frame` holds
 * GEU_SERIAL_MAX_FRAME bytes. */
static inline size_t geu_pack_frame(uint8_t *frame, uint8_t type, const uint8_t *payload, size_t length)
{
    if (length > GEU_SERIAL_MAX_PAYLOAD || !geu_serial_length_fits(type, (uint8_t)length))
        return 0;
    frame[0] = GEU_SERIAL_SYNC_0;
    frame[1] = GEU_SERIAL_SYNC_1;
    frame[2] = type;
    frame[3] = (uint8_t)length;
    memcpy(frame + 4, payload, length);
    geu_put_u16(frame + 4 + length, geu_crc(GEU_CRC_INIT, frame + 2, length + 2));
    return length + 6;
}

/* A frame that was received, its CRC checked. */
typedef struct {
    uint8_t type; /* GEU_SERIAL_DATA, GEU_SERIAL_COMMAND, GEU_SERIAL_REPLY */
    uint8_t length;
    uint8_t payload[GEU_SERIAL_MAX_PAYLOAD];
} geu_frame;

/* Finds frames in any bytes; all zeros at the beginning. On failure it resumes one byte after the sync it tried. */
typedef struct {
    uint8_t bytes[GEU_SERIAL_MAX_FRAME];
    size_t used;
    uint32_t skipped;  /* bytes outside of frames */
    uint32_t rejected; /* syncs without a good frame */
} geu_deframer;

/* The next frame in the bytes held: 1 and `frame` is filled, or 0. Call it until 0. */
static inline int geu_deframer_next(geu_deframer *deframer, geu_frame *frame)
{
    uint8_t *const bytes = deframer->bytes;
    size_t at = 0;
    int found = 0;
    while (at < deframer->used && !found) {
        const uint8_t *const start = bytes + at;
        const size_t rest = deframer->used - at;
        size_t whole;
        if (start[0] != GEU_SERIAL_SYNC_0 || (rest > 1 && start[1] != GEU_SERIAL_SYNC_1)) {
            deframer->skipped++;
            at++;
            continue;
        }
        if (rest < 4)
            break;
        whole = (size_t)start[3] + 6;
        if (geu_serial_length_fits(start[2], start[3])) {
            if (rest < whole)
                break;
            if (geu_crc(GEU_CRC_INIT, start + 2, whole - 4) == geu_get_u16(start + whole - 2)) {
                frame->type = start[2];
                frame->length = start[3];
                memcpy(frame->payload, start + 4, start[3]);
                at += whole;
                found = 1;
                continue;
            }
        }
        deframer->rejected++;
        deframer->skipped++;
        at++;
    }
    deframer->used -= at;
    memmove(bytes, bytes + at, deframer->used);
    return found;
}

/* Takes one byte from the line, then call geu_deframer_next until it returns 0. */
static inline void geu_deframer_push(geu_deframer *deframer, uint8_t byte)
{
    if (deframer->used < sizeof deframer->bytes)
        deframer->bytes[deframer->used++] = byte;
}

#ifdef __cplusplus
}
#endif

#endif /* GEU_H */
