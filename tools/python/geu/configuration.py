"""Configurations of a unit."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from ._run import StrPath, configuration_file, options, run
from .errors import InputError


class Configuration:
    """A configuration: the text of a TOML file that the command accepts.

    Parameters
    ----------
    source : path or str, optional
        A file, or the text itself if it contains a line end or ``=``; the reference unit without it.
    device : str or path, optional
        Another unit than the default one.

    Raises
    ------
    InputError
        It is not valid: file, line, what was expected.
    """

    def __init__(self, source: StrPath | None = None, *, device: StrPath | None = None) -> None:
        self.device = os.fspath(device) if device is not None else None
        if source is None:
            self.text = run("config", "show", *options(device=self.device))[0]
        elif isinstance(source, str) and ("\n" in source or "=" in source):
            self.text = source
        else:
            try:
                self.text = Path(source).read_text(encoding="utf-8")
            except (OSError, UnicodeError) as failure:
                raise InputError(f"{source}: cannot be read: {failure}; expected a configuration, TOML", 2) from None
        self._shown()

    def _shown(self, **values: Any) -> str:
        with configuration_file(self) as path:
            return run("config", "show", *options(device=self.device, **values), *([path] if path else []))[0]

    def set(self, values: dict[str, Any] | None = None, **named: Any) -> Configuration:
        """A configuration with other values.

        Parameters
        ----------
        values : dict
            Paths and values: ``{"gyro.GYRX.drift.arcsec_per_h": 10}``.
        **named
            Values at the top: ``seed=3``.
        """
        changed = object.__new__(Configuration)
        changed.device = self.device
        changed.text = self._shown(set={**(values or {}), **named})
        return changed

    def show(self) -> str:
        """The complete configuration with comments."""
        return self._shown()

    def to_toml(self) -> str:
        """The text as it was given, or with the values that were set."""
        return self.text

    def __repr__(self) -> str:
        return f"<geu.Configuration of {len(self.text.splitlines())} lines>"
