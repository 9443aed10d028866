"""Reads geu.dbc with cantools and checks the vectors of the interface control document. Argument: geu.dbc."""
import sys

import cantools

database = cantools.database.load_file(sys.argv[1], strict=True)


def decode(line, **options):
    identifier, data = line.split("#")
    return database.decode_message(int(identifier, 16), bytes.fromhex(data), **options)


def expect(what, got, expected):
    if got != expected:
        sys.exit(f"{what}: expected {expected}, got {got}")


increments = decode("1A0#FFFEFFFE00050005")
expect("INCREMENTS", increments, {"gyrx": -2, "gyry": -2, "gyrza": 5, "gyrzb": 5})
status = decode("1A1#00000F070810DD5E")
flags = {name: 1 for gyro in ("gyrx", "gyry", "gyrza", "gyrzb") for name in (f"{gyro}_valid",)}
flags |= {f"{gyro}_saturated": 0 for gyro in ("gyrx", "gyry", "gyrza", "gyrzb")}
flags |= {"heater_in_band": 1, "motors_synchronous": 1, "clock_locked": 1, "self_test": 0, "polled": 0}
expect("electronics_c", round(status.pop("electronics_c"), 9), 20.64)
expect("STATUS", status, {"sequence": 0, "crc": 0xDD5E} | flags)
clock = decode("1A2#00000007A1201B58")
expect("CLOCK", clock, {"clock_count": 500_000, "sensor_c": 70.0})

for text, expected in [
    ("1A8#01", {"opcode": "PING"}),
    ("1A8#0201", {"opcode": "SET_MODE", "set_mode_mode": "polled"}),
    ("1A8#03", {"opcode": "POLL"}),
    ("1A8#0403FF9C14", {"opcode": "SELF_TEST", "self_test_gyros": 3, "self_test_counts": -100,
                        "self_test_half_seconds": 20}),
    ("1A8#05", {"opcode": "RESET_SEQUENCE"}),
    ("1A8#060F", {"opcode": "GYRO_POWER", "gyro_power_gyros": 15}),
    ("1A8#0700", {"opcode": "HEATER", "heater_on": "off"}),
    ("1A8#FF", {"opcode": 255}),
    ("1A8#0155", {"opcode": "PING", "unexpected_argument": 0x55}),
    ("1A9#01000100", {"opcode": "PING", "result": "done", "ping_major": 1, "ping_minor": 0}),
    ("1A9#0303", {"opcode": "POLL", "result": "not possible now"}),
    ("1A9#FF01", {"opcode": 255, "result": "unknown opcode"}),
]:
    decoded = decode(text, allow_truncated=True)
    expect(text, {name: getattr(value, "name", value) for name, value in decoded.items()}, expected)

self_test = {"opcode": "SELF_TEST", "self_test_gyros": 3, "self_test_counts": -100, "self_test_half_seconds": 20}
expect("encoded SELF_TEST", database.encode_message("COMMAND", self_test)[:5].hex(), "0403ff9c14")
expect("encoded CLOCK", database.encode_message("CLOCK", clock).hex(), "00000007a1201b58")

for message in database.messages:
    expect(f"{message.name}: cycle", message.cycle_time or 0, 500 if message.name in ("INCREMENTS", "STATUS", "CLOCK") else 0)
    expect(f"{message.name}: sender", message.senders, ["OBC" if message.name == "COMMAND" else "GEU"])
    expect(f"{message.name}: receiver", message.receivers, {"GEU" if message.name == "COMMAND" else "OBC"})
    expect(f"{message.name}: described", [signal.name for signal in message.signals if not signal.comment], [])
