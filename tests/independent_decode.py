"""Reads a clean candump log (.gz) by the interface control document alone: the rows that `geu decode` must give."""
import gzip, struct, sys

frames = {}
for line in gzip.open(sys.argv[1], "rt"):
    time, _interface, frame = line.split()
    identifier, data = frame.split("#")
    frames[identifier] = (time.strip("()"), bytes.fromhex(data))
    if identifier == "1A2":
        increments = struct.unpack(">4h", frames["1A0"][1])
        sequence, gyro_flags, unit_flags, electronics, _crc = struct.unpack(">HBBhH", frames["1A1"][1])
        clock, sensor = int.from_bytes(frames["1A2"][1][:6], "big"), struct.unpack(">h", frames["1A2"][1][6:])[0]
        print(frames["1A0"][0], sequence, clock, *increments, gyro_flags, unit_flags,
              f"{electronics / 100:.2f}", f"{sensor / 100:.2f}", sep=",")
