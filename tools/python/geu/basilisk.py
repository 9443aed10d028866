"""The unit in a Basilisk simulation, in lock-step: attitude out, measured increments in. Needs Basilisk (`pip install bsk`).

    gyros = GyroUnit(set={"gyro.GYRX.drift.arcsec_per_h": 36})
    gyros.scStateInMsg.subscribeTo(spacecraft.scStateOutMsg)
    simulation.AddModelToTask("dynamics", gyros)
    controller.imuInMsg.subscribeTo(gyros.imuOutMsg)
    ...
    simulation.ExecuteSimulation()
    gyros.stop()
"""

from __future__ import annotations

import json
import math
import socket
from typing import Any

import numpy
from Basilisk.architecture import messaging, sysModel

from . import _geu
from .emulator import Emulator
from .errors import GeuError

_WAIT_S = 30
_INTERVAL_S = 0.5
_RAD_PER_COUNT = math.pi / 180 / 3600
# The clock of the unit is within 1000 ppm of the nominal one; times of samples are reported in decimals.
_LONGEST_INTERVAL_S = _INTERVAL_S * 1.001 + 1e-6
_HEADS = ("gyrx", "gyry", "gyrza", "gyrzb")
_AXES = numpy.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 1]], dtype=float)


class GyroUnit(sysModel.SysModel):  # type: ignore[misc]
    """The default unit as a module of a Basilisk task of a fixed rate.

    Each update sends the attitude of the spacecraft to the unit. A sample that has ended before this instant is received from the unit's link, and
    is in the messages from this update on: the same numbers each time, whatever the speed of the machine.

    Parameters
    ----------
    config, seed, start, faults, set, record, junit : optional
        As of ``geu.Emulator``; ``record`` keeps the recording for ``geu.diagnose``.

    Attributes
    ----------
    scStateInMsg : SCStatesMsgReader
        State of the spacecraft.
    imuOutMsg : IMUSensorMsg
        Of the samples since the update before, by nominal scale factors and axes: ``DRFramePlatform`` the angle about each axis (rad), ``AngVelPlatform`` the
        mean rate. It is written only with a new sample.
    samples : list of dict
        Every sample, as ``geu.decode`` names its columns.
    emulator : geu.Emulator
        The unit: to inject faults.
    """

    def __init__(self, config: Any = None, **given: Any) -> None:
        super().__init__()
        self.ModelTag = "gyros"
        self.scStateInMsg = messaging.SCStatesMsgReader()
        self.imuOutMsg = messaging.IMUSensorMsg()
        self.samples: list[dict[str, Any]] = []
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.settimeout(_WAIT_S)
        address = "tcp://127.0.0.1:%d" % self._listener.getsockname()[1]
        self.emulator = Emulator(config, tcp=True, truth=address, speed="max", **given).start()
        try:
            self._connect()
        except BaseException:
            self.emulator.stop()
            raise
        self._end_s = 0.0
        self._zero_s: float | None = None

    def _connect(self) -> None:
        self._truth, _ = self._listener.accept()
        self._truth.settimeout(_WAIT_S)
        # Lines are short, and each is waited for.
        self._truth.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._reports = self._truth.makefile("r")
        host, port = self.emulator.link.rsplit(":", 1)
        self._link = socket.create_connection((host, int(port)), timeout=_WAIT_S)
        self._decoder = _geu.Decoder()
        self._truth.sendall(b'{"subscribe": "samples"}\n')

    def Reset(self, nanoseconds: int) -> None:
        """Begins with an empty message."""
        self.imuOutMsg.write(messaging.IMUSensorMsgPayload(), nanoseconds, self.moduleID)

    def UpdateState(self, nanoseconds: int) -> None:
        """Sends the attitude of this instant, and receives the samples that have ended."""
        t_s = nanoseconds * 1e-9
        sigma = numpy.array(self.scStateInMsg().sigma_BN)
        square = float(sigma @ sigma)
        q = [(1 - square) / (1 + square), *(2 * sigma / (1 + square)).tolist()]
        self._truth.sendall(json.dumps({"t_s": t_s, "q": q}).encode() + b"\n")
        # The first truth sample is time zero of the unit.
        self._zero_s = t_s if self._zero_s is None else self._zero_s
        received = len(self.samples)
        while self._zero_s + self._end_s + _LONGEST_INTERVAL_S < t_s:
            self._receive()
        self._write(self.samples[received:], nanoseconds)

    def _receive(self) -> None:
        """Receives one sample, after the report of its bytes."""
        try:
            line = self._reports.readline()
        except OSError:
            line = ""
        if not line:
            raise GeuError(f"the unit reported no sample within {_WAIT_S} s: {self.emulator.log.strip()[-300:]}")
        report = json.loads(line)
        self._end_s = report["t_s"] - (self._zero_s or 0.0)
        left = report["sent"][f"tcp {self.emulator.link}"]["bytes"]
        while left > 0:
            try:
                data = self._link.recv(left)
            except OSError:
                data = b""
            if not data:
                raise GeuError("the unit closed its link")
            left -= len(data)
            self.samples += self._decoder.feed(data)

    def _write(self, samples: list[dict[str, Any]], nanoseconds: int) -> None:
        """Writes the sum of new samples; without one the message stays as it is."""
        if not samples:
            return
        angles = numpy.zeros(3)
        for sample in samples:
            valid = numpy.array([sample[f"{head}_valid"] for head in _HEADS], dtype=float)
            counts = numpy.array([sample[head] for head in _HEADS], dtype=float)
            # Least squares over the valid gyros; an axis without one keeps 0.
            angles += numpy.linalg.pinv(_AXES * valid[:, None]) @ (counts * valid) * _RAD_PER_COUNT
        payload = messaging.IMUSensorMsgPayload()
        payload.DRFramePlatform = angles.tolist()
        payload.AngVelPlatform = (angles / (_INTERVAL_S * len(samples))).tolist()
        self.imuOutMsg.write(payload, nanoseconds, self.moduleID)

    def stop(self) -> None:
        """Ends the unit; its recording is complete."""
        self.emulator.stop()
        for end in (self._reports, self._truth, self._link, self._listener):
            end.close()
