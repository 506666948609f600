-- Wireshark dissector for Nomad robots, written by `nomad wire dissector`; do not edit.
--
--   nomad        the Nserver protocol over TCP, 32-bit and 64-bit clients (port 7019, or any that begins with CONNECT)
--   nomad_line   the protocol of the robot's serial line over TCP (port 65001, or any that begins with a valid frame)
--
-- Replies do not name their request over TCP, and mask and laser mode decide the layout of states. So the requests of a
-- connection are followed in the order of the capture; what they changed is stored per message, because Wireshark
-- dissects packets again in any order.

--@TABLE@

local MAX_OUTSTANDING = 256
local STAMP_WORDS, STAMP_PARTS = 9, {"x", "y", "steer", "turret", "v_trans", "v_steer", "v_turret", "pose_time", "sensor_time"}
local LINE_START, LINE_END = 0x01, 0x5C

-- Protocols and fields ------------------------------------------------------------------------------------------------

local tcp_proto = Proto("nomad", "Nomad robot (Nserver)")
local line_proto = Proto("nomad_line", "Nomad robot (serial line over TCP)")
local fields, list = {}, {}

local function add_field(make, name, label)
  fields[name] = make("nomad." .. name, label)
  list[#list + 1] = fields[name]
end

for _, pair in ipairs(INTEGER_FIELDS) do add_field(ProtoField.int64, pair[1], pair[2]) end
for _, pair in ipairs(REAL_FIELDS) do add_field(ProtoField.double, pair[1], pair[2]) end
for _, pair in ipairs(TEXT_FIELDS) do add_field(ProtoField.string, pair[1], pair[2]) end
tcp_proto.fields = list

local invalid = ProtoExpert.new("nomad.invalid", "Invalid message", expert.group.MALFORMED, expert.severity.WARN)
tcp_proto.experts = {invalid}

line_proto.prefs.models = Pref.string("Models by port", "", "Models of the robots by port, such as 65001=n200 "
  .. "65002=scout. Others are recognized by their frames, and taken for a N150 until then.")
tcp_proto.prefs.ports = Pref.range("TCP ports", "7019", "Ports of Nservers", 65535)
line_proto.prefs.ports = Pref.range("TCP ports", "65001", "Ports of robots that speak the serial protocol over TCP", 65535)

local stream_of = Field.new("tcp.stream")
local connections, stored = {}, {}

local function forget_all() connections, stored = {}, {} end
tcp_proto.init = forget_all

-- State of a connection -----------------------------------------------------------------------------------------------

local function no_mask_model(name) return name ~= "n200" end

local function full_mask(bits)
  local mask = {}
  for slot = 0, 43 do mask[slot] = bits[slot + 1] end
  return mask
end

local function new_connection(server_port)
  return {server_port = server_port, mask = full_mask(EVERYTHING), laser_mode = 51, laser_width = 2,
          outstanding = {}, first = true, requests = 0}
end

local function model_of_port(port)
  for key, model in string.gmatch(line_proto.prefs.models, "(%d+)%s*=%s*(%w+)") do
    if tonumber(key) == port then return model end
  end
end

local function set_model(state, model)
  state.model = model
  state.mask = full_mask(no_mask_model(model) and NO_MASK_MODELS or EVERYTHING)
end

local function get_connection(pinfo, server_port)
  local key = stream_of().value
  if not connections[key] then connections[key] = new_connection(server_port) end
  return connections[key]
end

local function contains(set, value)
  for _, one in ipairs(set) do if one == value then return true end end
  return false
end

local function tcp_laser_width(mode)
  if contains(TCP_LINE_MODES, mode) then return 4 end
  return contains(POINT_MODES, mode) and 2 or 1
end

local function get_laser_width(mode)
  local width = tcp_laser_width(mode)
  return width == 4 and 2 or width
end

local function has_bit(value, bit_value) return math.floor(value / bit_value) % 2 == 1 end

local function mask_from_bytes(bytes, tail)
  local mask = {}
  for slot = 1, 40 do
    mask[slot] = has_bit(bytes[math.floor((slot - 1) / 8) + 1], 2 ^ ((slot - 1) % 8)) and 1 or 0
  end
  mask[0], mask[41], mask[42], mask[43] = tail[1], tail[2], tail[3], tail[4]
  return mask
end

local function mask_of_ct(bytes, is_line)
  local b5, b6 = bytes[6], bytes[7]
  if is_line then return mask_from_bytes(bytes, {math.floor(b6 / 2) % 32, 1, b5 % 2, b6 % 2}) end
  return mask_from_bytes(bytes, {b6 % 32, math.floor(b5 / 2) % 2, math.floor(b5 / 4) % 2, math.floor(b5 / 8) % 2})
end

-- Change the connection as its request does; the reply to this very request has the new layout.
local function apply_request(state, row, items, is_line)
  if row.name == "ct" then
    local mask = {}
    for slot = 0, 43 do mask[slot] = items[slot + 1].value end
    state.mask = mask
  elseif row.name == "conf_ls" then
    state.laser_mode = items[1].value
    state.laser_width = tcp_laser_width(state.laser_mode)
  elseif row.name == "get_sg" and not is_line then
    state.laser_width = 4
  elseif row.name == "get_ls" and not is_line and contains(TCP_LINE_MODES, state.laser_mode) then
    state.laser_width = 2
  end
end

-- Reading: every reader returns a list of items {field, offset, length, value}, or nil and the reason ---------------------

local function item(field, at, length, value) return {field = field, at = at, length = length, value = value} end

local function signed(value) return value >= 2 ^ 31 and value - 2 ^ 32 or value end

-- Words of a message over TCP: value and place of each.
local function read_words(range, count, wide, is_reply)
  local words = {}
  for k = 0, count - 1 do
    local at = 4 + (wide and 8 or 4) * k + ((wide and not is_reply) and 4 or 0)
    words[k + 1] = {at = at, raw = range(at, 4):uint()}
    words[k + 1].value = signed(words[k + 1].raw)
  end
  return words
end

local function stamp_key_lists(layout, mask)
  local keys = {}
  for _, bit_value in ipairs(layout.stamps or {}) do
    if has_bit(mask[0], bit_value) then
      for _, key in ipairs(STAMP_KEYS[bit_value]) do keys[#keys + 1] = key end
    end
  end
  return keys
end

local function read_tcp_reply(layout, words, state)
  local items, at = {}, 1
  local function take(field, is_unsigned)
    local word = words[at]
    if not word then return false end
    local value = (is_unsigned or state.wide) and word.raw or word.value
    items[#items + 1] = item(field, word.at, 4, value)
    at = at + 1
    return true
  end
  -- 1. Plain words, State slots, readings of the laser behind their number.
  for _ = 1, layout.values or #words do if not take("value") then return nil end end
  if layout.first then
    for slot = layout.first, layout.last do if not take(SLOTS[slot + 1]) then return nil end end
  end
  if layout.laser then
    local count = words[at] and words[at].value
    local width = layout.laser == "state" and state.laser_width or layout.laser == "get" and state.get_laser_width or 4
    if not count or count < 0 or count > MAX_LASER_READINGS then return nil end
    take("laser_count")
    for _ = 1, count * width do if not take("laser_value") then return nil end end
  end
  -- 2. Stamps and clock.
  for _, key in ipairs(stamp_key_lists(layout, state.mask)) do
    if not words[at + STAMP_WORDS - 1] then return nil end
    items[#items + 1] = item("position", words[at].at, STAMP_WORDS * (state.wide and 8 or 4), key)
    for k = 1, STAMP_WORDS do take("position." .. STAMP_PARTS[k], k > 7) end
  end
  if layout.clock and not take("clock", true) then return nil end
  -- 3. Battery.
  if layout.volts then
    for _, name in ipairs({"cpu_raw", "motor_raw"}) do
      if not words[at] then return nil end
      items[#items + 1] = item(name, words[at].at, 4, words[at].value)
      at = at + 1
    end
  end
  if at ~= #words + 1 then return nil end
  return items
end

-- Bytes of a frame on the serial line, low byte first; numbers are sign-magnitude.
local function read_number(range, at, size, is_signed)
  local raw = range(at, size):le_uint()
  local sign = 2 ^ (8 * size - 1)
  return (is_signed and raw >= sign) and sign - raw or raw
end

local function selected_slots(part, mask)
  local slots = {}
  for slot = part.first, part.last do
    if not part.masked or mask[slot] == 1 then slots[#slots + 1] = slot end
  end
  return slots
end

local function read_line_reply(parts, range, state)
  local items, at, size = {}, 0, range and range:len() or 0
  local function fits(count) return at + count <= size end
  local function take(field, count, is_signed)
    items[#items + 1] = item(field, at, count, read_number(range, at, count, is_signed))
    at = at + count
  end
  for _, part in ipairs(parts) do
    if part.op == "slots" then
      local slots = selected_slots(part, state.mask)
      if not fits(#slots * part.size) then return nil end
      for _, slot in ipairs(slots) do take(SLOTS[slot + 1], part.size, part.signed) end
    elseif part.op == "nibbles" then
      local slots = selected_slots(part, state.mask)
      if not fits(math.floor((#slots + 1) / 2)) then return nil end
      for k, slot in ipairs(slots) do
        local byte = range(at + math.floor((k - 1) / 2), 1):uint()
        local value = k % 2 == 1 and byte % 16 or math.floor(byte / 16)
        items[#items + 1] = item(SLOTS[slot + 1], at + math.floor((k - 1) / 2), 1, value)
      end
      at = at + math.floor((#slots + 1) / 2)
    elseif part.op == "bumper" then
      for _ in ipairs(selected_slots(part, state.mask)) do
        if not fits(3) then return nil end
        local value = state.model == "scout" and range(at, 3):le_uint() or range(at, 3):uint()
        items[#items + 1] = item(SLOTS[part.first + 1], at, 3, value)
        at = at + 3
      end
    elseif part.op == "stamps" then
      if has_bit(state.mask[0], part.bit) then
        for k, key in ipairs(STAMP_KEYS[part.bit]) do
          if not part.first or state.mask[part.first + k - 1] == 1 then
            if not fits(36) then return nil end
            items[#items + 1] = item("position", at, 36, key)
            for word = 1, STAMP_WORDS do take("position." .. STAMP_PARTS[word], 4, word <= 7) end
          end
        end
      end
    elseif part.op == "laser" then
      if not part.masked_by or state.mask[part.masked_by] == 1 then
        local width = part.width
        if width == 0 then width = math.floor(state.laser_mode / 2) % 16 == 0 and 4 or 1 end
        if not fits(2) then return nil end
        local count = range(at, 2):le_uint()
        if count > MAX_LASER_READINGS or not fits(2 + 2 * count * width) then return nil end
        take("laser_count", 2, false)
        for _ = 1, count * width do take("laser_value", 2, width ~= 1) end
      end
    elseif part.op == "bytes" then
      local count = part.count or size - at
      if not fits(count) then return nil end
      for _ = 1, count do take("value", 1, false) end
    else
      -- clock, cpu_raw, motor_raw
      if not fits(part.size) then return nil end
      take(part.op, part.size, false)
    end
  end
  if at ~= size then return nil end
  return items
end

-- Arguments of requests ------------------------------------------------------------------------------------------------

-- A text that ends at the first NUL; Latin-1, which Wireshark shows as UTF-8.
local function text_of(bytes)
  local out = {}
  for _, byte in ipairs(bytes) do
    if byte == 0 then break end
    out[#out + 1] = byte < 128 and string.char(byte) or string.char(192 + math.floor(byte / 64), 128 + byte % 64)
  end
  return table.concat(out)
end

local function has_nul(bytes) return contains(bytes, 0) end

local function mask_items(bytes, places, is_line)
  local mask, items = mask_of_ct(bytes, is_line), {}
  for slot = 0, 43 do
    local byte = slot == 0 and 7 or slot > 40 and ((is_line and slot ~= 42) and 7 or 6) or math.floor((slot - 1) / 8) + 1
    items[slot + 1] = item("smask", places[byte].at, places[byte].length, mask[slot])
  end
  return items
end

-- A user packet in bytes: length (low byte first), serial, type, data; a row of the arm has fields of fixed sizes.
local function packet_items(row, bytes, places)
  if #bytes < 4 or bytes[1] + 256 * bytes[2] ~= #bytes then return nil end
  local items = {}
  if not row.packet then
    items[1] = item("packet_type", places[4].at, places[4].length, bytes[4])
    for k = 5, #bytes do items[#items + 1] = item("number", places[k].at, places[k].length, bytes[k]) end
    return items
  end
  local at = 5
  for k, argument in ipairs(row.arguments) do
    local size, value = row.packet[k], 0
    if at + math.abs(size) - 1 > #bytes then return nil end
    for byte = math.abs(size), 1, -1 do value = value * 256 + bytes[at + byte - 1] end
    if size < 0 then value = signed(value) end
    local last = places[at + math.abs(size) - 1]
    items[k] = item(argument, places[at].at, last.at + last.length - places[at].at, value)
    at = at + math.abs(size)
  end
  return at == #bytes + 1 and items or nil
end

local function word_items(row, words)
  local items, bytes = {}, {}
  for k, word in ipairs(words) do bytes[k], word.length = word.raw % 256, 4 end
  if row.tcp_form == "mask" then return mask_items(bytes, words, false) end
  if row.tcp_form == "packet" then return packet_items(row, bytes, words) end
  if row.tcp_form == "text" then
    local letters = {}
    for _, word in ipairs(words) do
      for k = 0, 3 do letters[#letters + 1] = math.floor(word.raw / 256 ^ k) % 256 end
    end
    return {item(row.arguments[1], words[1].at, words[#words].at + 4 - words[1].at, text_of(letters))}
  end
  if row.tcp_form == "obstacle" then
    local n = words[1].value
    if n < 1 or n > MAX_OBSTACLE_VERTICES or #words ~= 1 + 2 * n + row.tail then return nil end
  elseif row.tcp_form == "motion" then
    local kind = words[1].value
    if kind ~= 0 and kind ~= 1 then return nil end
    items[1] = item("real", words[1].at, 4, kind)
    for k = 2, kind == 0 and 5 or 8 do
      local is_angle = kind == 1 and (k == 4 or k == 5)
      items[k] = item("real", words[k].at, 4, is_angle and words[k].value / 1000 or words[k].value * 10)
    end
    return items
  end
  for k, word in ipairs(words) do
    local value = word.value
    if row.flags and row.flags[k] then value = value ~= 0 and 1 or 0 end
    items[k] = item(row.arguments[k] and not row.any_length and row.arguments[k] or "number", word.at, 4, value)
  end
  return items
end

local function line_items(row, range)
  local size, bytes, places = range and range:len() or 0, {}, {}
  for k = 0, size - 1 do bytes[k + 1], places[k + 1] = range(k, 1):uint(), {at = k, length = 1} end
  if row.line_form == "packet" then return packet_items(row, bytes, places) end
  if row.line_form == "mask" then return size == 7 and mask_items(bytes, places, true) or nil end
  if row.line_form == "text" then
    return has_nul(bytes) and {item(row.arguments[1], 0, size, text_of(bytes))} or nil
  end
  local items, at = {}, 0
  for k, form in ipairs(row.line) do
    local width = (form == "signed" or form == "unsigned") and 2 or 1
    if at + width > size then return nil end
    local value = read_number(range, at, width, form == "signed")
    if form == "flag" then value = value ~= 0 and 1 or 0 end
    if form == "laser_mode" and value == 35 then value = 51 end
    items[k] = item(row.arguments[k], at, width, value)
    at = at + width
  end
  return at == size and items or nil
end

-- Showing --------------------------------------------------------------------------------------------------------------

-- C clients compute volts in single precision.
local function single(value) return (Struct.unpack("<f", Struct.pack("<f", value))) end
local function volts(raw, full_range) return single((2 + 3 * raw / 255) * single(full_range) / 5) end

local function add_items(tree, range, items)
  local position
  for _, one in ipairs(items) do
    local target, at = tree, one.length > 0 and range(one.at, one.length) or range
    if string.sub(one.field, 1, 9) == "position." then target = position end
    local field = fields[one.field]
    local value = one.value
    if one.field == "position" or type(value) == "string" then
      local added = target:add(field, at, value)
      if one.field == "position" then position = added end
    elseif one.field == "real" then
      target:add(field, at, value)
    else
      target:add(field, at, Int64.new(value))
    end
    if one.field == "cpu_raw" then target:add(fields.volt_cpu, at, volts(value, CPU_RANGE_V)):set_generated() end
    if one.field == "motor_raw" then target:add(fields.volt_motor, at, volts(value, MOTOR_RANGE_V)):set_generated() end
  end
end

-- Values that the C call returns, computed from the plain numbers of its reply.
local function add_results(tree, kind, name, items)
  local numbers = {}
  for _, one in ipairs(items) do if one.field == "value" then numbers[#numbers + 1] = one.value end end
  local function add(field, value, is_real)
    tree:add(fields[field], is_real and value or Int64.new(value)):set_generated()
  end
  if kind == "error" then add("code", numbers[1]) end
  if kind == "special" and (name == "arm_zr" or name == "arm_ws" or name == "arm_mv") then
    local function long(at)
      return numbers[at] % 256 + numbers[at + 1] % 256 * 2 ^ 8 + numbers[at + 2] % 256 * 2 ^ 16 + numbers[at + 3] % 256 * 2 ^ 24
    end
    if #numbers >= 8 then add("arm", signed(long(5))) end
    if name == "arm_ws" and #numbers >= 12 then add("remain", long(9)) end
  elseif name == "motion_check" and kind == "simple" then
    for k, divisor in ipairs({100, 100, 1e6}) do add("collide", numbers[k + 1] / divisor, true) end
  end
end

local function text_of_items(items, limit)
  local words = {}
  for k, one in ipairs(items) do
    if k > limit then words[k] = "..." break end
    words[k] = tostring(one.value)
  end
  return table.concat(words, " ")
end

local POSE = {x = true, y = true, steer = true, turret = true}
local function summary_of_reply(kind, items)
  local words = {kind}
  for _, one in ipairs(items) do
    if POSE[one.field] or one.field == "value" then
      words[#words + 1] = one.field == "value" and tostring(one.value) or one.field .. " " .. one.value / 10
    end
    if #words > 12 then break end
  end
  return table.concat(words, " ")
end

local function start_message(proto, range, pinfo, tree, is_reply, type_range, type_value)
  pinfo.cols.protocol = proto == tcp_proto and "Nomad" or "Nomad line"
  local branch = tree:add(proto, range)
  branch:add(fields.to, is_reply and "host" or "robot"):set_generated()
  if type_range then branch:add(fields.type, type_range, Int64.new(type_value)) end
  return branch
end

local function show(branch, pinfo, data, decoded)
  if decoded.error then
    branch:add_proto_expert_info(invalid, decoded.error)
    branch:add(fields.error, decoded.error):set_generated()
    branch:append_text(", invalid: " .. decoded.error)
    pinfo.cols.info:append("[" .. decoded.error .. "] ")
    return
  end
  local summary
  if decoded.call then
    branch:add(fields.call, decoded.call):set_generated()
    summary = decoded.call == "ct" and "ct" or decoded.call .. " " .. text_of_items(decoded.items, 12)
  else
    branch:add(fields.reply, decoded.reply):set_generated()
    if decoded.name then branch:add(fields.reply_to, decoded.name):set_generated() end
    summary = summary_of_reply(decoded.reply, decoded.items)
  end
  branch:append_text(", " .. summary)
  pinfo.cols.info:append((decoded.call and "> " or "< ") .. summary .. "  ")
  add_items(branch, data, decoded.items)
  if decoded.reply then add_results(branch, decoded.reply, decoded.name, decoded.items) end
end

-- Return the result of decode(), computed once per message: later passes come in any order.
local function once(pinfo, tvb, at, size, decode)
  local key = string.format("%d:%d:%d:%d", pinfo.number, tvb:offset(), at, size)
  if not stored[key] then stored[key] = decode() end
  return stored[key]
end

-- Nserver over TCP -----------------------------------------------------------------------------------------------------

local function decode_tcp_request(state, message_type, words)
  local row = BY_TCP_TYPE[message_type]
  if not row then return {error = "unknown message type " .. message_type} end
  if #words < row.words[1] or #words > row.words[2] then
    return {error = string.format("%s takes %d to %d words, not %d", row.name, row.words[1], row.words[2], #words)}
  end
  local items
  -- Packets of the arm are special requests with a packet type of their own.
  local packet = row.name == "special_request" and words[4] and BY_PACKET_TYPE[words[4].raw % 256]
  if packet then items = word_items(packet, words) end
  if items then row = packet else items = word_items(row, words) end
  if not items then return {error = row.name .. ": invalid arguments"} end
  apply_request(state, row, items, false)
  if row.has_reply then
    if #state.outstanding >= MAX_OUTSTANDING then table.remove(state.outstanding, 1) end
    state.outstanding[#state.outstanding + 1] = {row = row, mask = state.mask, laser_width = state.laser_width,
      get_laser_width = get_laser_width(state.laser_mode), wide = state.wide}
  end
  return {call = row.name, items = items}
end

local function decode_tcp_reply(state, message_type, words)
  -- 1. The first outstanding request that fits; earlier ones got no reply.
  local reply_type = SAME_SHAPE[message_type] or message_type
  for place, request in ipairs(state.outstanding) do
    local layout
    if reply_type == ERROR_TYPE then layout = ERROR_LAYOUT
    elseif reply_type == request.row.reply_type then layout = request.row.reply end
    local items = layout and read_tcp_reply(layout, words, request)
    if items then
      for _ = 1, place do table.remove(state.outstanding, 1) end
      return {reply = layout.kind, name = request.row.name, items = items}
    end
  end
  -- 2. The type alone decides.
  local now = {mask = state.mask, laser_width = state.laser_width, get_laser_width = get_laser_width(state.laser_mode),
               wide = state.wide}
  for _, layout in ipairs(BY_REPLY_TYPE[reply_type] or {}) do
    local items = read_tcp_reply(layout, words, now)
    if items then return {reply = layout.kind, items = items} end
  end
  return {error = "no reply of type " .. message_type .. " and " .. #words .. " words"}
end

local function bounds_of(message_type, is_reply)
  if is_reply then
    return MAX_REPLY_WORDS[message_type] and 1, MAX_REPLY_WORDS[message_type]
  end
  local row = BY_TCP_TYPE[message_type]
  if row then return row.words[1], row.words[2] end
end

local CONNECT_TYPES = {[101] = true, [102] = true, [103] = true}

-- Word size of a connection: robot numbers are at least 1, so a CONNECT whose first word is 0 is of a 64-bit client.
local function find_width(state, tvb, at, message_type, count, is_reply)
  if state.wide ~= nil then return true end
  local rest = tvb:len() - at
  if CONNECT_TYPES[message_type] and not is_reply then
    if rest < 8 then return false end
    state.wide = tvb(at + 4, 4):uint() == 0 and rest ~= 4 + 4 * count
  else
    -- The capture begins in the middle: a message that fills its segment shows the size.
    state.wide = count > 0 and rest == 4 + 8 * count
  end
  return true
end

function tcp_proto.dissector(tvb, pinfo, tree)
  local known = connections[stream_of().value]
  local state = known or get_connection(pinfo, pinfo.dst_port)
  if not known then
    -- Of two ports the one in the preferences is the server's; else the first message seen is a request.
    local value = DissectorTable.get("tcp.port"):get_dissector(pinfo.src_port)
    if value and tostring(value) == tostring(Dissector.get("nomad")) then state.server_port = pinfo.src_port end
  end
  local is_reply = pinfo.src_port == state.server_port
  pinfo.cols.protocol = "Nomad"
  pinfo.cols.info = ""
  local at, size = 0, tvb:len()
  while at < size do
    local function need_more()
      pinfo.desegment_offset, pinfo.desegment_len = at, DESEGMENT_ONE_MORE_SEGMENT
      return size
    end
    if size - at < 4 then return need_more() end
    local message_type, count = tvb(at, 2):int(), tvb(at + 2, 2):uint()
    local least, most = bounds_of(message_type, is_reply)
    if not least or count < least or count > most then
      -- Skip a message that no table has; after an absurd count nothing behind it can be read.
      local word = state.wide and 8 or 4
      local length = count > MAX_UNKNOWN_WORDS and size - at or math.min(4 + word * count, size - at)
      local range = tvb(at, length)
      local branch = start_message(tcp_proto, range, pinfo, tree, is_reply, tvb(at, 2), message_type)
      show(branch, pinfo, range, {error = least and "wrong number of words" or "unknown message type " .. message_type})
      at = at + length
    else
      if not find_width(state, tvb, at, message_type, count, is_reply) then return need_more() end
      local length = 4 + (state.wide and 8 or 4) * count
      if size - at < length then
        pinfo.desegment_offset, pinfo.desegment_len = at, length - (size - at)
        return size
      end
      local range = tvb(at, length)
      local decoded = once(pinfo, tvb, at, length, function()
        local words = read_words(range, count, state.wide, is_reply)
        return (is_reply and decode_tcp_reply or decode_tcp_request)(state, message_type, words)
      end)
      local branch = start_message(tcp_proto, range, pinfo, tree, is_reply, tvb(at, 2), message_type)
      branch:add(fields.count, tvb(at + 2, 2), Int64.new(count))
      branch:add(fields.word_bits, Int64.new(state.wide and 64 or 32)):set_generated()
      show(branch, pinfo, range, decoded)
      at = at + length
    end
  end
  return size
end

tcp_proto:register_heuristic("tcp", function(tvb, pinfo, tree)
  if tvb:len() ~= 12 and tvb:len() ~= 20 then return false end
  if not CONNECT_TYPES[tvb(0, 2):uint()] or tvb(2, 2):uint() ~= 2 then return false end
  if tvb:len() == 20 and (tvb(4, 4):uint() ~= 0 or tvb(12, 4):uint() ~= 0) then return false end
  pinfo.conversation = tcp_proto
  tcp_proto.dissector(tvb, pinfo, tree)
  return true
end)

-- The serial line over TCP ----------------------------------------------------------------------------------------------

local HANDSHAKE_SIZE = 11

-- Return the size of the frame at this place: a number; 0 where more bytes are needed; nil if none begins here.
local function frame_size(tvb, at, limit)
  local rest = tvb:len() - at
  if tvb(at, 1):uint() ~= LINE_START then return nil end
  if rest < 3 then return 0 end
  local size = 4 + tvb(at + 1, 2):le_uint()
  if size < 6 or size > limit then return nil end
  if rest < size then return 0 end
  local sum = 0
  for k = 0, size - 3 do sum = sum + tvb(at + k, 1):uint() end
  if tvb(at + size - 1, 1):uint() ~= LINE_END or sum % 256 ~= tvb(at + size - 2, 1):uint() then return nil end
  return size
end

local function apply_handshake(state, tvb, at)
  local bytes = {}
  for k = 0, 4 do bytes[k + 1] = tvb(at + k, 1):uint() end
  local compass, laser = tvb(at + 5, 1):uint(), tvb(at + 6, 1):uint()
  bytes[6], bytes[7] = laser % 2, compass % 2 + math.floor(laser / 2) % 32 * 2
  state.model = "n200"
  state.mask = mask_of_ct(bytes, true)
  state.laser_mode = tvb(at + 7, 1):uint()
  local items = {}
  for slot = 0, 43 do items[slot + 1] = item("smask", at, 8, state.mask[slot]) end
  items[#items + 1] = item("laser_mode", at + 7, 1, state.laser_mode)
  return {reply = "hello", items = items}
end

local function decode_line_request(state, frame_type, data)
  local row = BY_LINE_TYPE[frame_type]
  if not row then return {error = "type " .. frame_type .. " does not exist on a robot's line"} end
  -- A command that only a N200 has shows the model.
  if not state.is_model_certain and row.only_n200 then
    set_model(state, "n200")
    state.is_model_certain = true
  end
  if not row.models[state.model] then
    return {error = string.format("type %d does not exist on the line of a %s", frame_type, state.model)}
  end
  local items
  local packet = row.name == "special_request" and data and data:len() > 3 and BY_PACKET_TYPE[data(3, 1):uint()]
  if packet then items = line_items(packet, data) end
  if items then row = packet else items = line_items(row, data) end
  if not items then return {error = row.name .. ": invalid arguments"} end
  apply_request(state, row, items, true)
  state.request = row
  return {call = row.name, items = items}
end

local function decode_line_reply(state, frame_type, data)
  if frame_type == NAK_TYPE then return {reply = "nak", items = {}} end
  local row = BY_LINE_TYPE[frame_type]
  if not row then return {error = "no answer of type " .. frame_type .. " comes from a robot"} end
  if not row.models[state.model] then
    return {error = string.format("no answer of type %d comes from a %s", frame_type, state.model)}
  end
  local items = read_line_reply(row.line_reply, data, state)
  -- A state that does not fit shows a N200; bumper bits that are 0 at rest show a Scout.
  if not state.is_model_certain and row.line_kind == "state" then
    if not items then
      set_model(state, "n200")
      items = read_line_reply(row.line_reply, data, state)
      state.is_model_certain = items ~= nil
    else
      for _, one in ipairs(items) do
        if one.field == "bumper" and state.model == "n150" and one.value < 0xF00000 then
          set_model(state, "scout")
          items = read_line_reply(row.line_reply, data, state)
        end
      end
      state.is_model_certain = true
    end
  end
  if not items then return {error = "no " .. row.line_kind .. " reply of this shape"} end
  local request = state.request
  local name = (request and request.line_type == frame_type) and request.name or row.name
  return {reply = row.line_kind, name = name, items = items}
end

local function start_line(pinfo, server_port)
  local state = get_connection(pinfo, server_port)
  if not state.is_line then
    state.is_line = true
    local model = model_of_port(server_port)
    state.is_model_certain = model ~= nil
    set_model(state, model or "n150")
  end
  return state
end

local function shift(items, by)
  for _, one in ipairs(items) do one.at = one.at + by end
end

function line_proto.dissector(tvb, pinfo, tree)
  local known = connections[stream_of().value]
  local server_port = pinfo.dst_port
  if not known then
    local value = DissectorTable.get("tcp.port"):get_dissector(pinfo.src_port)
    if value and tostring(value) == tostring(Dissector.get("nomad_line")) then server_port = pinfo.src_port end
  end
  local state = start_line(pinfo, server_port)
  local is_reply = pinfo.src_port == state.server_port
  pinfo.cols.protocol = "Nomad line"
  pinfo.cols.info = ""
  local at, size = 0, tvb:len()
  -- The handshake of a N200: eleven bytes without a frame, before anything else.
  local handshake = once(pinfo, tvb, 0, -1, function()
    local may_be = is_reply and not state.has_reply and (not state.is_model_certain or state.model == "n200")
    local framed = size >= HANDSHAKE_SIZE and tvb(0, 1):uint() == LINE_START and tvb(HANDSHAKE_SIZE - 1, 1):uint() == LINE_END
    if is_reply then state.has_reply = true end
    if may_be and size >= HANDSHAKE_SIZE and not framed and not frame_size(tvb, 0, ROBOT_LIMIT) then
      local rest = size - HANDSHAKE_SIZE
      if rest == 0 or tvb(HANDSHAKE_SIZE, 1):uint() == LINE_START then
        state.is_model_certain = true
        return apply_handshake(state, tvb, 0)
      end
    end
    return {}
  end)
  if handshake.reply then
    local range = tvb(0, HANDSHAKE_SIZE)
    show(start_message(line_proto, range, pinfo, tree, true), pinfo, range, handshake)
    at = HANDSHAKE_SIZE
  end
  local skipped
  local function show_skipped()
    if not skipped then return end
    local range = tvb(skipped, at - skipped)
    show(start_message(line_proto, range, pinfo, tree, is_reply), pinfo, range,
         {error = range:len() .. " bytes that are no frame"})
    skipped = nil
  end
  while at < size do
    local length = frame_size(tvb, at, is_reply and ROBOT_LIMIT or HOST_LIMIT)
    if length == 0 then
      show_skipped()
      pinfo.desegment_offset, pinfo.desegment_len = at, DESEGMENT_ONE_MORE_SEGMENT
      return size
    elseif length == nil then
      skipped = skipped or at
      at = at + 1
    else
      show_skipped()
      local range = tvb(at, length)
      local frame_type = tvb(at + 3, 1):uint()
      local decoded = once(pinfo, tvb, at, length, function()
        local data = length > 6 and range(4, length - 6) or nil
        local found = (is_reply and decode_line_reply or decode_line_request)(state, frame_type, data)
        if found.items then shift(found.items, 4) end
        return found
      end)
      local branch = start_message(line_proto, range, pinfo, tree, is_reply, tvb(at + 3, 1), frame_type)
      branch:add(fields.length, tvb(at + 1, 2), Int64.new(length - 4))
      branch:add(fields.checksum, tvb(at + length - 2, 1), Int64.new(tvb(at + length - 2, 1):uint()))
      show(branch, pinfo, range, decoded)
      at = at + length
    end
  end
  show_skipped()
  return size
end

-- On any other port: a connection whose first segment from the client is exactly one valid frame of a known command.
line_proto:register_heuristic("tcp", function(tvb, pinfo, tree)
  if tvb:len() < 6 or tvb:len() > HOST_LIMIT or frame_size(tvb, 0, HOST_LIMIT) ~= tvb:len() then return false end
  if not BY_LINE_TYPE[tvb(3, 1):uint()] then return false end
  pinfo.conversation = line_proto
  line_proto.dissector(tvb, pinfo, tree)
  return true
end)

-- Ports ----------------------------------------------------------------------------------------------------------------

local tcp_ports = DissectorTable.get("tcp.port")
local registered = {}

local function register(proto)
  if registered[proto.name] then tcp_ports:remove(registered[proto.name], proto) end
  registered[proto.name] = proto.prefs.ports
  tcp_ports:add(proto.prefs.ports, proto)
end

function tcp_proto.prefs_changed() register(tcp_proto) end
function line_proto.prefs_changed() register(line_proto) end
register(tcp_proto)
register(line_proto)
