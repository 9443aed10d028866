"""Makes the captures here that no tool makes from `encoded.log`; see README.md."""
import datetime, struct
import can

frames = []
for line in open("encoded.log"):
    time, interface, frame = line.split()
    seconds, micros = time.strip("()").split(".")
    identifier, data = frame.split("#")
    frames.append((int(seconds) * 10**6 + int(micros), interface, int(identifier, 16), bytes.fromhex(data)))

# As fprintf_long_canframe of can-utils writes, with the times of -t a, A, z, d and none, -x and -a in some.
def console(name, stamp, direction="", ascii=False):
    with open(name, "w") as out:
        before = frames[0][0]
        for t_us, interface, identifier, data in frames:
            text = " ".join(f"{byte:02X}" for byte in data)
            tail = "   '" + "".join(chr(b) if 32 <= b < 127 else "." for b in data) + "'" if ascii else ""
            out.write(f" {stamp(t_us, before)} {interface}  {direction}{identifier:03X}   [{len(data)}]  {text}{tail}\n")
            before = t_us

utc = datetime.timezone.utc
date = lambda t: datetime.datetime.fromtimestamp(t // 10**6, utc).strftime("%Y-%m-%d %H:%M:%S")
first = frames[0][0]
console("encoded-console-a.txt", lambda t, before: f"({t // 10**6:010d}.{t % 10**6:06d}) ", "RX - -  ", True)
console("encoded-console-A.txt", lambda t, before: f"({date(t)}.{t % 10**6:06d}) ")
console("encoded-console-z.txt", lambda t, before: f"({(t - first) // 10**6:03d}.{(t - first) % 10**6:06d}) ")
console("encoded-console-d.txt", lambda t, before: f"({(t - before) // 10**6:03d}.{(t - before) % 10**6:06d}) ")
console("encoded-console.txt", lambda t, before: "")

# Linux cooked capture, as `tcpdump -i any` makes it; the identifier in the order of the machine.
with open("encoded-sll.pcap", "wb") as out:
    out.write(struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 113))
    for t_us, _, identifier, data in frames:
        packet = struct.pack(">HHH8sH", 1, 280, 0, bytes(8), 0x000C) + struct.pack("<IBxxx", identifier, len(data)) + data
        out.write(struct.pack("<IIII", t_us // 10**6, t_us % 10**6, len(packet), len(packet)) + packet)

# LINKTYPE_CAN_SOCKETCAN, nanoseconds, big-endian throughout, as `tcpdump -i can0 --nano` makes it on such a machine.
with open("encoded-socketcan.pcap", "wb") as out:
    out.write(struct.pack(">IHHiIII", 0xA1B23C4D, 2, 4, 0, 0, 65535, 227))
    for t_us, _, identifier, data in frames:
        packet = struct.pack(">IBxxx", identifier, len(data)) + data
        out.write(struct.pack(">IIII", t_us // 10**6, t_us % 10**6 * 1000, len(packet), len(packet)) + packet)

for suffix in ("asc", "trc", "csv", "blf"):
    with can.Logger(f"encoded-python-can.{suffix}") as writer:
        for t_us, _, identifier, data in frames:
            writer(can.Message(timestamp=t_us / 1e6, arbitration_id=identifier, is_extended_id=False, data=data, channel=0))

# The first twelve half seconds among everything that is known to occur.
lines = open("encoded.log").read().splitlines()[:36]
wild = ["# recorded on the bench", lines[0].replace(" can0 ", "    can0 "), "(1795020000.500980) can0 123#1122", lines[1] + " R", lines[2] + " T"]
wild += ["(1795020000.600000) can0 1A8#01", "(1795020000.610000) can0 1A9#01000100", ""]
wild += lines[3:6] + ["(1795020001.100000) can0 1A0#R", "(1795020001.100000) can0 123#R8"]
wild += [lines[6].replace(") ", "000) "), lines[7].lower(), lines[8] + "\r", "(1795020001.600000) can0 000001A0#FFFE000100050005"]
wild += ["(1795020001.700000) can0 1A0##1FFFE0001000500050011223344556677", "(1795020001.700000) can0 20000004#0001000000000000"]
wild += lines[9:12] + ["DROPCOUNT: dropped 17 CAN frames on 'can0' socket (total drops 17)"]
wild += [line.replace("can0", "can1") for line in lines[9:12]]
wild += lines[12:15] + ["(1795020002.600000) can0 1A1#00000F070810DD5E", "(1795020002.600000) can0 1A0#FFFE"]
wild += lines[15:18] + ["(17950200", "torn by a crash \x01\x02", "(1795020003.600000) can0 1A0#FFFE00010005000G"]
wild += ["(1795020003.600000)  can0  18FEF100#1122334455667788", "// another comment"]
wild += [line.replace("(1795020003", "(1795020001") for line in lines[18:21]] + lines[21:24] + lines[24:36]
wild += ["(1795020006.600000) can0 124#11", "(1795020006.700000) can0 12"]
open("wild.log", "w", newline="").write("\n".join(wild))
