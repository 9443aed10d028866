"""The link read without the project's code, by the interface control document alone (protocol/ICD.md)."""
import struct

CLOCK_STEP = 500_000
COLUMNS = ["sequence", "clock_count", "gyrx", "gyry", "gyrza", "gyrzb", "gyro_flags", "unit_flags", "electronics_c",
           "sensor_c"]
CSV_HEADER = ",".join(["t_s"] + COLUMNS)
DATA, COMMAND, REPLY = 0x01, 0x10, 0x11
LENGTHS = {DATA: range(22, 23), COMMAND: range(1, 9), REPLY: range(2, 9)}

#: What to send, what comes back when all is well, and a word for it; a SELF_TEST and a mode are left as they are.
REFUSALS = [
    ("00", "0001", "opcode 00"),
    ("FF0102", "FF01", "opcode FF"),
    ("0100", "0102", "PING with an argument"),
    ("02", "0202", "SET_MODE without its argument"),
    ("0202", "0202", "SET_MODE 2"),
    ("03", "0303", "POLL in cyclic mode"),
    ("0400000101", "0402", "SELF_TEST of no gyro"),
    ("0401000100", "0402", "SELF_TEST of no duration"),
    ("0610", "0602", "GYRO_POWER of a fifth gyro"),
    ("0702", "0702", "HEATER 2"),
]


def crc16(data, crc=0xFFFF):
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc


assert crc16(b"123456789") == 0x29B1


def frame(kind, payload):
    """A serial frame."""
    body = bytes([kind, len(payload)]) + payload
    return b"\xEB\x90" + body + crc16(body).to_bytes(2, "big")


def row(sequence, increments, gyro_flags, unit_flags, electronics, clock, sensor):
    """A sample as `geu decode` prints it, but for t_s: clock and sensor are empty without a CLOCK."""
    cells = [sequence, "" if clock is None else clock, *increments, gyro_flags, unit_flags, f"{electronics / 100:.2f}",
             "" if sensor is None else f"{sensor / 100:.2f}"]
    return dict(zip(COLUMNS, map(str, cells)))


def read_data(payload):
    """The sample in the payload of a DATA frame."""
    sequence, *increments, gyro_flags, unit_flags, electronics = struct.unpack(">H4hBBh", payload[:14])
    clock, (sensor,) = int.from_bytes(payload[14:20], "big"), struct.unpack(">h", payload[20:])
    return row(sequence, increments, gyro_flags, unit_flags, electronics, clock, sensor)


class Deframer:
    """Hunts for frames; counts the bytes that belong to none."""

    def __init__(self):
        self.buffer, self.skipped = b"", 0

    def feed(self, data):
        """The frames that `data` completes: (type, payload)."""
        self.buffer += data
        found = []
        while len(self.buffer) >= 4:
            sync, kind, length = self.buffer[:2], self.buffer[2], self.buffer[3]
            if sync == b"\xEB\x90" and length in LENGTHS.get(kind, ()):
                whole = self.buffer[:length + 6]
                if len(whole) < length + 6:
                    break
                if crc16(whole[2:-2]) == int.from_bytes(whole[-2:], "big"):
                    found.append((kind, whole[4:-2]))
                    self.buffer = self.buffer[length + 6:]
                    continue
            self.buffer = self.buffer[1:]
            self.skipped += 1
        return found


def pair_can(frames, base=0x1A0):
    """Samples from (time, identifier, data): (time of INCREMENTS, row). A clean bus is expected: what does not
    pair by the rules is left out."""
    increments = status = None
    rows = []
    for time, identifier, data in frames:
        if identifier == base:
            increments, status = (time, data), None
        elif identifier == base + 1 and increments:
            good = crc16(increments[1] + data[:6]) == int.from_bytes(data[6:], "big")
            status = (increments, data) if good else None
            increments = None
        elif identifier == base + 2 and status:
            (time, first), second = status
            status = None
            sequence, gyro_flags, unit_flags, electronics = struct.unpack(">HBBh", second[:6])
            clock, (sensor,) = int.from_bytes(data[:6], "big"), struct.unpack(">h", data[6:])
            rows.append((time, row(sequence, struct.unpack(">4h", first), gyro_flags, unit_flags, electronics, clock,
                                   sensor)))
    return rows


def continuous(rows):
    """What is wrong with sequence and clock from row to row; empty when all is well."""
    wrong = []
    for before, now in zip(rows, rows[1:]):
        if int(now["sequence"]) != (int(before["sequence"]) + 1) % 65536:
            wrong.append(f"sequence {before['sequence']} is followed by {now['sequence']}")
        if int(now["clock_count"]) != int(before["clock_count"]) + CLOCK_STEP:
            wrong.append(f"clock {before['clock_count']} is followed by {now['clock_count']}")
    return wrong
