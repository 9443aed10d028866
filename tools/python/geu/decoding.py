"""Recordings and live links as Arrow tables."""

from __future__ import annotations

import json
import os
from typing import TYPE_CHECKING, Any

from . import _geu
from ._run import Paths, StrPath, options, paths

if TYPE_CHECKING:
    import pandas
    import polars
    import pyarrow


class Samples:
    """Decoded samples of a unit: an Arrow table in memory.

    Pandas, Polars, DuckDB and pyarrow read it by ``__arrow_c_stream__`` without a copy: ``polars.DataFrame(samples)``,
    ``pyarrow.table(samples)``, ``duckdb.sql("SELECT count(*) FROM samples")``.

    Attributes
    ----------
    columns : list of str
        Names of the columns, as ``geu decode`` writes them; each flag is a column.
    units : dict of str to str
        Units by column, unless the name of the column states them.
    metadata : dict of str to str
        ``geu.device`` the unit, ``geu.description`` its description, ``geu.version``.
    summary : str
        What was read, decoded and lost, in words.
    broken : str or None
        Why the samples end before the input does: a broken container, a link that failed, or ended before
        ``duration``. Without it, a link that its other end closes ends regularly.
    """

    def __init__(self, table: _geu.Table) -> None:
        self._table = table
        self.columns: list[str] = [name for name, _ in table.columns]
        self.units: dict[str, str] = {name: unit for name, unit in table.columns if unit}
        self.metadata, self.summary, self.broken = table.metadata, table.summary, table.broken

    @property
    def defects(self) -> list[dict[str, Any]]:
        """list of dict: place, kind and bytes of each defect; count for repetitions."""
        return [json.loads(line) for line in self._table.defects.splitlines()]

    def __len__(self) -> int:
        return self._table.rows

    def __repr__(self) -> str:
        return f"<geu.Samples of {self.metadata['geu.device']}: {len(self)} rows, {', '.join(self.columns)}>"

    def __arrow_c_schema__(self) -> Any:
        return self._table.__arrow_c_schema__()

    def __arrow_c_stream__(self, requested_schema: Any = None) -> Any:
        return self._table.__arrow_c_stream__(requested_schema)

    def to_arrow(self) -> pyarrow.Table:
        """The samples as ``pyarrow.Table``."""
        import pyarrow
        return pyarrow.table(self)

    def to_pandas(self) -> pandas.DataFrame:
        """The samples as ``pandas.DataFrame``; needs pyarrow."""
        return self.to_arrow().to_pandas()

    def to_polars(self) -> polars.DataFrame:
        """The samples as ``polars.DataFrame``."""
        import polars
        return polars.DataFrame(self)


def decode(inputs: Paths, *, device: StrPath | None = None, base: str | None = None, interface: str | None = None,
           input_format: str | None = None, baud: int | None = None, duration: float | str | None = None,
           strict: bool = False) -> Samples:
    """Decodes recordings or live links.

    Parameters
    ----------
    inputs : path or list of paths
        Recordings, serial devices, ptys, CAN interfaces or ``HOST:PORT``; several are one stream, in order.
    device : str or path, optional
        Name or description of another unit than the default one (``geu.devices()``).
    base : str, optional
        Base of the unit's CAN identifiers, hexadecimal.
    interface : str, optional
        Interface of the unit, if a capture has several.
    input_format : str, optional
        Format of the inputs, if it is not to be found from their content.
    baud : int, optional
        Rate of a serial device.
    duration : float or str, optional
        Time of a live input: seconds, or ``"10m"``; ``broken`` says if it ended before. A live input without it ends with Ctrl-C, and yields no table.
    strict : bool
        Defects are an error; so is an input without a sample.

    Returns
    -------
    Samples

    Raises
    ------
    InputError
        An input or option is wrong; the message states the place, what was expected, and what to do.
    """
    if isinstance(device, os.PathLike):
        device = os.fspath(device)
    given = options(device=device, base=base, interface=interface, input_format=input_format, baud=baud, duration=duration, strict=strict)
    return Samples(_geu.decode([*given, "--", *paths(inputs)]))
