"""Gyro units that are known by name or described in a file."""

from __future__ import annotations

import os

from ._run import StrPath, run


def devices() -> list[str]:
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

    def __init__(self, name: StrPath) -> None:
        self.name = os.fspath(name)
        self._text = run("device", "show", self.name)[0]

    def __fspath__(self) -> str:
        return self.name

    def show(self) -> str:
        """What the unit is and what its frames carry, byte by byte."""
        return self._text

    def to_toml(self) -> str:
        """The description, to begin another one with."""
        return run("device", "show", self.name, "--toml")[0]

    def describe(self, what: str) -> str:
        """A generated file: ``dbc``, ``header``, ``dissector``, ``icd``, ``xtce`` or ``cosmos``."""
        return run("describe", what, "--device", self.name)[0]

    def __repr__(self) -> str:
        return f"<geu.Device {self.name}>"
