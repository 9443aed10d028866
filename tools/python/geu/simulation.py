"""Recordings of a simulated unit."""

import os
import tempfile
from pathlib import Path

from ._run import configuration_file, options, paths, run
from .decoding import decode


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
    """

    def __init__(self, directory, device=None, temporary=None):
        self.directory, self.device, self._temporary = Path(directory), device, temporary
        names = ("link.log", "link.bin", "link.log.gz", "link.bin.gz")
        link = next((self.directory / name for name in names if (self.directory / name).exists()), None)
        if link is None:
            raise FileNotFoundError(f"{directory}: expected link.log or link.bin, as geu simulate writes")
        self.link, self.reference = str(link), str(self.directory / "reference.csv")
        self._samples = None

    @property
    def samples(self):
        """Samples: the decoded link; decoded once."""
        if self._samples is None:
            self._samples = decode(self.link, device=self.device)
        return self._samples

    def __arrow_c_schema__(self):
        return self.samples.__arrow_c_schema__()

    def __arrow_c_stream__(self, requested_schema=None):
        return self.samples.__arrow_c_stream__(requested_schema)

    def __len__(self):
        return len(self.samples)

    def __repr__(self):
        return f"<geu.Recording {self.directory}>"


def simulate(config=None, *, duration=None, seed=None, device=None, start=None, truth=None, faults=None, wire=None, set=None, out=None,
             force=False):
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
    out : path, optional
        New or empty directory to write into; a temporary one without it.
    force : bool
        Write into a directory with other files.

    Returns
    -------
    Recording
        Its samples are an Arrow table, as those of ``geu.decode``.
    """
    temporary = None
    if out is None:
        temporary = tempfile.TemporaryDirectory(prefix="geu-")
        out = Path(temporary.name) / "recording"
    device = os.fspath(device) if device is not None else None
    given = options(duration=duration, seed=seed, device=device, start=start, truth=truth, faults=paths(faults) if faults else None,
                    wire=wire, set=set, out=out, force=force)
    with configuration_file(config) as path:
        run("simulate", *given, *([path] if path else []))
    return Recording(out, device, temporary)
