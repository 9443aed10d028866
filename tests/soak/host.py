"""The host: its clock, and its CAN interface."""
import os
import re
import struct
import subprocess
import time
from pathlib import Path

from beside import beside_calm, ends, reads_all
from emulator import ROOT, have
from recordings import differing
from unit import PING, Reader
from wire import continuous

HOUR_S = 3600
STEPS_S = [3 * HOUR_S, -5 * HOUR_S, 26 * HOUR_S, -720 * HOUR_S, 1, -1, 9600 * HOUR_S, 0]
FLAPS = 100


def clock(figures, options, scratch):
    """The clock of the host stepped back and forth for the unit alone, by a library that stands before it."""
    if lacking := have("cc"):
        return figures.absent(f"{lacking} is absent: a C compiler makes the library that steps the clock")
    library, offset, record = scratch / "stepped_clock.so", scratch / "offset", scratch / "record"
    subprocess.run(["cc", "-shared", "-fPIC", "-O1", "-o", library, Path(__file__).with_name("stepped_clock.c"), "-ldl"], check=True)
    offset.write_bytes(bytes(8))
    stepped = {**os.environ, "LD_PRELOAD": str(library), "STEPPED_BY": str(offset)}

    def step(to_s):
        """Steps the clock, and returns by how much another program sees it stepped."""
        with open(offset, "r+b", buffering=0) as file:
            file.write(struct.pack("l", to_s))
        seen = subprocess.run(["date", "+%s"], env=stepped, capture_output=True, text=True, check=True).stdout
        return int(seen) - time.time()

    with beside_calm(options.geu, "--control", "127.0.0.1:0", "--tcp", "127.0.0.1:0", "--record", record, env=stepped) as unit:
        reader, begin, shifts = Reader(unit.tcp, PING), time.monotonic(), []
        for _ in range(max(1, round(2 * options.scale))):
            for to_s in STEPS_S:
                shifts.append(step(to_s))
                time.sleep(2)
        reads_all(figures, reader, time.monotonic() - begin)
        gaps = [b - a for a, b in zip(reader.times, reader.times[1:])]
        drift = reader.times[-1] - reader.times[0] - 0.5 * len(gaps)
        maps = Path(f"/proc/{unit.process.pid}/maps").read_text()
        figures.check("clock: the unit runs with the library", str(library) in maps and str(offset) in maps)
        figures.row("steps of the clock", f"{len(shifts)}, {min(shifts) / 3600:+.0f} h … {max(shifts) / 3600:+.0f} h")
        figures.check("clock: a program sees them", min(shifts) < -86400 and max(shifts) > 86400, shifts)
        figures.row("between samples: shortest, longest", f"{min(gaps):.3f} s, {max(gaps):.3f} s")
        figures.at_most("time of all samples beside that of their number", abs(drift) * 1e3, 100, "ms",
                        "twice 50 ms by which a shared host may be late")
        figures.exactly("samples or clock counts that do not follow each other", len(continuous(reader.rows)), 0, "protocol/ICD.md")
        ends(figures, unit)
        figures.exactly("files that `geu simulate run.toml` does not repeat", differing(options.geu, record, scratch / "again"), "none",
                        "times are scheduled ends of samples")


def vcan(figures, options, _scratch):
    """The interface down and up, where SocketCAN is or in the guest that has it."""
    count = max(5, round(FLAPS * options.scale))
    done = subprocess.run([ROOT / "tests/vcan/run", "--geu", options.geu, "--flaps", str(count)], capture_output=True, text=True, check=False,
                          env={**os.environ, "VCAN_SUITE_LIMIT_S": str(300 + 5 * count)})
    if done.returncode == 70:
        return figures.absent(done.stderr.strip().splitlines()[-1])
    for line in done.stdout.splitlines():
        if passed := re.match(r"ok: vcan0 (?:flaps|clock): (.*?): (.*?)(?:, limit (.*))?$", line):
            figures.row(passed[1], passed[2], f"≤ {passed[3]}" if passed[3] else "")
        print(f"    {line}")
    figures.check("vcan: the interface down and up", done.returncode == 0, done.stderr[-500:])
