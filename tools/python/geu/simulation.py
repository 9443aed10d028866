"""Recordings of a simulated unit."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Any

from ._run import Paths, StrPath, configuration_file, options, paths, run
from .configuration import Configuration
from .decoding import Samples, decode
from .errors import InputError


class Recording:
    """Files of a recorded run.

    Attributes
    ----------
    directory : pathlib.Path
        The directory; of a simulation without ``out`` it is removed with this object.
    link : str
        Path of the recorded link.
    reference : str
        Path of the reference attitude, for ``geu.calibrate`` and ``geu.diagnose``.
    truth : str
        Path of the true angles, the contribution of each effect and the counts.
    """

    def __init__(self, directory: StrPath, device: StrPath | None = None,
                 temporary: tempfile.TemporaryDirectory[str] | None = None) -> None:
        self.directory, self.device, self._temporary = Path(directory), device, temporary
        names = ("link.log", "link.bin", "link.log.gz", "link.bin.gz")
        link = next((self.directory / name for name in names if (self.directory / name).exists()), None)
        if link is None:
            raise InputError(f"{directory}: expected link.log or link.bin, as geu simulate writes", 2)
        self.link, self.reference = str(link), str(self.directory / "reference.csv")
        truth = next((name for name in ("truth.parquet", "truth.arrow") if (self.directory / name).exists()), "truth.csv")
        self.truth = str(self.directory / truth)
        self._samples: Samples | None = None

    @property
    def samples(self) -> Samples:
        """Samples: the decoded link; decoded once."""
        if self._samples is None:
            self._samples = decode(self.link, device=self.device)
        return self._samples

    def __fspath__(self) -> str:
        return self.link

    def __arrow_c_schema__(self) -> Any:
        return self.samples.__arrow_c_schema__()

    def __arrow_c_stream__(self, requested_schema: Any = None) -> Any:
        return self.samples.__arrow_c_stream__(requested_schema)

    def __len__(self) -> int:
        return len(self.samples)

    def __repr__(self) -> str:
        return f"<geu.Recording {self.directory}>"


def simulate(config: StrPath | Configuration | None = None, *, duration: float | str | None = None, seed: int | None = None,
             device: StrPath | None = None, start: float | None = None, truth: StrPath | None = None, faults: Paths | None = None,
             wire: str | None = None, set: dict[str, Any] | None = None, format: str | None = None, out: StrPath | None = None,
             force: bool = False) -> Recording:
    """Runs the model without links, as fast as possible.

    Parameters
    ----------
    config : path or Configuration, optional
        Configuration of the run; the reference unit on its default scenario without it.
    duration : float or str, optional
        On-board time to run: seconds, or ``"10m"``, ``"2h"``.
    seed : int, optional
        Seed of every random stream.
    device : str or path, optional
        Another unit than the default one.
    start : float, optional
        Unix time of the first sample interval's start.
    truth : path, optional
        Motion of the unit from a file, in place of the scenario.
    faults : path or list of paths, optional
        Plans of faults.
    wire : {"can", "serial"}, optional
        Link that is recorded.
    set : dict, optional
        Values of the configuration: ``{"gyro.GYRX.drift.arcsec_per_h": 10}``.
    format : {"csv", "parquet", "arrow"}, optional
        Format of the truth; CSV without it.
    out : path, optional
        New or empty directory to write into; a temporary one without it.
    force : bool
        Write into a directory with other files.

    Returns
    -------
    Recording
        Its samples are an Arrow table, as ``geu.decode`` returns.
    """
    temporary = None
    if out is None:
        temporary = tempfile.TemporaryDirectory(prefix="geu-")
        out = Path(temporary.name) / "recording"
    device = os.fspath(device) if device is not None else None
    given = options(duration=duration, seed=seed, device=device, start=start, truth=truth, faults=paths(faults) if faults else None,
                    wire=wire, set=set, format=format, out=out, force=force)
    with configuration_file(config) as path:
        run("simulate", *given, *([path] if path else []))
    return Recording(out, device, temporary)
