"""Recordings of units that are killed, or have a full disk."""
import json
import os
import random
import resource
import subprocess
import time

import wire
from beside import beside_calm, ends, reads_all
from unit import PING, Reader, Unit

KILLS = 20
#: An answer waits for the disk up to this time; docs/recordings.md.
WAITS_S = 0.010
#: Limit of a file, bytes: some ten samples of truth.csv.
FILE_LIMIT = 8192


def complete_records(record):
    """Whole DATA frames in link.bin, found without the project's code."""
    return sum(kind == wire.DATA for kind, _ in wire.Deframer().feed((record / "link.bin").read_bytes()))


def decoded(geu, record):
    """Exit code of `geu decode`, and number of its rows."""
    done = subprocess.run([geu, "decode", "--quiet", record / "link.bin"], capture_output=True, check=False)
    return done.returncode, max(done.stdout.count(b"\n") - 1, 0)


def differing(geu, record, again):
    """Files of the recording with which the output of `geu simulate run.toml` does not begin; `none` without such."""
    done = subprocess.run([geu, "simulate", record / "run.toml", "--out", again], capture_output=True, text=True, check=False)
    if done.returncode:
        return done.stderr.strip()[-300:]
    names = sorted(path.name for path in record.iterdir() if path.name != "run.toml" and not path.name.startswith("."))
    unlike = [name for name in names if not (again / name).exists()
              or not (again / name).read_bytes().startswith((record / name).read_bytes())]
    return ", ".join(unlike) or "none"


def killed(figures, options, scratch):
    """SIGKILL at random moments: of a unit in real time that answers commands, and of one at 2000 times its speed."""
    count, chosen = max(4, round(KILLS * options.scale)), random.Random(options.seed)
    unreadable, unlike, asked, unrecorded, excused, rows_in_all, behind = 0, [], 0, 0, 0, 0, []
    for number in range(count):
        record = scratch / f"record{number}"
        speed = "1" if number % 2 == 0 else "2000"
        words = ["--tcp", "127.0.0.1:0", "--control", "off", "--speed", speed, "--seed", str(number), "--record", record]
        with Unit(options.geu, "run", *words) as unit:
            reader = Reader(unit.tcp, PING, pause_s=0.0) if speed == "1" else None
            time.sleep(chosen.uniform(0.3, 6.0 if speed == "1" else 2.0))
            unit.process.kill()
            unit.process.wait()
        complete = complete_records(record)
        status, rows = decoded(options.geu, record)
        rows_in_all += rows
        unreadable += abs(rows - complete) + bool(status)
        unlike.append(differing(options.geu, record, scratch / f"again{number}"))
        if reader:
            reader.end()
            asked += len(reader.replies_s)
            behind.append(len(reader.rows) - complete)
            recorded = commands(record)
            lost = max(len(reader.replies_s) - recorded, 0)
            # Once an answer has waited 10 ms for the disk, the next ones do not wait until it has written again.
            if lost and max(reader.replies_s[max(recorded - 3, 0):]) >= WAITS_S:
                excused, lost = excused + lost, 0
            unrecorded += lost
    figures.row("kills with SIGKILL", f"{count}, every second one at 2000 times real time")
    figures.exactly("complete samples in link.bin that `geu decode` does not give", unreadable, 0, f"of {rows_in_all}; docs/recordings.md")
    figures.exactly("files that `geu simulate run.toml` does not repeat byte for byte", "; ".join(sorted(set(unlike))), "none", "docs/recordings.md")
    figures.exactly("commands answered within 10 ms of disk time and not recorded", unrecorded, 0, f"of {asked} answered; docs/recordings.md")
    figures.row("commands answered and not recorded, after an answer that had waited 10 ms for the disk", excused)
    figures.at_most("samples received and not recorded, at most", max(behind), 1, "", "a sample is written when it ends, while it is sent", 0)


def commands(record):
    return sum(line.endswith(b"\n") and bool(json.loads(line)) for line in (record / "commands.jsonl").read_bytes().splitlines(keepends=True))


def disk(figures, options, scratch):
    """A file system that is full, and a limit of the length of files."""
    mounted = scratch / "small"
    mounted.mkdir()
    done = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=512k", "tmpfs", mounted], capture_output=True, text=True, check=False)
    if done.returncode:
        figures.absent(f"a full file system: {done.stderr.strip()}")
    else:
        try:
            full(figures, options, mounted, scratch / "again-full", "full file system", fill=mounted / "ballast")
        finally:
            subprocess.run(["umount", mounted], check=True)

    def limit():
        resource.setrlimit(resource.RLIMIT_FSIZE, (FILE_LIMIT, FILE_LIMIT))
    # Python ignores SIGXFSZ, and so does the unit with the signals of its parent.
    full(figures, options, scratch, scratch / "again-limit", "limit of a file", preexec_fn=limit, restore_signals=False)


def full(figures, options, directory, again, name, fill=None, **started):
    words, record, seconds = f", {name}", directory / "record", max(10, 30 * options.scale)
    with beside_calm(options.geu, "--control", "127.0.0.1:0", "--tcp", "127.0.0.1:0", "--record", record, **started) as unit:
        reader, begin = Reader(unit.tcp, PING), time.monotonic()
        time.sleep(3)
        if fill:
            fill_up(fill)
        time.sleep(seconds)
        reads_all(figures, reader, time.monotonic() - begin, words)
        ends(figures, unit, status=1, words=words)
        said = "\n".join(unit.errors)
        figures.exactly(f"messages while it runs, at its end{words}",
                        f"{said.count('emulation continues without it')}, {said.count('ended at sample')}", "1, 1", "each once")
        complete, (status, rows) = complete_records(record), decoded(options.geu, record)
        figures.exactly(f"complete samples in link.bin that `geu decode` does not give{words}", abs(rows - complete) + status, 0, f"of {complete}")
        figures.exactly(f"files that `geu simulate run.toml` does not repeat{words}", differing(options.geu, record, again), "none",
                        "docs/recordings.md")


def fill_up(path):
    """Writes until the file system is full."""
    with open(path, "wb", buffering=0) as ballast:
        for size in (65536, 4096, 1):
            try:
                while True:
                    ballast.write(bytes(size))
            except OSError:
                pass
