"""Runs the command in a process of its own."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .errors import GeuError, error

if TYPE_CHECKING:
    from .configuration import Configuration

StrPath = str | os.PathLike[str]
Paths = StrPath | Sequence[StrPath]

# Set for a command that ends when its standard input does.
ENDS_WITH_INPUT = "GEU_ENDS_WITH_INPUT"
COMMAND = [sys.executable, "-m", "geu"]


def environment() -> dict[str, str]:
    """The environment of a command, which finds this package wherever Python was started."""
    path = [str(Path(__file__).resolve().parent.parent), os.environ.get("PYTHONPATH", "")]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, path)), "PYTHONDONTWRITEBYTECODE": "1"}


def options(**values: Any) -> list[str]:
    """Options of the command: `reference_sigma=3` is `--reference-sigma=3`, True an option without a value; None and False are left out."""
    arguments = []
    for name, value in values.items():
        name = "--" + name.replace("_", "-")
        if value is None or value is False:
            continue
        if value is True:
            arguments.append(name)
        elif isinstance(value, dict):
            arguments += [f"{name}={path}={toml(item)}" for path, item in value.items()]
        elif isinstance(value, (list, tuple)):
            arguments += [f"{name}={os.fspath(item) if isinstance(item, os.PathLike) else item}" for item in value]
        else:
            arguments.append(f"{name}={os.fspath(value) if isinstance(value, os.PathLike) else value}")
    return arguments


def toml(value: Any, quoted: bool = False) -> str:
    """A value as `--set` takes it: TOML, with texts unquoted."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {toml(item, True)}" for key, item in value.items()) + " }"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(toml(item, True) for item in value) + "]"
    return json.dumps(value, ensure_ascii=False) if quoted and isinstance(value, str) else str(value)


def paths(value: Paths) -> list[str]:
    """One path or several as a list of texts."""
    several = [value] if isinstance(value, (str, os.PathLike)) else value
    return [os.fspath(item) for item in several]


def run(*arguments: str, accepted: Sequence[int] = (0,)) -> tuple[str, int, str]:
    """Runs the command; returns its standard output, its exit code and its standard error.

    Raises
    ------
    GeuError
        Another exit code than these.
    """
    # The command ends when this process does, and with it the pipe.
    reads, writes = os.pipe()
    try:
        done = subprocess.run([*COMMAND, *arguments], capture_output=True, text=True, encoding="utf-8", errors="replace",
                              env={**environment(), ENDS_WITH_INPUT: "1"}, stdin=reads)
    finally:
        os.close(reads)
        os.close(writes)
    if done.returncode not in accepted:
        raise error(message(done.stderr), done.returncode)
    return done.stdout, done.returncode, done.stderr


def command(name: str, *arguments: StrPath, accepted: Sequence[int] = (0,), **values: Any) -> str:
    """Runs any other command of geu: ``geu.command("checkout", runs=3)``.

    Parameters
    ----------
    name : str
        The command, ``"track"``; of a nested one the first word, ``command("blind", "score", key="key.json")``.
    *arguments : str or path
        Arguments as they stand.
    accepted : sequence of int
        Exit codes that are no failure.
    **values
        Options: ``set={"seed": 3}``, ``verbose=True``.

    Returns
    -------
    str
        Standard output.

    Raises
    ------
    GeuError
        Another exit code than these.
    """
    words = [os.fspath(argument) for argument in arguments]
    return run(name, *words, *options(**values), accepted=accepted)[0]


def message(standard_error: str) -> str:
    """The message of a failed command; notes before it are left out."""
    lines = standard_error.strip().splitlines()
    starts = [index for index, line in enumerate(lines) if line.startswith(("geu: ", "error: "))]
    text = "\n".join(lines[starts[-1]:]) if starts else standard_error.strip()
    return text.removeprefix("geu: ").removeprefix("error: ").split("\n\nUsage:")[0].split("\n\nFor more information")[0].strip()


@contextlib.contextmanager
def scratch() -> Iterator[Path]:
    """A directory that is removed afterwards."""
    with tempfile.TemporaryDirectory(prefix="geu-") as directory:
        yield Path(directory)


@contextlib.contextmanager
def configuration_file(configuration: StrPath | Configuration | None) -> Iterator[str | None]:
    """The path of a configuration: of a file as it is, of a `Configuration` its text in a file; None stays None."""
    if configuration is None or isinstance(configuration, (str, os.PathLike)):
        yield None if configuration is None else os.fspath(configuration)
        return
    with scratch() as directory:
        path = directory / "configuration.toml"
        path.write_text(configuration.text, encoding="utf-8")
        try:
            yield str(path)
        except GeuError as failure:
            raise error(failure.message.replace(str(path), "configuration"), failure.code) from None
