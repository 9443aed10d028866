/* Link of the unit {{ title }}, for on-board software. Generated: geu describe header. Do not edit.
 *
 * Header only, C99 and C++, no allocation, no state. A function for each frame reads it into a sample. */
#ifndef GEU_DEVICE_{{ prefix | constant }}_H
#define GEU_DEVICE_{{ prefix | constant }}_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef enum {
    {{ prefix | constant }}_OK = 0,
    {{ prefix | constant }}_WRONG_LENGTH,
    {{ prefix | constant }}_WRONG_CONSTANT,
    {{ prefix | constant }}_WRONG_CHECK
} {{ prefix }}_result;

static inline uint64_t {{ prefix }}_bits(const uint8_t *bytes, size_t length, int little, unsigned shift, unsigned bits)
{
    uint64_t word = 0;
    for (size_t index = 0; index < length; index++)
        word = word << 8 | bytes[little ? length - 1 - index : index];
    return word >> shift & (UINT64_MAX >> (64 - bits));
}

typedef enum { {{ prefix | constant }}_UNSIGNED, {{ prefix | constant }}_SIGNED, {{ prefix | constant }}_FLOAT } {{ prefix }}_coding;

static inline double {{ prefix }}_number(uint64_t word, unsigned bits, {{ prefix }}_coding coding)
{
    if (coding == {{ prefix | constant }}_FLOAT && bits == 32) {
        const uint32_t half = (uint32_t)word;
        float value;
        memcpy(&value, &half, sizeof value);
        return value;
    }
    if (coding == {{ prefix | constant }}_FLOAT) {
        double value;
        memcpy(&value, &word, sizeof value);
        return value;
    }
    if (coding == {{ prefix | constant }}_SIGNED && word >> (bits - 1))
        return -(double)((UINT64_MAX >> (64 - bits)) - word + 1);
    return (double)word;
}

typedef enum {
    {{ prefix | constant }}_CRC,
    {{ prefix | constant }}_SUM,
    {{ prefix | constant }}_SUM_U16BE,
    {{ prefix | constant }}_SUM_U16LE,
    {{ prefix | constant }}_FLETCHER,
    {{ prefix | constant }}_XOR
} {{ prefix }}_kind;

typedef struct {
    {{ prefix }}_kind kind;
    unsigned width;
    uint64_t polynomial, initial, final_xor;
    int reflects_input, reflects_output, is_negated;
} {{ prefix }}_algorithm;

static inline uint64_t {{ prefix }}_reflect(uint64_t word, unsigned bits)
{
    uint64_t reflected = 0;
    for (unsigned bit = 0; bit < bits; bit++)
        reflected |= (word >> bit & 1u) << (bits - 1 - bit);
    return reflected;
}

static inline uint64_t {{ prefix }}_update({{ prefix }}_algorithm algorithm, uint64_t value, uint8_t byte, size_t count)
{
    switch (algorithm.kind) {
    case {{ prefix | constant }}_SUM:
        return value + byte;
    case {{ prefix | constant }}_SUM_U16BE:
        return value + ((uint64_t)byte << (count % 2 ? 0 : 8));
    case {{ prefix | constant }}_SUM_U16LE:
        return value + ((uint64_t)byte << (count % 2 ? 8 : 0));
    case {{ prefix | constant }}_FLETCHER: {
        const uint64_t first = ((value >> 8) + byte) & 0xFFu;
        return first << 8 | ((value + first) & 0xFFu);
    }
    case {{ prefix | constant }}_XOR:
        return value ^ byte;
    case {{ prefix | constant }}_CRC:
        break;
    }
    if (algorithm.reflects_input)
        byte = (uint8_t){{ prefix }}_reflect(byte, 8);
    value ^= (uint64_t)byte << (algorithm.width - 8);
    for (int bit = 0; bit < 8; bit++)
        value = value >> (algorithm.width - 1) & 1u ? value << 1 ^ algorithm.polynomial : value << 1;
    return value & (UINT64_MAX >> (64 - algorithm.width));
}

static inline uint64_t {{ prefix }}_finish({{ prefix }}_algorithm algorithm, uint64_t value)
{
    if (algorithm.is_negated)
        return 0 - value;
    if (algorithm.kind == {{ prefix | constant }}_CRC && algorithm.reflects_output)
        value = {{ prefix }}_reflect(value, algorithm.width);
    return value ^ algorithm.final_xor;
}

/* Values of a sample, unit last in the name. */
typedef struct {
{%- for v in values %}
    double {{ v.name }};
{%- endfor %}
} {{ prefix }}_sample;
{%- for link in links %}
{%- for f in link.frames %}

#define {{ prefix | constant }}_{{ f.name | constant }}_LENGTH {{ f.length }}u
{%- if link.is_can %}
#define {{ prefix | constant }}_{{ f.name | constant }}_ID {{ f.id }}u
#define {{ prefix | constant }}_{{ f.name | constant }}_IS_EXTENDED {% if f.is_extended %}1{% else %}0{% endif %}
{%- endif %}

static inline {{ prefix }}_result {{ prefix }}_read_{{ f.name }}(const uint8_t *bytes, size_t length, {{ prefix }}_sample *sample)
{
    (void)sample;
    static const uint8_t constant[] = { {{ f.template }} };
    static const uint8_t required[] = { {{ f.required }} };
    if (length != sizeof constant)
        return {{ prefix | constant }}_WRONG_LENGTH;
    for (size_t at = 0; at < length; at++)
        if ((bytes[at] ^ constant[at]) & required[at])
            return {{ prefix | constant }}_WRONG_CONSTANT;
{%- for c in f.checks %}
    {
        const {{ prefix }}_algorithm algorithm = { {{ prefix | constant }}_{{ c.kind }}, {{ c.width }}u, {{ c.polynomial }}u, {{ c.initial }}u, {{ c.final_xor }}u, {% if c.reflects_input %}1{% else %}0{% endif %}, {% if c.reflects_output %}1{% else %}0{% endif %}, {% if c.is_negated %}1{% else %}0{% endif %} };
        uint64_t value = algorithm.initial;
        size_t covered = 0;
        for (size_t at = {{ c.from }}; at < {{ c.to }}; at++)
            if ((size_t)(at - {{ c.at }}) >= {{ c.length }}) {
                value = {{ prefix }}_update(algorithm, value, bytes[at], covered);
                covered++;
            }
        for (; covered % {{ c.pad_to }}; covered++)
            value = {{ prefix }}_update(algorithm, value, 0, covered);
{%- for b in c.suffix %}
        value = {{ prefix }}_update(algorithm, value, {{ b }}, covered++);
{%- endfor %}
        value = {{ prefix }}_finish(algorithm, value) & (UINT64_MAX >> (64 - {{ c.bits }}));
        if (value != {{ prefix }}_bits(bytes + {{ c.at }}, {{ c.length }}, {% if c.is_little_endian %}1{% else %}0{% endif %}, {{ c.shift }}, {{ c.bits }}))
            return {{ prefix | constant }}_WRONG_CHECK;
    }
{%- endfor %}
{%- for v in f.fields %}
    sample->{{ v.name }} = {{ prefix }}_number({{ prefix }}_bits(bytes + {{ v.at }}, {{ v.length }}, {% if v.is_little_endian %}1{% else %}0{% endif %}, {{ v.shift }}, {{ v.bits }}), {{ v.bits }}, {{ prefix | constant }}_{{ v.coding }}) * {{ v.scale }} / {{ v.divisor }} + {{ v.offset }};
{%- endfor %}
    return {{ prefix | constant }}_OK;
}
{%- endfor %}
{%- endfor %}

#ifdef __cplusplus
}
#endif

#endif
