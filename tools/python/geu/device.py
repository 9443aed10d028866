"""Gyro units that are known by name or described in a file."""

import os

from ._run import run


def devices():
    """list of str: names of the known units."""
    return [line.split()[0] for line in run("device", "list")[0].splitlines()]


class Device:
    """A gyro unit.

    Parameters
    ----------
    name : str or path
        Name of ``geu.devices()``, or a description (TOML).

    Raises
    ------
    InputError
        There is no such unit, or the description is not valid: file, line, what was expected.
    """

    def __init__(self, name):
        self.name = os.fspath(name)
        self._text = run("device", "show", self.name)[0]

    def __fspath__(self):
        return self.name

    def show(self):
        """What the unit is and what its frames carry, byte by byte."""
        return self._text

    def to_toml(self):
        """The description, to begin another one with."""
        return run("device", "show", self.name, "--toml")[0]

    def describe(self, what):
        """A generated file: ``dbc``, ``header``, ``dissector`` or ``icd``."""
        return run("describe", what, "--device", self.name)[0]

    def __repr__(self):
        return f"<geu.Device {self.name}>"
