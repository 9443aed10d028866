"""Emulator, decoder and evaluation of gyro electronics units.

>>> import geu
>>> recording = geu.simulate(duration="10m", seed=1)
>>> len(recording.samples)
1200

Functions
---------
decode      recordings and live links to an Arrow table
simulate    a recording of a simulated unit
calibrate   the calibration parameters of a unit from a recording and a reference
diagnose    the effect that a model lacks
command     any other command of geu

Classes
-------
Emulator       a running unit on a pty, TCP, CAN or a serial port
Decoder        decodes the serial bytes of a link as they arrive
Configuration  a configuration of a unit
Device         a gyro unit: its heads, interval and links
GeuError       what went wrong, where, what was expected
"""

from ._geu import Decoder, __version__
from ._run import command
from .configuration import Configuration
from .decoding import Samples, decode
from .device import Device, devices
from .emulator import Emulator
from .errors import GeuError, InputError
from .evaluation import Calibration, Diagnosis, Effect, Estimate, Finding, calibrate, diagnose
from .simulation import Recording, simulate

__all__ = [
    "Calibration", "Configuration", "Decoder", "Device", "Diagnosis", "Effect", "Emulator", "Estimate", "Finding", "GeuError", "InputError",
    "Recording", "Samples", "__version__", "calibrate", "command", "decode", "devices", "diagnose", "simulate",
]
