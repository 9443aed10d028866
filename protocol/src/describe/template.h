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

#define GEU_LINK_VERSION_MAJOR {{ major }}u
#define GEU_LINK_VERSION_MINOR {{ minor }}u

#define GEU_CLOCK_PER_SAMPLE {{ clock_per_sample }}u

#define GEU_CAN_BASE_DEFAULT 0x{{ base }}u
{%- for m in messages %}
{%- if m.is_can %}
#define GEU_CAN_{{ m.name }} {{ m.id }}u
{%- endif %}
{%- endfor %}
{%- for e in exchanged %}
#define GEU_CAN_{{ e.name }} {{ e.can }}u
{%- endfor %}
{% for m in messages %}
#define GEU_{{ m.name }}_LENGTH {{ m.length }}u
{%- endfor %}
{%- for e in exchanged %}
#define GEU_{{ e.name }}_MIN_LENGTH {{ e.min }}u
#define GEU_{{ e.name }}_MAX_LENGTH {{ e.max }}u
{%- endfor %}

#define GEU_SERIAL_SYNC_0 0x{{ sync.0 | hex }}u
#define GEU_SERIAL_SYNC_1 0x{{ sync.1 | hex }}u
{%- for m in messages %}
{%- if not m.is_can %}
#define GEU_SERIAL_{{ m.name }} 0x{{ m.id | hex }}u
{%- endif %}
{%- endfor %}
{%- for e in exchanged %}
#define GEU_SERIAL_{{ e.name }} 0x{{ e.serial | hex }}u
{%- endfor %}
#define GEU_SERIAL_MAX_PAYLOAD {{ max_payload }}u
#define GEU_SERIAL_MAX_FRAME {{ max_frame }}u
#define GEU_SERIAL_DEFAULT_BAUD {{ baud }}u

/* Masks of the gyros in commands. */
{%- for g in gyros %}
#define GEU_{{ g.name }} 0x{{ g.mask | hex }}u
{%- endfor %}
{%- for f in flags %}

/* Bits of {{ f.name }}. */
{%- for b in f.bits %}
#define GEU_{{ b.name | constant }} 0x{{ b.mask | hex }}u /* {{ b.meaning }} */
{%- endfor %}
{%- endfor %}

typedef enum {
{%- for c in commands %}
    GEU_OPCODE_{{ c.name }} = 0x{{ c.opcode | hex }}, /* {{ c.meaning }} */
{%- endfor %}
    GEU_OPCODE_MAX = 0xFF
} geu_opcode;

typedef enum {
{%- for r in results %}
    GEU_RESULT_{{ r.text | constant }} = {{ r.code }},
{%- endfor %}
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
{%- for f in fields %}
{%- if not f.is_crc %}
    {{ f.native }}_t {{ f.in_c }}; /* {{ f.meaning }}{% if f.unit %}, {{ f.unit }}{% endif %} */
{%- endif %}
{%- endfor %}
} geu_sample;

{%- for m in messages %}

/* The {{ m.length }} bytes of {% if m.is_can %}data{% else %}payload{% endif %} of {{ m.name }}{% if m.has_crc %}, its CRC left out{% endif %}: {{ m.meaning }}. */
static inline void geu_pack_{{ m.name | lower }}(const geu_sample *sample, uint8_t *data)
{
{%- for f in m.fields %}
{%- if not f.is_crc %}
    geu_put_{{ f.wire }}(data{% if f.at %} + {{ f.at }}{% endif %}, sample->{{ f.in_c }});
{%- endif %}
{%- endfor %}
}

static inline void geu_unpack_{{ m.name | lower }}(geu_sample *sample, const uint8_t *data)
{
{%- for f in m.fields %}
{%- if not f.is_crc %}
    sample->{{ f.in_c }} = geu_get_{{ f.wire }}(data{% if f.at %} + {{ f.at }}{% endif %});
{%- endif %}
{%- endfor %}
}
{%- endfor %}

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

{%- for c in commands %}

/* {{ c.name }}: {{ c.meaning }}.
{%- for a in c.arguments %}
 * {{ a.name }}: {{ a.meaning }}, {{ a.low }} to {{ a.high }}.
{%- endfor %} */
static inline size_t geu_pack_{{ c.name | lower }}(uint8_t *data{% for a in c.arguments %}, {{ a.native }}_t {{ a.name }}{% endfor %})
{
    geu_put_u8(data, GEU_OPCODE_{{ c.name }});
{%- for a in c.arguments %}
    geu_put_{{ a.wire }}(data + {{ a.at }}, {{ a.name }});
{%- endfor %}
    return {{ c.length }};
}

/* The arguments in the data of such a COMMAND; the result a unit replies with. */
static inline geu_result geu_unpack_{{ c.name | lower }}(const uint8_t *data, size_t length{% for a in c.arguments %}, {{ a.native }}_t *{{ a.name }}{% endfor %})
{
    if (length < 1 || data[0] != GEU_OPCODE_{{ c.name }})
        return GEU_RESULT_UNKNOWN_OPCODE;
    if (length != {{ c.length }})
        return GEU_RESULT_BAD_ARGUMENT;
{%- for a in c.arguments %}
    *{{ a.name }} = geu_get_{{ a.wire }}(data + {{ a.at }});
{%- endfor %}
{%- if c.tests %}
    if ({{ c.tests }})
        return GEU_RESULT_BAD_ARGUMENT;
{%- endif %}
    return GEU_RESULT_DONE;
}
{%- endfor %}

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

{%- for c in commands %}
{%- if c.values %}

/* The values of a REPLY to {{ c.name }}. 1: read. 0: another command, not done, or another length. */
static inline int geu_unpack_{{ c.name | lower }}_values(const geu_reply *reply{% for v in c.values %}, {{ v.native }}_t *{{ v.name }}{% endfor %})
{
    if (reply->opcode != GEU_OPCODE_{{ c.name }} || reply->result != GEU_RESULT_DONE || reply->value_length != {{ c.value_length }})
        return 0;
{%- for v in c.values %}
    *{{ v.name }} = geu_get_{{ v.wire }}(reply->values + {{ v.at }});
{%- endfor %}
    return 1;
}
{%- endif %}
{%- endfor %}

/* ---- serial frames ---- */

/* 1: payloads of that type have that length. */
static inline int geu_serial_length_fits(uint8_t type, uint8_t length)
{
    switch (type) {
{%- for m in messages %}
{%- if not m.is_can %}
    case GEU_SERIAL_{{ m.name }}:
        return length == GEU_{{ m.name }}_LENGTH;
{%- endif %}
{%- endfor %}
{%- for e in exchanged %}
    case GEU_SERIAL_{{ e.name }}:
        return length >= GEU_{{ e.name }}_MIN_LENGTH && length <= GEU_{{ e.name }}_MAX_LENGTH;
{%- endfor %}
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
