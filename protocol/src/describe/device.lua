-- Wireshark dissector of the link of the unit {{ title }}. Generated: geu describe dissector. Do not edit.
--
-- Serial frames over TCP: on the port of the preference, or with Decode As. CAN frames: by identifier. Use: put it into the
-- personal Lua plugin folder, or
--     tshark -X lua_script:FILE -o {{ prefix }}.tcp_port:4700 -r capture.pcap

local unit = Proto("{{ prefix }}", "{{ title }}")

local fields = {
{%- for v in values %}
    ["{{ v.name }}"] = ProtoField.double("{{ prefix }}.{{ v.name }}", "{{ v.name }}"),
{%- endfor %}
    check = ProtoField.bytes("{{ prefix }}.check", "check"),
    check_good = ProtoField.bool("{{ prefix }}.check_good", "check good"),
    skipped = ProtoField.bytes("{{ prefix }}.skipped", "bytes that belong to no frame"),
}
unit.fields = fields
local bad_check = ProtoExpert.new("{{ prefix }}.check.bad", "check does not match", expert.group.CHECKSUM, expert.severity.ERROR)
local bad_length = ProtoExpert.new("{{ prefix }}.length.bad", "length that the message does not have", expert.group.MALFORMED, expert.severity.ERROR)
unit.experts = { bad_check, bad_length }
unit.prefs.tcp_port = Pref.uint("TCP port", 0, "port that carries serial frames; 0 for none")

local serial_frames, can_frames = {}, {}
{%- for link in links %}
{%- for f in link.frames %}
table.insert({% if link.is_can %}can_frames{% else %}serial_frames{% endif %}, {
    name = "{{ f.name }}", length = {{ f.length }}, id = {{ f.id }}, extended = {% if f.is_extended %}true{% else %}false{% endif %},
    template = { {{ f.template }} }, required = { {{ f.required }} },
    fields = {
{%- for v in f.fields %}
        { name = "{{ v.name }}", at = {{ v.at }}, length = {{ v.length }}, little = {% if v.is_little_endian %}true{% else %}false{% endif %}, shift = {{ v.shift }}, bits = {{ v.bits }}, coding = "{{ v.coding }}", scale = {{ v.scale }}, divisor = {{ v.divisor }}, offset = {{ v.offset }} },
{%- endfor %}
    },
    checks = {
{%- for c in f.checks %}
        { kind = "{{ c.kind }}", at = {{ c.at }}, length = {{ c.length }}, little = {% if c.is_little_endian %}true{% else %}false{% endif %}, shift = {{ c.shift }}, bits = {{ c.bits }}, from = {{ c.from }}, to = {{ c.to }}, pad_to = {{ c.pad_to }},
          suffix = { {{ c.suffix_list }} }, width = {{ c.width }}, polynomial = {{ c.polynomial }}, initial = {{ c.initial }}, final_xor = {{ c.final_xor }},
          reflects_input = {% if c.reflects_input %}true{% else %}false{% endif %}, reflects_output = {% if c.reflects_output %}true{% else %}false{% endif %}, negated = {% if c.is_negated %}true{% else %}false{% endif %} },
{%- endfor %}
    },
})
{%- endfor %}
{%- endfor %}

-- Numbers of up to 53 bits are exact.
local function bits_of(bytes, place)
    local word = 0
    for index = 0, place.length - 1 do
        local at = place.little and place.length - 1 - index or index
        word = word * 256 + bytes:get_index(place.at + at)
    end
    return math.floor(word / 2 ^ place.shift) % 2 ^ place.bits
end

local function number_of(range, bytes, place)
    if place.coding == "FLOAT" then
        local own = range(place.at, place.length)
        return place.little and own:le_float() or own:float()
    end
    local word = bits_of(bytes, place)
    if place.coding == "SIGNED" and word >= 2 ^ (place.bits - 1) then word = word - 2 ^ place.bits end
    return word
end

local function reflected(word, bits)
    local result = 0
    for _ = 1, bits do
        result = result * 2 + word % 2
        word = math.floor(word / 2)
    end
    return result
end

-- Exclusive-or of numbers of up to 32 bits, as a number without sign.
local function xor(one, other)
    local result = bit.bxor(one, other)
    return result < 0 and result + 2 ^ 32 or result
end

local function update(check, value, byte, count)
    if check.kind == "XOR" then return xor(value, byte) end
    if check.kind == "SUM" then return value + byte end
    if check.kind == "SUM_U16BE" then return value + byte * (count % 2 == 0 and 256 or 1) end
    if check.kind == "SUM_U16LE" then return value + byte * (count % 2 == 0 and 1 or 256) end
    if check.kind == "FLETCHER" then
        local first = (math.floor(value / 256) + byte) % 256
        return first * 256 + (value % 256 + first) % 256
    end
    if check.reflects_input then byte = reflected(byte, 8) end
    value = xor(value, byte * 2 ^ (check.width - 8))
    for _ = 1, 8 do
        local carry = value >= 2 ^ (check.width - 1)
        value = value * 2 % 2 ^ check.width
        if carry then value = xor(value, check.polynomial) end
    end
    return value
end

local function is_good(check, bytes)
    local value, covered = check.initial, 0
    for at = check.from, check.to - 1 do
        if at < check.at or at >= check.at + check.length then
            value, covered = update(check, value, bytes:get_index(at), covered), covered + 1
        end
    end
    while covered % check.pad_to > 0 do
        value, covered = update(check, value, 0, covered), covered + 1
    end
    for _, byte in ipairs(check.suffix) do
        value, covered = update(check, value, byte, covered), covered + 1
    end
    if check.negated then value = -value end
    if check.kind == "CRC" then
        if check.reflects_output then value = reflected(value, check.width) end
        value = xor(value, check.final_xor)
    end
    return value % 2 ^ check.bits == bits_of(bytes, check)
end

-- True if the bytes have the frame's constants, as far as they go.
local function has_constants(frame, bytes)
    for index = 1, math.min(frame.length, bytes:len()) do
        if bit.band(bit.bxor(bytes:get_index(index - 1), frame.template[index]), frame.required[index]) ~= 0 then return false end
    end
    return true
end

local function checks_hold(frame, bytes)
    for _, check in ipairs(frame.checks) do
        if not is_good(check, bytes) then return false end
    end
    return true
end

local function add_frame(tree, range, frame)
    local bytes, item = range:bytes(), tree:add(unit, range, unit.description .. ", " .. frame.name)
    for _, place in ipairs(frame.fields) do
        local value = number_of(range, bytes, place) * place.scale / place.divisor + place.offset
        item:add(fields[place.name], range(place.at, place.length), value)
    end
    for _, check in ipairs(frame.checks) do
        local own, good = item:add(fields.check, range(check.at, check.length)), is_good(check, bytes)
        own:add(fields.check_good, range(check.at, check.length), good):set_generated()
        if not good then own:add_proto_expert_info(bad_check) end
    end
end

local function dissect_serial(tvb, pinfo, tree)
    local at, skipped_from, names = 0, nil, {}
    local function end_skipping()
        if skipped_from and skipped_from < at then
            tree:add(unit, tvb(skipped_from, at - skipped_from)):add(fields.skipped, tvb(skipped_from, at - skipped_from))
        end
        skipped_from = nil
    end
    pinfo.cols.protocol = "{{ prefix }}"
    while at < tvb:len() do
        local found, missing
        for _, frame in ipairs(serial_frames) do
            local rest = tvb:len() - at
            local bytes = tvb(at, math.min(rest, frame.length)):bytes()
            if has_constants(frame, bytes) then
                if rest < frame.length then
                    missing = math.max(missing or 0, frame.length - rest)
                elseif checks_hold(frame, bytes) then
                    found = frame
                    break
                end
            end
        end
        if found then
            end_skipping()
            add_frame(tree, tvb(at, found.length), found)
            names[#names + 1] = found.name
            at = at + found.length
        elseif missing and pinfo.can_desegment > 0 then
            end_skipping()
            pinfo.desegment_offset, pinfo.desegment_len = at, missing
            return tvb:len()
        else
            skipped_from = skipped_from or at
            at = at + 1
        end
    end
    end_skipping()
    if #names > 0 then pinfo.cols.info = table.concat(names, "; ") end
    return tvb:len()
end

local function dissect_can(tvb, pinfo, tree)
    local bytes = tvb:bytes()
    for _, frame in ipairs(can_frames) do
        if frame.id == pinfo.match_uint and has_constants(frame, bytes) then
            pinfo.cols.protocol, pinfo.cols.info = "{{ prefix }}", frame.name
            if tvb:len() == frame.length then
                add_frame(tree, tvb(), frame)
            else
                tree:add(unit, tvb()):add_proto_expert_info(bad_length)
            end
            return tvb:len()
        end
    end
    return 0
end

local on_can = Proto("{{ prefix }}_can", "{{ title }} on CAN")
on_can.dissector = dissect_can
for _, frame in ipairs(can_frames) do
    local identifiers = DissectorTable.get(frame.extended and "can.extended_id" or "can.id")
    if identifiers then identifiers:add(frame.id, on_can) end
end

local tcp_port = 0
unit.dissector = dissect_serial
local function apply_preferences()
    local ports = DissectorTable.get("tcp.port")
    if tcp_port > 0 then ports:remove(tcp_port, unit) end
    tcp_port = unit.prefs.tcp_port
    if tcp_port > 0 then ports:add(tcp_port, unit) end
end
unit.prefs_changed = apply_preferences
apply_preferences()
DissectorTable.get("tcp.port"):add_for_decode_as(unit)
