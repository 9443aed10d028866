"""A running `geu` with measures of its process, and a client that reads its samples."""
import json
import os
import re
import socket
import threading
import time
import urllib.request
from pathlib import Path

import wire
from emulator import Process

LATENESS = r"^lateness +p50 ([0-9.]+) (.s) .* p99 ([0-9.]+) (.?s) "
MICROSECONDS = {"ns": 1e-3, "µs": 1.0, "ms": 1e3, "s": 1e6}
PING = wire.frame(wire.COMMAND, b"\x01")


class Unit(Process):
    """`geu run` or `geu replay` with its links open: the address of `--tcp` and that of the control interface."""

    def __init__(self, geu, *words, **options):
        super().__init__(geu, *words, **options)
        self.tcp = self.control = None
        if "--tcp" in words:
            host, port = self.wait_for("ready tcp").split()[2].rsplit(":", 1)
            self.tcp = host, int(port)
        if "--control" in words and words[words.index("--control") + 1] != "off":
            self.control = self.wait_for("ready control").split("http://", 1)[1].rstrip("/")

    def missed(self):
        with urllib.request.urlopen(f"http://{self.control}/api/status", timeout=5) as answer:
            return json.load(answer)["missed"]

    def summary(self, pattern):
        """What a pattern finds in the summary at its end."""
        found = re.search(pattern, "\n".join(self.errors), re.M)
        if not found:
            raise RuntimeError(f"expected {pattern!r} in the summary, got {self.errors[-5:]}")
        return found

    def lateness_us(self):
        """50th and 99th percentile, from the summary at its end."""
        found = self.summary(LATENESS)
        return [float(found[at]) * MICROSECONDS[found[at + 1]] for at in (1, 3)]

    def memory_kb(self, name="VmRSS"):
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        return int(next(line for line in status.splitlines() if line.startswith(name)).split()[1])

    def descriptors(self):
        return len(os.listdir(f"/proc/{self.process.pid}/fd"))

    def processor_s(self):
        """Processor time since its start, of user and system."""
        fields = Path(f"/proc/{self.process.pid}/stat").read_text().rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


class Reader(threading.Thread):
    """A TCP client that reads every sample, and sends a command now and then if it has one to send."""

    def __init__(self, address, command=None, pause_s=0.2):
        super().__init__(daemon=True)
        self.stream, self.command, self.pause_s = socket.create_connection(address), command, pause_s
        self.stream.settimeout(0.05)
        self.deframer, self.rows, self.times, self.asked, self.replies_s = wire.Deframer(), [], [], 0, []
        self.is_over, self.lost = threading.Event(), ""
        self.start()

    def run(self):
        since, next_ask = None, time.monotonic()
        while not self.is_over.is_set():
            try:
                if self.command and since is None and time.monotonic() >= next_ask:
                    since, next_ask = time.monotonic(), time.monotonic() + self.pause_s
                    self.asked += 1
                    self.stream.sendall(self.command)
                received = self.stream.recv(4096)
            except TimeoutError:
                continue
            except OSError as error:
                self.lost = str(error)
                return
            if not received:
                self.lost = "the link was closed"
                return
            for kind, payload in self.deframer.feed(received):
                if kind == wire.DATA:
                    self.times.append(time.monotonic())
                    self.rows.append(wire.read_data(payload))
                elif since is not None:
                    self.replies_s.append(time.monotonic() - since)
                    since = None

    def steps(self):
        """Differences of successive sequence numbers; 1 where no sample is missing."""
        numbers = [int(row["sequence"]) for row in self.rows]
        return [(b - a) % 65536 for a, b in zip(numbers, numbers[1:])]

    def end(self):
        self.is_over.set()
        self.join(2)
