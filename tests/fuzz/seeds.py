"""Seeds of the targets: parts of captures, configurations and recordings of this project, and short texts of what it has no file of."""
import binascii
import re
import struct
import subprocess
import tempfile
import zlib
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
CAPTURES = ROOT / "tests" / "captures"
#: Longest input of each target: long enough for several records, short for speed.
MAX_BYTES = dict.fromkeys(("asc", "candump", "console", "console_delta", "csv", "device_can", "device_table", "python_csv", "trc"), 256)
MAX_BYTES |= dict.fromkeys(("serial", "device_serial", "traffic_can", "traffic_device", "traffic_serial", "command", "commands", "expression", "formula"), 128)
MAX_BYTES |= dict.fromkeys(("blf", "pcap", "pcapng", "detect", "received", "truth", "forty_two"), 512)
MAX_BYTES |= dict.fromkeys(("aem", "dbc", "faults", "reference", "reference_file", "request"), 1024)
MAX_BYTES |= dict.fromkeys(("configuration", "device"), 3072) | {"input": 8192}

EXPRESSIONS = """abs(rate_y) > 700 and not valid(GYRX)
t_s >= 12.5 and frame == 25 or frame % 10 == 5
not (psi_deg > 5 and electronics_c < -1.5e1)
saturated(GYRX) and count(GYRZB) == 7 - -3
command(SET_MODE) and not active("a b") or polled != 0
(1 + 2) * 3 == 9 and theta_deg / 2 <= sequence""".splitlines()
FORMULAS = ["rate_x", "rate_y^2*abs(rate_z)", "acceleration_x*temperature^3*time", "sensor_temperature * theta^2"]
TRUTH = """{"t_s": 0.0, "q": [1, 0, 0, 0], "sun": [0, 0.6, 0.8]}
{"t_s": 0.1, "q": [0.6, 0, 0.8, 0]}
{"t_s": 0.2, "rate_arcsec_s": [1, -2.5, 3e1], "subscribe": "samples"}
{"subscribe": "samples"}
{"t_s": 1000.0, "rate_arcsec_s": [0, 0, 0]}
"""
FORTY_TWO = """TIME 2026-130-12:00:00.000000000
SC[0].B[0].qn = [ 0.0 0.0 0.0 1.0 ]
SC[0].AC.qbn = 0.6 0.0 0.0 0.8
[ENDMSG]
TIME 2026-130-12:00:00.500000000
SC[0].qn = 0.0, 0.0, 0.6, 0.8
[EOF]
"""
AEM = """CCSDS_AEM_VERS = {}
CREATION_DATE = 2026-03-31T05:00:00
META_START
OBJECT_NAME = GEU
REF_FRAME_A = {}
REF_FRAME_B = {}
{}TIME_SYSTEM = TAI
START_TIME = 2026-03-31T00:00:00
USEABLE_STOP_TIME = 2026-04-01T00:00:00
ATTITUDE_TYPE = QUATERNION
META_STOP
DATA_START
2026-090T05:00:00.5 0 0 0 1
2026-03-31T05:00:01 0 0 0.0006 0.9999998
2026-090T05:00:02 0 0 0.6 0.8
DATA_STOP
"""
REFERENCES = """t_s,rate_x_deg_s,rate_y_deg_s,rate_z_deg_s
0.5,0.1,0.2,-0.3
1.0,0.1,0.2,-0.3
1.5,0.1,0.2,0.3

time_ms;q_w;q_x;q_y;q_z;sigma_arcsec
0;1;0;0;0;5
500;0.6;0.8;0;0;5
1000;0.6;0.8;0;0;5

start_s,end_s,turn_x_arcsec,turn_y_arcsec,turn_z_arcsec,theta_deg,psi_deg
0.0,0.5,1,2,3,90,0
0.5,1.0,1,2,3,90,1

trial,t_s,rate_x_rad_s,rate_y_rad_s,rate_z_rad_s,sensor_c
a,0.5,0.1,0.2,0.3,20
a,1.0,0.1,0.2,0.3,21
b,0.5,0.1,0.2,0.3,20
b,1.0,0.1,0.2,0.3,20

day,wx,wy,wz,magrate
1,0.1,0.2,0.3,0.4
2,0.1,-0.2,0.3,0.4

t_s,rate_deg_s
0.5,1.5
1.0,1.6
1.5,1.5
""".split("\n\n")
RECEIVED = "t_s,angle_x_arcsec,angle_y_arcsec,angle_z_arcsec,basis{}\n0.1,1.5,-2.0,1e-5,held{}\n0.2,0.0,0.0,0.0,missing{}\n"
REQUESTS = ["GET /api/status\n\n", "GET /api/catalogue\nhost: localhost:8470\norigin: http://localhost:8470\n\n", "DELETE /api/faults/a%20b\n\n",
            "GET /index.html?token=x\nhost: 127.0.0.1:8470\nauthorization: Bearer x\n\n"]
BODIES = {
    "/api/faults": ['{"fault": "stuck-count", "gyro": "GYRX", "counts": 120, "for_s": 3, "when": "t_s > 1"}',
                    '{"parameter": "drift.arcsec_per_h", "gyro": "GYRY", "course": {"ramp": 1.5, "over_s": 60}, "seed": 7}',
                    '{"plan": "[[fault]]\\nfault = \\"drop\\"\\nprobability = 0.5", "name": "p"}', '{"start": "a"}'],
    "/api/commands": ['{"name": "SELF_TEST", "arguments": [1, -100, 4]}', '{"bytes": "02 01"}'],
    "/api/watch": ['{"t_s": 1.5, "event": "alarm", "code": "drift", "gyros": ["GYRX"], "statistic": 9.5, "threshold": 3}'],
}


def lines(name, count=3):
    """The head of a text capture with its first lines of frames, and some lines from its middle."""
    text = (CAPTURES / name).read_bytes().splitlines(keepends=True)
    return [b"".join(text[at:at + count]) + b"\xff\x80" for at in (0, 4, 8, 12, 16, len(text) // 2)]


def serial(kind, payload):
    covered = bytes([kind, len(payload)]) + payload
    return b"\xEB\x90" + covered + struct.pack(">H", binascii.crc_hqx(covered, 0xFFFF))


def blf():
    """Files of one container with a frame, a remote frame and an error: stored, compressed, and cut."""
    def item(kind, body, version=1):
        header = struct.pack("<4sHHII", b"LOBJ", 32, version, 32 + len(body), kind)
        return header + struct.pack("<IHHQ", 2, 0, 0, 500_932_000) + body

    frame = struct.pack("<HBBI8s", 1, 0, 8, 0x1A0, bytes(8))
    content = item(1, frame) + item(86, frame + bytes(8)) + item(1, struct.pack("<HBBI8s", 2, 0x80, 0, 0x800001A0, bytes(8))) + item(73, bytes(24))
    head = struct.pack("<4sI32s8H", b"LOGG", 144, bytes(32), 2026, 11, 3, 18, 16, 40, 0, 500).ljust(144, b"\0")
    for method, packed in ((0, content), (2, zlib.compress(content))):
        container = struct.pack("<4sHHIIHHIII", b"LOBJ", 16, 1, 32 + len(packed), 10, method, 0, 0, len(content), 0)
        yield head + container + packed + bytes(len(packed) % 4) + b"\x80\xff"
    yield head + content + b"\x40\xc0"


def simulated(geu, device, out):
    """Bytes of the serial line of a unit, or lines of its CAN or table."""
    of_device = ["--device", device] if device else []
    subprocess.run([geu, "simulate", *of_device, "--duration", "2", "--out", out], check=True, capture_output=True)
    return {path.name: path.read_bytes()[:4000] for path in Path(out).iterdir()}


def tables(text):
    """Every table of a TOML text by itself."""
    return [part.encode() for part in re.split(r"(?m)^(?=\[)", text) if part.strip()]


def seeds(geu, names):
    """Inputs of these targets."""
    with tempfile.TemporaryDirectory() as directory:
        runs = {device: simulated(geu, device, f"{directory}/{device}")
                for device in ("", "hg4930", "kvh-1750", "mti-100", "stim300", "stim300-increment", "tetrad", "mm5.10", "openimu300ri")}
    default = runs[""]
    unit_serial = [serial(1, bytes(22)), serial(0x10, b"\x01"), b"\xEB\x90\x01\x16" + serial(0x11, b"\x01\x00\x01\x00"),
                   serial(1, bytes.fromhex("0000FFFEFFFE000500050F0708100000000 7A1201B58".replace(" ", ""))) * 2]
    devices = {path.stem: path.read_bytes() for path in (ROOT / "configs" / "devices").glob("*.toml")}
    databases = {path.stem: path.read_bytes() for path in (ROOT / "configs" / "devices").glob("*.dbc")}
    configurations = [path.read_text() for path in (ROOT / "configs").glob("*.toml")]
    plans = [(ROOT / name / "faults.toml").read_text() for name in ("configs", "examples")]
    described = ("hg4930", "kvh-1750", "mti-100", "stim300", "stim300-increment", "tetrad")
    first = {device: bytes([number]) for number, device in enumerate(described)}
    link = {device: next((content for name, content in files.items() if name.startswith("link.")), b"") for device, files in runs.items()}
    references = [text.encode() for text in REFERENCES] + [default["reference.csv"][:900]]
    ephemerides = [AEM.format(*parts).encode() for parts in (
        ("2.0", "EME2000", "SC_BODY_1", ""), ("1.0", "SC_BODY_1", "ICRF", "ATTITUDE_DIR = B2A\nQUATERNION_TYPE = FIRST\n"))]
    requests = [text.encode() for text in REQUESTS] + [
        f"POST {path}\n\n{body}".encode() for path, bodies in BODIES.items() for body in bodies]
    found = {
        "aem": ephemerides,
        "asc": lines("encoded-log2asc.asc", 6) + lines("encoded-python-can.asc", 6),
        "blf": list(blf()),
        "candump": lines("encoded.log") + lines("wild.log"),
        "command": [b"\1", b"\2\1", b"\4\3\xff\x9c\x09", b"\6\x0f", b"09 0aFF", b"SET_MODE", b"self-test"],
        "commands": [b"\2\2\1\0\0\1\3\0\5\4\1\0\x10\2\0\0\0\2\6\1\0\2\7\0\0\1\5\0\0"],
        "configuration": [text.encode() for text in configurations] + [part for text in configurations for part in tables(text)]
                         + [default["run.toml"][:3000], b"seed = 1\0gyro.GYRX.drift.arcsec_per_h=10\0manoeuvre.0.duration_s=42"],
        "console": lines("encoded-console.txt") + lines("encoded-console-a.txt") + lines("encoded-console-z.txt"),
        "console_delta": lines("encoded-console-d.txt") + lines("encoded-console-z.txt"),
        "csv": references,
        "dbc": list(databases.values()) + [(ROOT / "protocol" / "geu.dbc").read_bytes()[at:at + 1000] for at in (0, 1000, 2000)],
        "detect": lines("encoded.log", 1) + lines("encoded-console.txt", 1) + unit_serial + [b"PAR1", b"\x1f\x8b\x08", b"LOGG"],
        "device": [text + b"\0" + databases.get(name, b"") for name, text in devices.items()] + [(ROOT / "examples" / "device.toml").read_bytes()],
        "device_can": [bytes([number]) + link[device][at:at + 200] for number, device in enumerate(("mm5.10", "openimu300ri")) for at in (0, 100, 200)],
        "device_serial": [first[device] + link[device][at:at + 120] for device in described for at in (0, 60)],
        "device_table": [b"\0timestamp_s,gyro_x_lsb,gyro_y_lsb,gyro_z_lsb\n1,2,-3,4\n2,5,6,7\n4,x,1,2\n\x80\xff"],
        "expression": [text.encode() for text in EXPRESSIONS],
        "faults": [b"\2" + part for plan in plans for part in tables(plan)],
        "formula": [text.encode() for text in FORMULAS],
        "forty_two": [FORTY_TWO.encode() + b"\x80\xff"],
        "input": [(CAPTURES / name).read_bytes()[:600] for name in ("encoded.log", "encoded.pcap", "encoded-console.txt")]
                 + unit_serial + list(blf()) + [zlib.compress(unit_serial[0], wbits=31)],
        "pcap": [(CAPTURES / name).read_bytes()[:300] + b"\x80\xff" for name in ("encoded.pcap", "encoded-sll.pcap", "encoded-socketcan.pcap")],
        "pcapng": [(CAPTURES / name).read_bytes()[:500] + b"\x80\xff" for name in ("encoded.pcapng", "encoded-sll.pcapng")],
        "python_csv": lines("encoded-python-can.csv"),
        "received": [RECEIVED.format("", "", "").encode(),
                     RECEIVED.format(",theta_rad,psi_rad,turn_x_arcsec,turn_y_arcsec", ",1,2,3,4", ",1,2,3,4").encode()],
        "reference": references,
        "reference_file": [bytes([number]) + text for number in range(3) for text in references + ephemerides],
        "request": requests,
        "serial": [content + b"\x80\xff" for content in unit_serial],
        "traffic_can": [bytes(range(60)), b"\0\1\0\0\0\1\2\3\4" * 5 + b"\x80\xff"],
        "traffic_device": [bytes([number]) + bytes(range(40)) for number in range(6)],
        "traffic_serial": [bytes(range(60)), b"\0\1\0\0\0\1\2\3\4" * 5 + b"\x80\xff"],
        "trc": lines("encoded-python-can.trc", 5),
        "truth": [TRUTH.encode() + b"\x80\xff"],
    }
    return {name: found[name] for name in names}
