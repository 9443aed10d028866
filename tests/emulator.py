"""Starts `geu` for a test and ends it."""
import argparse
import os
import queue
import shutil
import signal
import subprocess
import threading
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def arguments(description):
    """The command line that every script here takes."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--geu", help="the program [default: the newest that cargo built]")
    return parser


def find_geu(named):
    """The path of `geu`; ends the program where there is none."""
    if named:
        return str(Path(named).resolve())
    target = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    built = [path for kind in ("release", "debug") if (path := target / kind / "geu").exists()]
    if not built:
        raise SystemExit(f"no geu in {target}: build it with cargo build --release --locked, or name it with --geu")
    return str(max(built, key=lambda path: path.stat().st_mtime))


def have(*programs):
    """The programs of these that are absent, as words; empty when all are there."""
    return ", ".join(name for name in programs if not shutil.which(name))


class Process:
    """A program whose output is kept line by line, and that is ended with the block."""

    def __init__(self, *command, **options):
        self.command = [str(word) for word in command]
        self.process = subprocess.Popen(self.command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                                        stderr=subprocess.PIPE, text=True, errors="replace", **options)
        self.lines, self.errors, self.waiting = [], [], queue.Queue()
        self.readers = [threading.Thread(target=self._read, args=pair, daemon=True)
                        for pair in ((self.process.stdout, self.lines), (self.process.stderr, self.errors))]
        for reader in self.readers:
            reader.start()

    def _read(self, stream, lines):
        for line in stream:
            lines.append(line.rstrip("\n"))
            self.waiting.put(None)

    def wait_for(self, start, seconds=10):
        """The first line of standard output that begins with `start`."""
        end = time.monotonic() + seconds
        while True:
            found = next((line for line in self.lines if line.startswith(start)), None)
            if found is not None:
                return found
            if time.monotonic() > end or (self.process.poll() is not None and self.waiting.empty()):
                raise RuntimeError(f"{' '.join(self.command)}: no line {start!r} within {seconds} s; "
                                   f"exit {self.process.poll()}, standard error: {self.errors[-5:]}")
            try:
                self.waiting.get(timeout=0.1)
            except queue.Empty:
                pass

    def wait(self, seconds):
        """Waits for the end; returns the exit status."""
        try:
            status = self.process.wait(seconds)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
            status = None
        for reader in self.readers:
            reader.join(2)
        return status

    def end(self, signal_number=signal.SIGTERM, seconds=5):
        """Asks it to end; returns exit status (nothing when it had to be killed) and how long it took."""
        start = time.monotonic()
        if self.process.poll() is None:
            self.process.send_signal(signal_number)
        return self.wait(seconds), time.monotonic() - start

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.end()


class HostDelay:
    """How late the host wakes a program that asked for a millisecond, at worst within the block.

    It distinguishes a slow unit from a host, or an emulated machine, that had no processor to spare: what the host adds by
    itself is granted to the slowest reply, never to the middle one.
    """

    def __enter__(self):
        self.worst_s, self.ended = 0.0, threading.Event()
        self.sleeper = threading.Thread(target=self._sleep, daemon=True)
        self.sleeper.start()
        return self

    def _sleep(self):
        while not self.ended.is_set():
            start = time.monotonic()
            time.sleep(0.001)
            self.worst_s = max(self.worst_s, time.monotonic() - start - 0.001)

    def __exit__(self, *_):
        self.ended.set()
        self.sleeper.join()

    def allows(self, times, limit_s):
        """Whether the middle time is within the limit, and the slowest within it and the host's own delay."""
        return sorted(times)[len(times) // 2] < limit_s and max(times) < limit_s + self.worst_s

    def __str__(self):
        return f"the host itself was {self.worst_s * 1e3:.1f} ms late at worst"
