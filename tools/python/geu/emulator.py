"""A running unit."""

from __future__ import annotations

import atexit
import http.client
import json
import os
import queue
import signal
import subprocess
import tempfile
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any

from . import _run
from ._run import Paths, StrPath
from .configuration import Configuration
from .errors import GeuError, InputError, error

_READY_S = 20
_ANSWER_S = 5
_END_S = 20


class Emulator:
    """A unit on its links, in a process of its own, as a context manager.

    Parameters
    ----------
    config : path or Configuration, optional
        Configuration of the run; the reference unit on its default scenario without it.
    pty : path or True, optional
        Link on a pty with this name; True, and no link at all, take a free name.
    tcp : str or True, optional
        ``HOST:PORT``; True takes a free port of the loopback interface.
    can, serial : str, optional
        CAN interface, ``vcan0`` or ``vcan0:BASE``; serial port, ``/dev/ttyUSB0:115200``.
    device : str or path, optional
        Another unit than the default one.
    seed, start, duration, speed, truth, record, junit, wire, wait : optional
        As of ``geu run``.
    faults : path or list of paths, optional
        Plans of faults.
    set : dict, optional
        Values of the configuration.

    **more
        Further options of ``geu run``: ``tcp_allow="192.168.7.0/24"``, ``spin=50``.

    Attributes
    ----------
    links : list of (str, str)
        Kind and address of each link: ``("pty", "/tmp/…/geu0")``.
    recording, junit : pathlib.Path or None
        Directory of the recording, file of the verdicts on expectations.
    control : str
        Address of the control interface, ``http://127.0.0.1:…``; its page is for browsers.

    Examples
    --------
    >>> with geu.Emulator(tcp=True) as unit:
    ...     unit.inject("stuck-count", "GYRX", counts=120, for_s=3)
    ...     samples = geu.decode(unit.link, duration=5)
    """

    def __init__(self, config: StrPath | Configuration | None = None, *, pty: StrPath | bool | None = None, tcp: str | bool | None = None,
                 can: str | None = None, serial: str | None = None, device: StrPath | None = None, seed: int | None = None,
                 start: float | None = None, duration: float | str | None = None, speed: float | str | None = None,
                 truth: str | None = None, faults: Paths | None = None, set: dict[str, Any] | None = None,
                 record: StrPath | None = None, junit: StrPath | None = None, wire: str | None = None, wait: bool = False,
                 **more: Any) -> None:
        self._config, self.device = config, device
        self.recording = None if record is None else Path(record)
        self.junit = None if junit is None else Path(junit)
        self._process: subprocess.Popen[str] | None = None
        self._scratch: tempfile.TemporaryDirectory[str] | None = None
        self._lines: queue.Queue[str | None] = queue.Queue()
        self._errors: list[str] = []
        self._readers: list[threading.Thread] = []
        self._given = dict(tcp="127.0.0.1:0" if tcp is True else tcp, can=can, serial=serial, seed=seed, start=start, duration=duration,
                           speed=speed, truth=truth, faults=_run.paths(faults) if faults else None, set=set, record=record, junit=junit,
                           wire=wire, wait=wait, **more, device=os.fspath(device) if device is not None else None)
        self._pty = True if not any((pty, tcp, can, serial)) else pty
        self.links: list[tuple[str, str]] = []
        self.control = ""

    def __enter__(self) -> Emulator:
        return self if self.is_running else self.start()

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None) -> None:
        self.stop()

    def start(self) -> Emulator:
        """Starts the unit; returns when its links are ready.

        Raises
        ------
        InputError
            A configuration, a link or an option is wrong.
        """
        if self._process is not None:
            raise GeuError("the unit was started before; make another geu.Emulator")
        self._scratch = tempfile.TemporaryDirectory(prefix="geu-")
        pty = Path(self._scratch.name) / "geu0" if self._pty is True else self._pty
        config = self._config
        if config is not None and not isinstance(config, (str, os.PathLike)):
            path = Path(self._scratch.name) / "configuration.toml"
            path.write_text(config.text, encoding="utf-8")
            config = path
        arguments = _run.options(pty=pty, control="127.0.0.1:0", **self._given)
        arguments += [os.fspath(config)] if config is not None else []
        # A session of its own: Ctrl-C ends the program, which then ends the unit. It ends too when this process does, and with it the pipe.
        self._process = subprocess.Popen([*_run.COMMAND, "run", *arguments], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                                         stderr=subprocess.PIPE, text=True, errors="replace", env={**_run.environment(), _run.ENDS_WITH_INPUT: "1"}, start_new_session=True)
        atexit.register(self.stop)
        self._readers = [threading.Thread(target=read, args=(self._process,), daemon=True) for read in (self._read_lines, self._read_errors)]
        for reader in self._readers:
            reader.start()
        try:
            self._await_ready(self._process)
        except BaseException:
            self.stop()
            raise
        return self

    def _read_lines(self, process: subprocess.Popen[str]) -> None:
        assert process.stdout is not None
        for line in process.stdout:
            self._lines.put(line.rstrip("\n"))
        self._lines.put(None)

    def _read_errors(self, process: subprocess.Popen[str]) -> None:
        assert process.stderr is not None
        for line in process.stderr:
            self._errors.append(line)
            del self._errors[:-1000]

    def _await_ready(self, process: subprocess.Popen[str]) -> None:
        until = time.monotonic() + _READY_S
        while not self.control:
            try:
                line = self._lines.get(timeout=max(0.0, until - time.monotonic()))
            except queue.Empty:
                raise GeuError(f"geu run: expected `ready control` within {_READY_S} s, got none") from None
            if line is None:
                code = process.wait()
                self._readers[1].join(_END_S)
                raise error(_run.message("".join(self._errors)) or f"geu run ended with {code}", code)
            word, _, ready = line.partition(" ")
            kind, _, address = ready.partition(" ")
            if word == "ready" and kind == "control":
                self.control = address.rstrip("/")
            elif word == "ready":
                self.links.append((kind, address))

    @property
    def link(self) -> str:
        """str: address of the first link, as ``geu.decode`` takes it."""
        self._verify_started()
        return self.links[0][1]

    def _verify_started(self) -> None:
        if not self.control:
            raise GeuError("the unit was not started: use `with geu.Emulator(...) as unit`, or start()")


    @property
    def is_running(self) -> bool:
        return self._process is not None and self._process.poll() is None

    @property
    def log(self) -> str:
        """str: what the unit printed to standard error."""
        return "".join(self._errors)

    def stop(self) -> int | None:
        """Ends the unit; its links are removed, and a recording is complete. Returns the exit code."""
        atexit.unregister(self.stop)
        if self._process is not None and self._process.poll() is None:
            self._process.send_signal(signal.SIGTERM)
            try:
                self._process.wait(_END_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
                self._errors.append(f"geu: killed: the unit did not end within {_END_S} s; its recording may be cut\n")
        for reader in self._readers:
            reader.join(_END_S)
        for stream in (self._process.stdin, self._process.stdout, self._process.stderr) if self._process is not None else ():
            if stream is not None:
                stream.close()
        if self._scratch is not None:
            self._scratch.cleanup()
        return None if self._process is None else self._process.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Waits for the end of a run with a duration; returns its exit code.

        Raises
        ------
        TimeoutError
            It runs on.
        """
        self._verify_started()
        assert self._process is not None
        try:
            return self._process.wait(timeout)
        except subprocess.TimeoutExpired:
            raise TimeoutError(f"the unit runs on after {timeout} s") from None

    def _ask(self, method: str, path: str, body: dict[str, Any] | None = None) -> Any:
        self._verify_started()
        data = None if body is None else json.dumps(body).encode()
        headers = {"Content-Type": "application/json"} if data else {}
        request = urllib.request.Request(self.control + path, data, headers, method=method)
        try:
            with _opener.open(request, timeout=_ANSWER_S) as answer:
                return json.load(answer)
        except urllib.error.HTTPError as refused:
            with refused:
                raise InputError(json.load(refused)["error"], 2) from None
        except (OSError, http.client.HTTPException, ValueError) as failure:
            raise GeuError(f"{self.control}: {failure}; expected a running unit") from None

    def status(self) -> dict[str, Any]:
        """dict: state of the run: on-board time, links, lateness, faults, the last sample."""
        status: dict[str, Any] = self._ask("GET", "/api/status")
        return status

    def faults(self) -> list[dict[str, Any]]:
        """list of dict: all faults: armed, active, over."""
        faults: list[dict[str, Any]] = self._ask("GET", "/api/faults")
        return faults

    def inject(self, what: str, *where: str, **keys: Any) -> str:
        """Injects a fault, as ``geu inject``; ``geu faults list`` has the names.

        Parameters
        ----------
        what : str
            A parameter, ``"pivot-clearance.clearance_arcsec"``, or a fault, ``"bit-flip"``.
        *where : str
            A gyro, a link: ``"GYRX"``, ``"pty"``.
        **keys
            Course and numbers: ``step=11.5``, ``for_s=600``, ``when="frame % 10 == 0"``.

        Returns
        -------
        str
            Identifier of the fault.
        """
        self._verify_started()
        given = [f"{key}={_run.toml(value)}" for key, value in keys.items()]
        text, *_ = _run.run("inject", f"--control={self.control}", "--", what, *where, *given)
        return text.split()[0]

    def inject_plan(self, plan: StrPath) -> list[str]:
        """Injects all faults of a plan (TOML text or the path of a file), or none; returns their identifiers."""
        is_path = isinstance(plan, os.PathLike) or "\n" not in plan
        try:
            text = Path(plan).read_text(encoding="utf-8") if is_path else os.fspath(plan)
        except (OSError, UnicodeError) as failure:
            raise InputError(f"{plan}: cannot be read: {failure}; expected a plan, TOML", 2) from None
        added = self._ask("POST", "/api/faults", {"plan": text, "name": os.fspath(plan) if is_path else "plan"})
        return [fault["id"] for fault in added]

    def clear(self, fault: str | None = None) -> None:
        """Ends a fault by its identifier, or all."""
        self._ask("DELETE", "/api/faults" if fault is None else f"/api/faults/{fault}")

    def command(self, name: str, *arguments: int) -> dict[str, Any]:
        """Sends the unit a command by its name; returns the decoded reply as a dict."""
        reply: dict[str, Any] = self._ask("POST", "/api/commands", {"name": name, "arguments": list(arguments)})
        return reply

    def events(self, timeout: float | None = None) -> Iterator[tuple[str, dict[str, Any]]]:
        """Yields the events of the unit as (name, dict): one for each sample, and what happens in between.

        Parameters
        ----------
        timeout : float, optional
            Ends after this many seconds without an event, and keep-alive signs; without it when the unit ends.
        """
        self._verify_started()
        try:
            opened = _opener.open(self.control + "/api/events", timeout=timeout)
        except OSError as failure:
            raise GeuError(f"{self.control}: {failure}; expected a running unit") from None
        with opened as stream:
            name = ""
            try:
                for line in stream:
                    key, _, value = line.decode().rstrip("\n").partition(":")
                    if key == "event":
                        name = value.strip()
                    elif key == "data":
                        yield name, json.loads(value)
            except (OSError, http.client.HTTPException):
                return

    def __repr__(self) -> str:
        links = ", ".join(f"{kind} {address}" for kind, address in self.links) or "not started"
        return f"<geu.Emulator {links}>"


# The control interface is on loopback: no proxy of the environment applies.
_opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
