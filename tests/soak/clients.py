"""Clients: many, gone, silent, and of the control interface."""
import contextlib
import os
import random
import resource
import select
import signal
import socket
import threading
import time
import tty

import wire
from beside import END_S, GROWTH_KB, GROWTH_REASON, beside_calm, ends, keeps_time, reads_all
from unit import PING, Reader, Unit

LINKS = 64
SILENT = 1000
#: Clients that a TCP link serves, docs/links.md.
SERVED = 64
VANISHED = 1000
SERVED_WITHIN_S = 0.1
#: A pty has the rate of a serial line of 115200 baud; protocol/ICD.md.
BYTES_PER_S = 11_520
#: Connections of the control interface: served, and with an error response.
CONTROL_SERVED, CONTROL_REJECTED = 32, 16
#: Its reply differs from that of a PING.
SET_MODE_CYCLIC = wire.frame(wire.COMMAND, b"\x02\x00")


class PtyDelay(threading.Thread):
    """How long the host takes for a byte there and back over a pty of its own, at worst within the block. Workers of the kernel
    carry the bytes of every pty; on a busy host they wait for a processor."""

    def __init__(self):
        super().__init__(daemon=True)
        self.worst_s, self.is_over = 0.0, threading.Event()
        self.master, self.slave = os.openpty()
        tty.setraw(self.slave)

    def run(self):
        while not self.is_over.wait(0.002):
            start = time.monotonic()
            os.write(self.slave, b".")
            os.write(self.master, os.read(self.master, 1))
            os.read(self.slave, 1)
            self.worst_s = max(self.worst_s, time.monotonic() - start)

    def __enter__(self):
        self.start()
        return self

    def __exit__(self, *_):
        self.is_over.set()
        self.join()
        os.close(self.master)
        os.close(self.slave)


def opened(path):
    return os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)


def links(figures, options, scratch):
    """All links of one process, each with a client that reads."""
    seconds = max(10, round(60 * options.scale))
    paths = [scratch / f"geu{number}" for number in range(LINKS)]
    words = [word for path in paths for word in ("--pty", path)]
    with beside_calm(options.geu, "--control", "off", "--duration", str(seconds), *words) as unit:
        unit.wait_for(f"ready pty {paths[-1]}")
        received = {opened(path): bytearray() for path in paths}
        poll = select.poll()
        for client in received:
            poll.register(client, select.POLLIN)
        gone, end, memory_kb, calm_kb = set(), time.monotonic() + seconds + 30, 0, 0
        while len(gone) < LINKS and time.monotonic() < end:
            for client, _ in poll.poll(500):
                try:
                    received[client] += os.read(client, 4096)
                except OSError:  # the unit has ended
                    poll.unregister(client)
                    gone.add(client)
            with contextlib.suppress(OSError, StopIteration):  # the unit has ended
                memory_kb, calm_kb = unit.memory_kb("VmHWM"), unit.calm.memory_kb("VmHWM")
        status = unit.wait(10)
        unit.calm.end()
    numbers = [[int(wire.read_data(payload)["sequence"]) for _, payload in wire.Deframer().feed(data)] for data in map(bytes, received.values())]
    for client in received:
        os.close(client)
    first = max((each[0] for each in numbers if each), default=2 * seconds)
    whole = sum(each == list(range(each[0], 2 * seconds)) for each in numbers if each)
    figures.row("links", f"{LINKS} ptys of one process, read for {seconds} s")
    figures.at_most("first sample, of the link opened last", first, 4, "", "all clients have opened within 2 s", 0)
    figures.exactly("links with every sample from their first to the last", whole, LINKS, "all links carry the same data")
    figures.exactly("exit code", status, 0, "--duration")
    keeps_time(figures, unit)
    figures.at_most("memory at its largest, beyond that of a unit with one link", memory_kb - calm_kb, 64 * LINKS, "kB",
                    "64 kB a link: tasks and buffers for seconds of data", 0)


def vanished(figures, options, scratch):
    """Clients of a pty that are killed while they write and do not read; the next one opens it at once."""
    count, chosen, path = max(20, round(VANISHED * options.scale)), random.Random(options.seed), scratch / "geu0"
    with beside_calm(options.geu, "--control", "off", "--pty", path, "--tcp", "127.0.0.1:0") as unit, PtyDelay() as delay:
        unit.wait_for("ready pty")
        reader, begin = Reader(unit.tcp, PING), time.monotonic()
        first_s, beyond_s, unserved, early = [], [], 0, None
        for number in range(count):
            # Most write a few commands each millisecond, some as many as the kernel takes.
            burst = chosen.randrange(1, 30) if number % 100 else 0
            killed_in_mid_write(path, burst, chosen.uniform(0.0, 0.02))
            served = first_reply(path)
            unserved += served is None
            if served:
                first_s.append(served[0])
                beyond_s.append(served[1])
            if number == count // 5:
                early = unit.memory_kb(), unit.descriptors()
        took_s, used_s = time.monotonic() - begin, unit.processor_s()
        grown_kb, more = unit.memory_kb() - early[0], unit.descriptors() - early[1]
        time.sleep(3)
        idle = (unit.processor_s() - used_s) / 3
        reads_all(figures, reader, time.monotonic() - begin)
        figures.row("clients of a pty killed while they write", f"{count} in {took_s:.0f} s")
        figures.exactly("next clients without a reply within 10 s", unserved, 0, "the path is served as long as the unit runs")
        for name, times in (("first byte", first_s), ("own reply, beyond the line time of the replies before it", beyond_s)):
            figures.row(f"next client, from open to {name}: median", f"{sorted(times)[len(times) // 2] * 1e3:.1f} ms")
            figures.at_most(f"next client, from open to {name}: slowest", max(times) * 1e3, (SERVED_WITHIN_S + delay.worst_s) * 1e3, "ms",
                            f"100 ms, and {delay.worst_s * 1e3:.0f} ms that the host took for a byte over another pty")
        figures.row("next client, own reply later than 100 ms", f"{sum(time_s > SERVED_WITHIN_S for time_s in beyond_s)} of {count}")
        figures.at_most("memory, growth after a fifth of them", grown_kb, GROWTH_KB, "kB", GROWTH_REASON, 0)
        figures.at_most("descriptors, growth", more, 0, "", "a client's are closed with it", 0)
        figures.row("processor time meanwhile", f"{100 * used_s / took_s:.0f} % of one")
        figures.at_most("processor time in the 3 s after, of one", 100 * idle, 5, "%", "two samples a second and one client; a livelock takes 100 %")
        ends(figures, unit)


def killed_in_mid_write(path, burst, delay_s):
    """A process that opens the pty, writes commands without reading, and gets SIGKILL after a while."""
    ready, opens = os.pipe()
    client = os.fork()
    if client == 0:
        try:
            pty = os.open(path, os.O_RDWR | os.O_NOCTTY)
            os.write(opens, b".")
            while True:
                os.write(pty, SET_MODE_CYCLIC * (burst or 50))
                time.sleep(0.001 if burst else 0)
        finally:
            os._exit(1)
    os.close(opens)
    is_open = os.read(ready, 1)
    os.close(ready)
    time.sleep(delay_s)
    os.kill(client, signal.SIGKILL)
    os.waitpid(client, 0)
    if not is_open:
        raise RuntimeError(f"{path}: a client cannot open it")


def first_reply(path):
    """Times from opening the pty to the first byte, and to the reply to a PING, without the line time of the bytes before it: the
    commands of the killed client are carried out, and their replies leave at the rate of the line. Nothing after 10 s."""
    start, deframer, asks, received, first_s = time.monotonic(), wire.Deframer(), PING, 0, None
    client = opened(path)
    try:
        while time.monotonic() < start + 10:
            # A pty may be reported as ready and not be: its unread bytes are discarded when a client closes.
            with contextlib.suppress(BlockingIOError):
                readable, writable, _ = select.select([client], [client] if asks else [], [], 0.1)
                if writable:
                    asks = asks[os.write(client, asks):]
                data = os.read(client, 4096) if readable else b""
                received, took_s = received + len(data), time.monotonic() - start
                first_s = first_s or (took_s if data else None)
                if any(kind == wire.REPLY and payload[0] == 1 for kind, payload in deframer.feed(data)):
                    return first_s, took_s - received / BYTES_PER_S
    finally:
        os.close(client)
    return None


def silent(figures, options, _scratch):
    """TCP clients that send commands and never read."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    count, seconds = SILENT, max(5, 30 * options.scale)
    if hard != resource.RLIM_INFINITY and hard < count + 200:
        return figures.absent(f"{count} clients need as many descriptors, the limit is {hard}")
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, count + 200), hard))
    with beside_calm(options.geu, "--control", "off", "--tcp", "127.0.0.1:0") as unit:
        reader, begin, clients = Reader(unit.tcp, PING), time.monotonic(), []
        before_kb = unit.memory_kb()
        for _ in range(count):
            client = socket.socket()
            # The smallest buffer: what is not read fills it soon.
            client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1)
            client.connect(unit.tcp)
            client.setblocking(False)
            clients.append(client)
        end = time.monotonic() + seconds
        refused = {}
        while time.monotonic() < end:
            for number, client in enumerate(clients):
                try:
                    if number not in refused:
                        client.send(PING * 20)
                except BlockingIOError:
                    pass
                except OSError as error:
                    refused[number] = error
            time.sleep(0.05)
        grown_kb, descriptors = unit.memory_kb("VmHWM") - before_kb, unit.descriptors()
        reads_all(figures, reader, time.monotonic() - begin)
        figures.row("clients that never read", f"{count} on one TCP link for {seconds:.0f} s")
        figures.exactly("clients closed", len(refused), count - (SERVED - 1), "64 are served, of which one reads")
        figures.at_most("descriptors", descriptors, SERVED + 32, "", "those served, and the unit's own", 0)
        figures.at_most("memory, growth at its largest", grown_kb, 64 * SERVED, "kB", "64 kB a client: task, 512 byte of replies, one frame", 0)
        ends(figures, unit)
        counted = int(unit.summary(r"(\d+) connections refused")[1])
        figures.exactly("refusals in the summary", counted, len(refused), "docs/links.md: counted")
        for client in clients:
            client.close()


class Flood:
    """Connections to the control interface that are opened and used in one manner until the block ends."""

    def __init__(self, address, act, connections):
        host, port = address.rsplit(":", 1)
        self.address, self.act, self.over = (host, int(port)), act, threading.Event()
        self.requests, self.host = 0, address
        self.threads = [threading.Thread(target=self.run, daemon=True) for _ in range(8)]
        self.each = connections // len(self.threads)

    def run(self):
        kept = []
        while not self.over.is_set():
            try:
                if len(kept) < self.each:
                    client = socket.create_connection(self.address, timeout=0.5)
                    kept.append(client)
                client = kept[self.requests % len(kept)]
                self.act(self, client)
                self.requests += 1
            except OSError:  # refused, closed or full, which is the interface's right
                if kept:
                    kept.pop(0).close()
                time.sleep(0.01)
        for client in kept:
            client.close()

    def __enter__(self):
        for thread in self.threads:
            thread.start()
        return self

    def __exit__(self, *_):
        self.over.set()
        for thread in self.threads:
            thread.join(3)


def request(flood, client):
    client.sendall(f"GET /api/status HTTP/1.1\r\nHost: {flood.host}\r\n\r\n".encode())
    client.recv(65536)


def slow_headers(_flood, client):
    client.sendall(b"G")
    time.sleep(0.02)


def events(flood, client):
    client.sendall(f"GET /api/events HTTP/1.1\r\nHost: {flood.host}\r\n\r\n".encode())
    time.sleep(0.05)


def bodies(flood, client):
    client.sendall(f"POST /api/faults HTTP/1.1\r\nHost: {flood.host}\r\nContent-Type: application/json\r\n"
                   "Content-Length: 60000\r\n\r\n".encode() + b"[" * 30000)
    time.sleep(0.05)


def idle(_flood, client):
    time.sleep(0.05)
    client.getpeername()


STATES = {"requests": request, "slow headers": slow_headers, "event clients that never read": events, "bodies cut": bodies, "idle": idle}


def control(figures, options, _scratch):
    """Connections and requests beyond the limits of the control interface, in each manner."""
    seconds, connections = max(3, 10 * options.scale), 200
    for name, act in STATES.items():
        words = f", {name}"
        with beside_calm(options.geu, "--control", "127.0.0.1:0", "--tcp", "127.0.0.1:0") as unit:
            reader, begin = Reader(unit.tcp, PING), time.monotonic()
            before, before_kb, highest = unit.descriptors(), unit.memory_kb(), 0
            with Flood(unit.control, act, connections) as flood:
                while time.monotonic() < begin + seconds:
                    highest = max(highest, unit.descriptors())
                    time.sleep(0.02)
                grown_kb = unit.memory_kb("VmHWM") - before_kb
                reads_all(figures, reader, time.monotonic() - begin, words)
                figures.row(f"connections, turns{words}", f"{connections}, {flood.requests} in {seconds:.0f} s")
                figures.at_most(f"descriptors, growth at most{words}", highest - before, CONTROL_SERVED + CONTROL_REJECTED + 2, "",
                                "32 connections, 16 that get an error, the reader, one just accepted", 0)
                figures.at_most(f"memory, growth at its largest{words}", grown_kb, 16 * 1024, "kB",
                                "32 connections with 64 kB of body, 16 kB of headers and events", 0)
                ends(figures, unit, words=words)
