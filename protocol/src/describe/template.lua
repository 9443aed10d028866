-- Wireshark dissector of the gyro electronics unit's link. Generated: geu describe dissector. Do not edit.
--
-- Serial frames over TCP: on the port of the preference, on any port with Decode As, and found by their sync. CAN
-- frames: by identifier, from the base of the preference. Use: put it into the personal Lua plugin folder, or
--     tshark -X lua_script:geu.lua -o geu.tcp_port:4700 -o geu.can_base:1A0 -r capture.pcap

local geu = Proto("geu", "Gyro electronics unit")
local geu_can = Proto("geu_can", "Gyro electronics unit on CAN")

local sync = { 0x{{ sync.0 | hex }}, 0x{{ sync.1 | hex }} }
local can_base_default = "{{ base }}"

local can_names = {
{%- for m in messages %}
{%- if m.is_can %} [{{ m.id }}] = "{{ m.name }}",{% endif %}
{%- endfor %}
{%- for e in exchanged %} [{{ e.can }}] = "{{ e.name }}",{% endfor %} }
local type_names = {
{%- for m in messages %}
{%- if not m.is_can %} [{{ m.id }}] = "{{ m.name }}",{% endif %}
{%- endfor %}
{%- for e in exchanged %} [{{ e.serial }}] = "{{ e.name }}",{% endfor %} }
local opcode_names = {
{%- for c in commands %} [{{ c.opcode }}] = "{{ c.name }}",{% endfor %} }
local result_names = {
{%- for r in results %} [{{ r.code }}] = "{{ r.text }}",{% endfor %} }
-- Shortest and longest payload of each type of serial frame.
local lengths = {
{%- for m in messages %}
{%- if not m.is_can %} [{{ m.id }}] = { {{ m.length }}, {{ m.length }} },{% endif %}
{%- endfor %}
{%- for e in exchanged %} [{{ e.serial }}] = { {{ e.min }}, {{ e.max }} },{% endfor %} }

local fields = {
{%- for f in fields %}
{%- if f.is_scaled %}
    {{ f.name }} = ProtoField.double("geu.{{ f.name }}", "{{ f.name }}", "{{ f.meaning }}"),
{%- else %}
    {{ f.name }} = ProtoField.{{ f.native }}("geu.{{ f.name }}", "{{ f.name }}", base.{% if f.bits %}HEX{% else if f.is_crc %}HEX{% else %}DEC{% endif %}, nil, nil, "{{ f.meaning }}"),
{%- for b in f.bits %}
    {{ b.name }} = ProtoField.bool("geu.{{ b.name }}", "{{ b.name }}", 8, nil, 0x{{ b.mask | hex }}, "{{ b.meaning }}"),
{%- endfor %}
{%- endif %}
{%- endfor %}
{%- for c in commands %}
{%- for part in [c.arguments, c.values] %}
{%- for a in part %}
    {{ a.full_name }} = ProtoField.{{ a.native }}("geu.{{ a.full_name }}", "{{ a.full_name }}", base.DEC, {% if a.choices %}{ {% for o in a.choices %}[{{ o.value }}] = "{{ o.name }}"{% if not loop.last %}, {% endif %}{% endfor %} }{% else %}nil{% endif %}, nil, "{{ a.meaning }}"),
{%- endfor %}
{%- endfor %}
{%- endfor %}
}

-- The fields of each message, in the order of the wire.
local messages = {
{%- for m in messages %}
    {{ m.name }} = {
{%- for f in m.fields %}
{%- if not f.is_crc %}
        { name = "{{ f.name }}", size = {{ f.size }}{% if f.is_scaled %}, scale = {{ f.scale }}{% endif %}
{%- if f.bits %}, bits = { {% for b in f.bits %}"{{ b.name }}"{% if not loop.last %}, {% endif %}{% endfor %} }{% endif %} },
{%- endif %}
{%- endfor %}
    },
{%- endfor %}
}

-- The arguments of each opcode, in the order of the wire.
local arguments = {
{%- for c in commands %}
{%- if c.arguments %}
    [{{ c.opcode }}] = {
{%- for a in c.arguments %} { name = "{{ a.full_name }}", size = {{ a.size }} },{% endfor %} },
{%- endif %}
{%- endfor %}
}
-- The values of each opcode, in the order of the wire.
local values = {
{%- for c in commands %}
{%- if c.values %}
    [{{ c.opcode }}] = {
{%- for a in c.values %} { name = "{{ a.full_name }}", size = {{ a.size }} },{% endfor %} },
{%- endif %}
{%- endfor %}
}

fields.crc_good = ProtoField.bool("geu.crc_good", "CRC good")
fields.type = ProtoField.uint8("geu.type", "type", base.HEX, type_names)
fields.length = ProtoField.uint8("geu.length", "length")
fields.opcode = ProtoField.uint8("geu.opcode", "opcode", base.HEX, opcode_names)
fields.result = ProtoField.uint8("geu.result", "result", base.DEC, result_names)
fields.excess = ProtoField.bytes("geu.excess", "more than the message has")
fields.skipped = ProtoField.bytes("geu.skipped", "bytes that belong to no frame")
geu.fields = fields

local experts = {
    crc = ProtoExpert.new("geu.crc.bad", "CRC does not match", expert.group.CHECKSUM, expert.severity.ERROR),
    unpaired = ProtoExpert.new("geu.status.unpaired", "STATUS before which no INCREMENTS stood",
        expert.group.SEQUENCE, expert.severity.WARN),
    length = ProtoExpert.new("geu.length.bad", "length that the message does not have",
        expert.group.MALFORMED, expert.severity.ERROR),
    skipped = ProtoExpert.new("geu.skipped.found", "bytes that belong to no frame",
        expert.group.MALFORMED, expert.severity.WARN),
    refused = ProtoExpert.new("geu.result.refused", "the unit refused the command",
        expert.group.RESPONSE_CODE, expert.severity.NOTE),
}
geu.experts = experts

geu.prefs.tcp_port = Pref.uint("TCP port", 4700, "port that carries serial frames; 0 for none")
geu.prefs.can_base = Pref.string("CAN base identifier", can_base_default, "identifier of INCREMENTS, hexadecimal")

-- CRC-16/IBM-3740 over ranges or byte arrays, one after the other.
local function crc16(...)
    local crc = 0xFFFF
    for _, part in ipairs({ ... }) do
        local bytes = typeof(part) == "TvbRange" and part:bytes() or part
        for at = 0, bytes:len() - 1 do
            crc = bit.bxor(crc, bit.lshift(bytes:get_index(at), 8))
            for _ = 1, 8 do
                local carry = bit.band(crc, 0x8000) ~= 0
                crc = bit.band(bit.lshift(crc, 1), 0xFFFF)
                if carry then crc = bit.bxor(crc, 0x1021) end
            end
        end
    end
    return crc
end

-- Adds one number: its field, with the bits of a field of flags below it.
local function add_field(tree, range, layout)
    local field = fields[layout.name]
    if layout.scale then
        tree:add(field, range, range:int() * layout.scale):append_text(" degC")
        return
    end
    local item = tree:add(field, range)
    for _, name in ipairs(layout.bits or {}) do
        item:add(fields[name], range)
    end
end

-- Adds `layouts` from byte `at` of `range` on; returns the position of the next byte. A layout beyond the bytes is
-- said to be cut, and nothing is left over.
local function add_fields(tree, range, at, layouts)
    for _, layout in ipairs(layouts) do
        add_field(tree, range(at, layout.size), layout)
        at = at + layout.size
    end
    return at
end

-- Adds a CRC field with the verdict below it; `computed` is nil where there is nothing to compare with.
local function add_crc(tree, range, computed)
    local item = tree:add(fields.crc, range)
    if computed == nil then
        item:add_proto_expert_info(experts.unpaired)
        return
    end
    local good = computed == range:uint()
    item:add(fields.crc_good, range, good):set_generated()
    if not good then
        item:add_proto_expert_info(experts.crc, string.format("CRC does not match: computed %04X", computed))
    end
end

-- Adds a COMMAND or REPLY and returns what the info column says of it.
local function add_command(tree, range, is_reply)
    local opcode = range(0, 1):uint()
    local text = opcode_names[opcode] or string.format("opcode %02X", opcode)
    tree:add(fields.opcode, range(0, 1))
    local at, layouts = 1, arguments[opcode]
    if is_reply then
        if range:len() < 2 then
            tree:add_proto_expert_info(experts.length)
            return text
        end
        local result = range(1, 1):uint()
        local item = tree:add(fields.result, range(1, 1))
        text = text .. " " .. (result_names[result] or string.format("result %d", result))
        if result ~= 0 then item:add_proto_expert_info(experts.refused) end
        at, layouts = 2, values[opcode]
    end
    at = add_fields(tree, range, at, layouts or {})
    if at < range:len() then tree:add(fields.excess, range(at)) end
    return text
end

-- Whether a payload of that type may have that length.
local function length_fits(type, length)
    local limits = lengths[type]
    return limits ~= nil and length >= limits[1] and length <= limits[2]
end

-- Adds the frame in `range`; its CRC has been checked.
local function add_frame(tree, range)
    local type, length = range(2, 1):uint(), range(3, 1):uint()
    local item = tree:add(geu, range, "Gyro electronics unit, " .. type_names[type])
    item:add(fields.type, range(2, 1))
    item:add(fields.length, range(3, 1))
    local payload, text = range(4, length), type_names[type]
    if messages[text] then
        add_fields(item, payload, 0, messages[text])
        text = text .. " " .. payload(0, 2):uint()
    else
        text = text .. " " .. add_command(item, payload, text == "REPLY")
    end
    add_crc(item, range(4 + length, 2), crc16(range(2, 2 + length)))
    return text
end

local function add_skipped(tree, range)
    local item = tree:add(geu, range, "Gyro electronics unit, no frame")
    item:add(fields.skipped, range):add_proto_expert_info(experts.skipped)
end

-- Result at `at`: "frame" and its length; "missing" and the number of further bytes, if the header is complete; "bad" for
-- a frame with a wrong CRC; "no" for anything else.
local function candidate(tvb, at)
    local rest = tvb:len() - at
    if tvb(at, 1):uint() ~= sync[1] or (rest > 1 and tvb(at + 1, 1):uint() ~= sync[2]) then return "no" end
    if rest < 4 then return "missing", DESEGMENT_ONE_MORE_SEGMENT end
    local length = tvb(at + 3, 1):uint()
    if not length_fits(tvb(at + 2, 1):uint(), length) then return "no" end
    if rest < length + 6 then return "missing", length + 6 - rest end
    local good = crc16(tvb(at + 2, length + 2)) == tvb(at + length + 4, 2):uint()
    if good then return "frame", length + 6 end
    return "bad"
end

local function dissect_serial(tvb, pinfo, tree)
    pinfo.cols.protocol = "GEU"
    local at, skipped_from, texts = 0, nil, {}
    local function end_skipping()
        if skipped_from and skipped_from < at then add_skipped(tree, tvb(skipped_from, at - skipped_from)) end
        skipped_from = nil
    end
    while at < tvb:len() do
        local found, length = candidate(tvb, at)
        if found == "missing" and pinfo.can_desegment > 0 then
            end_skipping()
            pinfo.desegment_offset = at
            pinfo.desegment_len = length
            break
        elseif found == "frame" then
            end_skipping()
            texts[#texts + 1] = add_frame(tree, tvb(at, length))
            at = at + length
        else
            if found == "bad" then
                -- Sync, type and length of a frame with a wrong CRC: report it and continue behind its sync.
                local size = tvb(at + 3, 1):uint()
                local item = tree:add(geu, tvb(at, size + 6), "Gyro electronics unit, CRC does not match")
                add_crc(item, tvb(at + 4 + size, 2), crc16(tvb(at + 2, size + 2)))
                texts[#texts + 1] = "CRC does not match"
            end
            skipped_from = skipped_from or at
            at = at + 1
        end
    end
    if at >= tvb:len() then end_skipping() end
    if #texts > 0 then pinfo.cols.info = table.concat(texts, "; ") end
    return tvb:len()
end

geu.dissector = dissect_serial

-- A connection is ours when a segment begins with a frame. (A call of geu.dissector would go through Wireshark once
-- more, which allows reassembly at the outermost level only.)
geu:register_heuristic("tcp", function(tvb, pinfo, tree)
    if tvb:len() < 4 then return false end
    local found = candidate(tvb, 0)
    if found ~= "frame" and found ~= "missing" then return false end
    pinfo.conversation = geu
    dissect_serial(tvb, pinfo, tree)
    return true
end)

-- STATUS is checked with the INCREMENTS before it on the same interface: found once, in the order of the capture, and
-- kept by packet number, since packets are looked at again in any order.
local interface = Field.new("frame.interface_id")
local waiting, status_crcs, can_base = {}, {}, nil

function geu_can.init()
    waiting, status_crcs = {}, {}
end

local function follow(pinfo, name, tvb)
    if pinfo.visited then return end
    local info = interface()
    local key = info and info.value or 0
    if name == "INCREMENTS" then
        waiting[key] = tvb:len() == 8 and tvb(0, 8):bytes() or nil
    elseif name == "STATUS" and tvb:len() == 8 then
        status_crcs[pinfo.number] = waiting[key] and crc16(waiting[key], tvb(0, 6))
        waiting[key] = nil
    end
end

function geu_can.dissector(tvb, pinfo, tree)
    local name = can_names[pinfo.match_uint - can_base]
    pinfo.cols.protocol = "GEU"
    local item = tree:add(geu_can, tvb(), "Gyro electronics unit, " .. name)
    local text = name
    if messages[name] then
        follow(pinfo, name, tvb)
        if tvb:len() ~= 8 then
            item:add_proto_expert_info(experts.length)
        else
            add_fields(item, tvb(), 0, messages[name])
            if name == "STATUS" then
                text = text .. " " .. tvb(0, 2):uint()
                add_crc(item, tvb(6, 2), status_crcs[pinfo.number])
            end
        end
    else
        text = text .. " " .. add_command(item, tvb(), name == "REPLY")
    end
    pinfo.cols.info = text
    return tvb:len()
end

local tcp_port
local function apply_preferences()
    local ports, identifiers = DissectorTable.get("tcp.port"), DissectorTable.get("can.id")
    if tcp_port and tcp_port > 0 then ports:remove(tcp_port, geu) end
    tcp_port = geu.prefs.tcp_port
    if tcp_port > 0 then ports:add(tcp_port, geu) end
    for offset in pairs(can_names) do
        if can_base then identifiers:remove(can_base + offset, geu_can) end
    end
    can_base = tonumber(geu.prefs.can_base, 16) or tonumber(can_base_default, 16)
    for offset in pairs(can_names) do
        identifiers:add(can_base + offset, geu_can)
    end
end
geu.prefs_changed = apply_preferences
DissectorTable.get("tcp.port"):add_for_decode_as(geu)
apply_preferences()
