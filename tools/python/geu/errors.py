"""Errors, with their parts as attributes."""

from __future__ import annotations

import re

# As the command states them: `FILE:LINE:COLUMN: field: expected …, got …; hint`. Each part may be absent.
_PLACE = re.compile(r"^(?P<file>[^:\n]+?(?P<suffix>\.[A-Za-z]\w*)?)(?::(?P<line>\d+))?(?::\d+)?: ")
_OPTION = re.compile(r"for '(?P<file>--[\w-]+)")
_EXPECTED = re.compile(r"\bexpected (?P<expected>.+?)(?:, got (?P<got>[^;\n]+))?(?:;|\n|$)")


class GeuError(Exception):
    """A command failed: an output cannot be written, a link is broken, an expectation is not met.

    Attributes
    ----------
    message : str
        The whole message.
    code : int
        Exit code of the command: 1 failed, 2 bad usage or bad input.
    file : str or None
        File, option or link that it is about.
    line : int or None
        Line in the file.
    expected, got : str or None
        What was expected there, and what was found.
    """

    def __init__(self, message: str, code: int = 1) -> None:
        super().__init__(message)
        self.message, self.code = message, code
        place, content = _PLACE.match(message), _EXPECTED.search(message)
        option = _OPTION.search(message.split("\n")[0])
        self.file: str | None = option["file"] if option else place["file"] if place else None
        # Behind an address stands a port.
        has_line = place is not None and not option and place["suffix"] and place["line"]
        self.line: int | None = int(place["line"]) if place and has_line else None
        self.expected: str | None = content["expected"].strip() if content else None
        self.got: str | None = content["got"].strip() if content and content["got"] else None


class InputError(GeuError, ValueError):
    """An option, a configuration or an input is wrong."""


def error(message: str, code: int) -> GeuError:
    """The exception of a message and an exit code."""
    return (InputError if code == 2 else GeuError)(message, code)
