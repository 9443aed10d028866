"""The formats of python-can: the same traffic in each is decoded to the same rows, or refused with a conversion that works."""
import logging
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

#: Resolution of the times, s. TRC 1.0 has whole milliseconds, TRC and the mantissa of a float microseconds.
RESOLUTION_S = {".log": 1e-6, ".asc": 1e-6, ".trc": 2e-6, ".csv": 1e-6, ".blf": 2e-6, ".1.0.trc": 1e-3}
START_S = 1_795_020_000
COUNTED = ("remote", "fd", "error")
#: Kinds of frames that the writer leaves out, or that its format does not mark.
LEFT_OUT = {".trc": COUNTED, ".1.0.trc": COUNTED}


def traffic(can, log):
    """The messages of a log, with a frame of each other kind."""
    messages = list(can.LogReader(log))
    at_s = messages[4].timestamp
    others = [can.Message(timestamp=at_s, arbitration_id=0x18FEF100, is_extended_id=True, data=b"\1\2\3"),
              can.Message(timestamp=at_s, arbitration_id=0x123, is_extended_id=False, is_remote_frame=True, dlc=8),
              can.Message(timestamp=at_s, arbitration_id=0x124, is_extended_id=False, is_fd=True, data=bytes(12)),
              can.Message(timestamp=at_s, arbitration_id=4, is_error_frame=True, data=bytes(8))]
    for message in others:
        message.channel = messages[0].channel
    return messages[:5] + others + messages[5:]


def write(can, file, messages):
    """Writes messages in the format of the file's suffix."""
    with can.Logger(file) as logger:
        if file.name.endswith(".1.0.trc"):
            logger.file_version = can.io.trc.TRCFileVersion.V1_0
        for message in messages:
            logger(message)
        # Of the messages that wait when it stops, the writer of SQLite writes 500.
        while file.suffix == ".db" and not logger.buffer.empty():
            time.sleep(0.05)


def decode(geu, directory, file):
    """Exit code, rows as (t_s, the other cells), the summary by its names, and standard error."""
    out = directory / "rows.csv"
    out.unlink(missing_ok=True)
    done = subprocess.run([geu, "decode", str(file), "--out", str(out)], text=True, capture_output=True, check=False)
    lines = out.read_text().splitlines()[1:] if out.exists() else []
    rows = [(float(t_s), cells) for t_s, _, cells in (line.partition(",") for line in lines)]
    return done.returncode, rows, dict(line.split(maxsplit=1) for line in done.stderr.splitlines() if " " in line), done.stderr


def same_rows(checks, geu, can, directory, messages, suffix, expected, kinds):
    """Checks that a format gives these rows, within the resolution of its times, and counts the other frames."""
    file = directory / f"trace{suffix}"
    write(can, file, messages)
    status, rows, summary, errors = decode(geu, directory, file)
    checks.equal(f"python-can's {suffix}: exit 0, accounts for all, no defects",
                 (status, summary.get("account"), summary.get("defects")), (0, "accounts for all", "0"))
    checks.equal(f"python-can's {suffix}: {len(rows)} rows, the values of candump", [r for _, r in rows], [r for _, r in expected])
    counts = {kind: summary.get(f"records-{kind}") for kind in COUNTED}
    left_out = LEFT_OUT.get(suffix, ())
    checks.equal(f"python-can's {suffix}: frames of other kinds are counted", counts,
                 {kind: "0" if kind in left_out else kinds[kind] for kind in COUNTED})
    # ASC and TRC 1.0 hold no absolute times that are read.
    shift_s = rows[0][0] - expected[0][0] if suffix in (".asc", ".1.0.trc") and rows else 0
    difference_s = max((abs(a - b - shift_s) for (a, _), (b, _) in zip(rows, expected)), default=1)
    checks.check(f"python-can's {suffix}: times within {difference_s * 1e6:.2f} us of candump's",
                 difference_s <= RESOLUTION_S[suffix], errors)


def refused(checks, geu, can, directory, messages, suffix, expected):
    """Checks that a format is refused, and that the conversion of its message gives these rows."""
    name = f"python-can's {suffix}"
    file, converted = directory / f"trace{suffix}", directory / f"converted{suffix}.log"
    try:
        write(can, file, messages)
    except NotImplementedError as error:
        return checks.skip(name, str(error).splitlines()[0])
    before = sorted(path.name for path in directory.iterdir() if path.name != "rows.csv")
    status, _, _, errors = decode(geu, directory, file)
    message = f"geu: {file}: is an "
    checks.check(f"{name}: refused in one line that names the conversion",
                 status == 2 and errors.startswith(message) and errors.count("\n") == 1 and "can_logconvert" in errors, errors)
    checks.equal(f"{name}: leaves no file", sorted(path.name for path in directory.iterdir()), before)
    convert = shutil.which("can_logconvert", path=Path(sys.executable).parent) or shutil.which("can_logconvert")
    done = subprocess.run([convert or "can_logconvert", file, converted], text=True, capture_output=True, check=False)
    checks.check(f"{name}: can_logconvert converts it", done.returncode == 0, done.stderr[-300:])
    status, rows, _, errors = decode(geu, directory, converted)
    checks.equal(f"{name}: {len(rows)} rows of the converted file, the values of candump", [r for _, r in rows],
                 [r for _, r in expected])
    checks.equal(f"{name}: exit 0 for the converted file", status, 0)
    return None


def recorded_formats(geu, checks):
    try:
        import can.io.trc
    except ImportError:
        checks.skip("the formats of python-can", "python-can is absent: pip install -r tests/requirements.txt")
        return
    # TRCWriter warns of each frame that it leaves out.
    logging.getLogger("can").setLevel(logging.ERROR)
    with tempfile.TemporaryDirectory() as directory:
        directory = Path(directory)
        subprocess.run([geu, "simulate", "--duration", "5m", "--start", str(START_S), "--out", directory / "run"], check=True,
                       capture_output=True)
        status, expected, _, errors = decode(geu, directory, directory / "run/link.log")
        checks.check(f"geu decode of the simulated link.log: {len(expected)} rows", status == 0 and len(expected) == 600, errors)
        messages = traffic(can, directory / "run/link.log")
        kinds = dict.fromkeys(COUNTED, "1")
        for suffix in RESOLUTION_S:
            same_rows(checks, geu, can, directory, messages, suffix, expected, kinds)
        for suffix in (".db", ".mf4"):
            refused(checks, geu, can, directory, messages, suffix, expected)
