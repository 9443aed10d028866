"""Faults from the catalogue, and the bytes that `faults.jsonl` claims against those a client received."""
import http.client
import json
import re
import select
import subprocess
import threading
import time
from pathlib import Path

from emulator import Process
from wire import DATA, REPLY, Deframer, crc16

SAMPLE_INTERVAL_NS = 500_000_000
FRAME = 28


def catalogue(geu):
    return json.loads(subprocess.run([geu, "faults", "list", "--json"], check=True, capture_output=True).stdout)


# Values, chosen by form and limits alone so that a new fault has some too.

def value(number, gyro=None):
    """A value that does something."""
    if number["form"] == "choice":
        return number["default"] or number["choices"][0]
    if number["form"] == "flag":
        return True
    if number["form"] == "gyro":
        return "GYRZB" if gyro != "GYRZB" else "GYRX"
    if number["default"]:
        chosen = number["default"]
    else:
        wished = {"s": 0.4, "baud": 57_600.0}.get(number["unit"], 20.0)
        chosen = min(max(3 if number["form"] == "whole" else wished, number["least"]), number["greatest"])
    return int(chosen) if number["form"] == "whole" else float(chosen)


def variants(spec, gyro=None):
    """Values for every number, then each with another choice."""
    base = {number["name"]: value(number, gyro) for number in spec["numbers"]}
    others = [{**base, number["name"]: other} for number in spec["numbers"]
              for other in {"choice": number["choices"], "flag": [False]}.get(number["form"], [])
              if other != base[number["name"]]]
    return [base, *others]


def size(parameter, gyro=None):
    """What is added to a parameter."""
    if parameter["form"] == "flag":
        return True
    if parameter["form"] == "gyro":
        return "GYRZB" if gyro != "GYRZB" else "GYRX"
    return float(min(parameter["greatest"] / 2, 10_000))


def toml_value(value):
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {toml_value(item)}" for key, item in value.items()) + " }"
    return json.dumps(value)


def plan(faults, expectations=()):
    """A plan's text."""
    tables = [("fault", fault) for fault in faults] + [("expect", expectation) for expectation in expectations]
    return "\n".join(f"[[{kind}]]\n" + "".join(f"{key} = {toml_value(value)}\n" for key, value in table.items())
                     for kind, table in tables)


def link_faults(listed, links):
    """Every fault of a link in every variant, each with the links that have it: (what, [fault for each link])."""
    for spec in listed["faults"]:
        if spec["scope"] != "link":
            continue
        for index, numbers in enumerate(variants(spec)):
            able = [link for link in links if spec["links"][link] is None]
            faults = [{"id": f"{spec['fault']}.{index}-{link}", "fault": spec["fault"], "link": link, **numbers}
                      for link in able]
            if faults:
                yield spec, faults


def unit_faults(listed):
    """Every fault of a gyro and of the unit in every variant; the gyros take turns."""
    turn = 0
    for spec in listed["faults"]:
        for index in range(len(variants(spec)) if spec["scope"] != "link" else 0):
            gyro = listed["gyros"][turn % 4] if spec["scope"] == "gyro" else None
            turn += gyro is not None
            numbers = variants(spec, gyro)[index]
            yield {"id": f"{spec['fault']}.{index}", "fault": spec["fault"], **({"gyro": gyro} if gyro else {}), **numbers}


def parameter_faults(listed):
    """Every parameter stepped on every gyro that has it, and one in every kind of course."""
    for parameter in listed["parameters"]:
        for gyro in parameter["gyros"] or [None]:
            name = parameter["parameter"]
            yield {"id": f"{name}.{gyro or 'unit'}", "parameter": name, **({"gyro": gyro} if gyro else {}),
                   "course": {"step": size(parameter, gyro)}}
    one = next(p for p in listed["parameters"] if p["parameter"] == "drift.arcsec_per_h")
    for course in listed["courses"]:
        numbers = {n["name"]: value(n) for n in course["numbers"][1:] if n["required"]}
        yield {"id": f"course-{course['course']}", "parameter": one["parameter"], "gyro": "GYRY",
               "course": {course["course"]: size(one), **numbers}}


class Clock:
    """Gives faults their time, one after the other."""

    def __init__(self, for_s, gap_s):
        self.at_s, self.for_s, self.gap_s = 2.0, for_s, gap_s

    def place(self, faults):
        placed = [{**fault, "at_s": self.at_s, "for_s": self.for_s} for fault in faults]
        self.at_s += self.for_s + self.gap_s
        return placed


# A running unit and those who listen.

class Tape(threading.Thread):
    """All bytes that pySerial reads, and when."""

    def __init__(self, url, baud=115_200):
        super().__init__(daemon=True)
        import serial  # pylint: disable=import-outside-toplevel
        self.lost = serial.SerialException
        self.port = serial.serial_for_url(str(url), baudrate=baud, timeout=0)
        self.data, self.chunks, self.stop = bytearray(), [], False
        self.start()

    def run(self):
        try:
            while not self.stop:
                if select.select([self.port.fileno()], [], [], 0.05)[0]:
                    data = self.port.read(4096)
                    self.chunks.append((time.monotonic(), len(data)))
                    self.data += data
        except (self.lost, OSError, TypeError, ValueError):
            pass  # the unit has gone

    def times(self):
        """When each byte came."""
        return [when for when, length in self.chunks for _ in range(length)]

    def frames(self, kind):
        return [payload for of, payload in Deframer().feed(bytes(self.data)) if of == kind]

    def until(self, done, seconds):
        end = time.monotonic() + seconds
        while not done() and time.monotonic() < end:
            time.sleep(0.002)
        return done()

    def close(self):
        self.stop = True
        self.join(1)
        self.port.close()


class Running:
    """A unit with clients on its links, from before its first sample."""

    def __init__(self, geu, directory, *more, links=("tcp",), faults=None, baud=115_200):
        directory.mkdir()
        self.geu, self.directory, self.record = geu, directory, directory / "record"
        self.tapes, self.socat, self.port = {}, None, None
        words = [geu, "run", "--record", self.record, "--control", "127.0.0.1:0", *more]
        if faults is not None:
            (directory / "plan.toml").write_text(faults)
            words += ["--faults", directory / "plan.toml"]
        # The first link is recorded.
        if "can" in links:
            words += ["--can", "vcan0"]
        if "serial" in links:
            ours, theirs = directory / "ours", directory / "theirs"
            self.socat = Process("socat", f"pty,rawer,link={ours}", f"pty,rawer,link={theirs}")
            end = time.monotonic() + 5
            while not (ours.exists() and theirs.exists()) and time.monotonic() < end:
                time.sleep(0.01)
            self.tapes["serial"] = Tape(ours, baud)
            words += ["--serial", f"{theirs}:{baud}"]
        if "pty" in links:
            words += ["--pty", directory / "pty"]
        if "tcp" in links:
            words += ["--tcp", "127.0.0.1:0"]
        has_clients = "tcp" in links or "pty" in links
        self.process = Process(*words, *(["--wait"] if has_clients else []))
        if "can" in links:
            self.process.wait_for("ready can vcan0")
        ready = self.process.wait_for("ready tcp") if "tcp" in links else ""
        if "pty" in links:
            self.process.wait_for("ready pty")
        self.port = int(self.process.wait_for("ready control http://127.0.0.1:").strip("/").rsplit(":", 1)[1])
        # Both connect within the first sample interval: the first client starts the run.
        if "tcp" in links:
            self.tapes["tcp"] = Tape("socket://" + ready.split()[-1])
        if "pty" in links:
            self.tapes["pty"] = Tape(directory / "pty")

    def ask(self, method, path, body=None):
        """Status and answer of the control interface."""
        data = body if isinstance(body, bytes) or body is None else json.dumps(body).encode()
        asked = http.client.HTTPConnection("127.0.0.1", self.port, timeout=10)
        try:
            asked.request(method, path, data, {"content-type": "application/json"})
        except BrokenPipeError:
            pass  # a body that is too long is not read to its end
        try:
            answer = asked.getresponse()
            text = answer.read()
        finally:
            asked.close()
        try:
            return answer.status, json.loads(text or b"null")
        except ValueError:
            return answer.status, text.decode(errors="replace")

    def inject(self, fault):
        return self.ask("POST", "/api/faults", fault)

    def states(self):
        return {fault["id"]: fault["state"] for fault in self.ask("GET", "/api/faults")[1]}

    def until_state(self, ids, state, seconds=10):
        """Waits until all these faults have this state."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            states = self.states()
            if all(states.get(key) == state for key in ids):
                return True
            time.sleep(0.01)
        return False

    def end(self, seconds=None):
        """Waits for its end, or asks for it; the exit status."""
        status = self.process.wait(seconds) if seconds else self.process.end()[0]
        time.sleep(0.3)
        for tape in self.tapes.values():
            tape.close()
        if self.socat:
            self.socat.end()
        return status

    def panicked(self):
        return [line for line in self.process.errors if "panick" in line]

    def events(self):
        return read_events(self.record)

    def half_seconds(self):
        line = next((line for line in self.process.errors if line.startswith("samples ")), "samples 0,")
        return int(re.match(r"samples (\d+)", line)[1])


def read_events(record):
    return [json.loads(line) for line in (Path(record) / "faults.jsonl").read_text().splitlines()]


# What is claimed, and whether it came.

def claimed(events, link, first, half_seconds):
    """What the link carries, in order: (when, ns on board; which sample; bytes as claimed, or None where a
    whole frame is expected that no fault touched)."""
    touched = {}
    for event in events:
        if event["what"] == "bytes" and event["link"] == link and not event.get("polled"):
            touched.setdefault(event["half_second"], []).append(event)
    messages = []
    for index in range(first, half_seconds):
        end_ns = (index + 1) * SAMPLE_INTERVAL_NS
        if index not in touched:
            messages.append([(end_ns, index, None)])
        goes_on = False
        for part in (part for event in touched.get(index, []) for part in event["after"]):
            if not goes_on:
                messages.append([])
            messages[-1].append((end_ns + round(part["late_s"] * 1e9), index, part["bytes"]))
            goes_on = part.get("goes_on", False)
    # Messages may overtake each other, but the parts of one hold back all others; with the end the rest leaves.
    parts, free_ns, last_ns = [], 0, half_seconds * SAMPLE_INTERVAL_NS
    for message in sorted(messages, key=lambda message: message[0][:2]):
        wait_ns = max(0, free_ns - message[0][0])
        parts += [(due_ns + wait_ns, index, claim) for due_ns, index, claim in message]
        free_ns = max(free_ns, parts[-1][0])
    return [(min(due_ns, last_ns), index, claim) for due_ns, index, claim in parts]


def whole_frame(data, kind=DATA, lengths=range(22, 23)):
    """The length of a frame at the beginning of the data; 0 where there is none."""
    if len(data) < 6 or data[:3] != b"\xEB\x90" + bytes([kind]) or data[3] not in lengths:
        return 0
    end = data[3] + 6
    good = len(data) >= end and crc16(data[2:end - 2]) == int.from_bytes(data[end - 2:end], "big")
    return end if good else 0


class Matched:
    """A client's bytes beside what is claimed: the first thing wrong, the frames of the samples without faults
    (as received where no fault touched them), and when each part came."""

    def __init__(self, data, times, events, link, half_seconds):
        data = bytes(data)
        first = int.from_bytes(data[4:6], "big") if whole_frame(data) else 0
        self.first, self.wrong, self.clean, self.came, self.replies, self.frames = first, "", {}, [], [], 0
        for event in events:
            if event["what"] == "bytes" and event["link"] == link and event["before"]:
                self.clean[event["half_second"]] = bytes.fromhex(event["before"][0])
        place = 0
        for due_ns, index, claim in claimed(events, link, first, half_seconds):
            if claim is not None:
                claim = bytes.fromhex(claim)
            while data[place:place + len(claim or b"") or FRAME] != claim:
                if claim is None and whole_frame(data[place:]):
                    break
                length = whole_frame(data[place:], REPLY, range(2, 9))
                if not length:
                    self.wrong = (f"sample {index}: expected {claim.hex().upper() if claim else 'a whole frame'}, got "
                                  f"{data[place:place + len(claim or b'') + FRAME].hex().upper()} at byte {place}")
                    return
                self.replies.append(data[place:place + length])
                place += length
            if claim is None:
                self.clean[index] = claim = data[place:place + FRAME]
                self.frames += 1
            place += len(claim)
            if claim:
                self.came.append((times[place - 1], due_ns, index))
        while length := whole_frame(data[place:], REPLY, range(2, 9)):
            self.replies.append(data[place:place + length])
            place += length
        if place < len(data):
            self.wrong = f"{len(data) - place} bytes more than claimed: {data[place:place + 60].hex().upper()}"

    def lateness(self, speed, events, link):
        """How early a part came at worst, s, and how late the parts of a fault came at best, for the worst fault: a
        host without a processor to spare makes some of them late, a fault with a wrong claim all of them."""
        shifts = [(when - due_ns * 1e-9 / speed, index) for when, due_ns, index in self.came]
        quick, best = sorted(shifts)[len(shifts) // 10][0], {}
        ids = {event["half_second"]: tuple(event["ids"]) for event in events
               if event["what"] == "bytes" and event["link"] == link}
        for shift, index in shifts:
            key = ids.get(index, ())
            best[key] = min(best.get(key, shift), shift)
        return min(shifts)[0] - quick, max(best.values()) - quick


class MatchedCan:
    """The same for candump's frames on a bus without other nodes: (seconds, identifier, data)."""

    def __init__(self, frames, events, half_seconds, commands=(0x1A8, 0x1A9)):
        frames = [(when, f"{identifier:03X}#{data.hex().upper()}") for when, identifier, data in frames]
        self.first = int(frames[1][1][4:8], 16) if len(frames) > 1 else 0
        self.wrong, self.clean, self.came, self.others = "", {}, [], []
        for event in events:
            if event["what"] == "bytes" and event["link"] == "can" and event["before"]:
                self.clean[event["half_second"]] = event["before"]
        answers = tuple(f"{identifier:03X}#" for identifier in commands)
        place = 0
        for due_ns, index, claim in claimed(events, "can", self.first, half_seconds):
            wanted = 3 if claim is None else 1
            while True:
                got = [text for _, text in frames[place:place + wanted]]
                if got == [claim] or (claim is None and self._is_whole(got)):
                    break
                if not got or not got[0].startswith(answers):
                    self.wrong = f"sample {index}: expected {claim or 'three whole messages'}, got {got} at frame {place}"
                    return
                self.others.append(frames[place])
                place += 1
            if claim is None:
                self.clean[index] = got
            place += wanted
            self.came.append((frames[place - 1][0], due_ns, index))
        self.others += [one for one in frames[place:] if one[1].startswith(answers)]
        more = [text for _, text in frames[place:] if not text.startswith(answers)]
        if more:
            self.wrong = f"{len(more)} frames more than claimed: {more[:5]}"

    @staticmethod
    def _is_whole(got):
        if [text[:4] for text in got] != ["1A0#", "1A1#", "1A2#"]:
            return False
        increments, status, clock = (bytes.fromhex(text[4:]) for text in got)
        return len(increments) == len(status) == len(clock) == 8 and \
            crc16(increments + status[:6]) == int.from_bytes(status[6:], "big")

    lateness = Matched.lateness
