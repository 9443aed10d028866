"""Fixtures for tests of on-board software: `geu`, a running unit, and `geu_link`, the address of its link.

    @pytest.mark.geu(link="tcp", faults=PLAN)
    def test_driver(geu, geu_link):
        driver = Driver(geu_link)
        geu.inject("stuck-count", "GYRX", counts=120, for_s=3)
        ...

The marker takes the parameters of `geu.Emulator`; `faults` may be the text of a plan. The run is recorded; a failing test's report states
the recording, what its link carried, the faults and the verdicts on the expectations of the plan. A test also fails where
an expectation of its plan is not met.
"""

from __future__ import annotations

import itertools
import json
import xml.etree.ElementTree
from collections.abc import Generator
from pathlib import Path
from typing import Any

import pytest

from .emulator import Emulator
from .errors import GeuError

LINKS = ("pty", "tcp")
_FAILED = pytest.StashKey[bool]()


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("geu", "gyro electronics unit")
    group.addoption("--geu-link", choices=LINKS, default="pty", help="link of the fixture geu, if a marker names none [default: pty]")
    group.addoption("--geu-recordings", metavar="DIRECTORY", help="keep the recordings of all tests in this directory")


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "geu(link='pty'|'tcp', **parameters): the unit of the fixture geu, as geu.Emulator takes it")


@pytest.fixture
def geu(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Generator[Emulator]:
    """A running unit on a free pty or TCP port: `geu.Emulator`."""
    given: dict[str, Any] = {}
    for marker in reversed(list(request.node.iter_markers("geu"))):
        if marker.args:
            pytest.fail("marker geu: expected named parameters, such as link='tcp'", pytrace=False)
        given |= marker.kwargs
    link = given.pop("link", None) or request.config.getoption("--geu-link")
    if link not in LINKS:
        pytest.fail(f"marker geu: link: expected {' or '.join(LINKS)}, got {link}", pytrace=False)
    directory = _directory(request, tmp_path_factory)
    given.setdefault("record", directory / "recording")
    given.setdefault("junit", directory / "expectations.xml")
    faults = given.get("faults")
    if isinstance(faults, str) and "\n" in faults:
        given["faults"] = directory / "plan.toml"
        given["faults"].write_text(faults)
    if not {"pty", "tcp", "can", "serial"} & given.keys():
        given[link] = True
    try:
        unit = Emulator(**given).start()
    except GeuError as failure:
        pytest.fail(f"marker geu: {failure}", pytrace=False)
    with unit:
        yield unit
        code = unit.stop()
    if code != 0 and not request.node.stash.get(_FAILED, False):
        pytest.fail(f"{unit.log.strip().splitlines()[-1] if unit.log.strip() else f'geu: ended with {code}'}\n{_verdicts(unit)}", pytrace=False)


@pytest.fixture
def geu_link(geu: Emulator) -> str:
    """Address of the link of the unit: the path of a pty, or HOST:PORT."""
    return geu.link


def _directory(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    kept = request.config.getoption("--geu-recordings")
    name = "".join(letter if letter.isalnum() else "_" for letter in request.node.nodeid)[-100:]
    if kept is None:
        return tmp_path_factory.mktemp(name)
    for number in itertools.count(1):
        directory = Path(kept) / (name if number == 1 else f"{name}-{number}")
        try:
            directory.mkdir(parents=True)
            break
        except FileExistsError:
            continue
    return directory


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    unit = getattr(item, "funcargs", {}).get("geu")
    if report.when in ("setup", "call") and report.failed and isinstance(unit, Emulator):
        item.stash[_FAILED] = True
        unit.stop()
        report.sections.append(("geu", _section(unit)))
    return report


def _section(unit: Emulator) -> str:
    """What a failing test's report states of the unit."""
    recording = unit.recording
    lines = [f"link: {unit.links[0][0]} {unit.links[0][1]}", f"recording: {recording}"]
    faults = recording / "faults.jsonl" if recording else None
    if faults and faults.exists():
        events = [event for line in faults.read_text().splitlines() if (event := _event(line))]
        lines += ["faults:", *("  " + event for event in events[:50])]
    lines.append(_verdicts(unit))
    if unit.log.strip():
        lines += ["log:", *("  " + line for line in unit.log.strip().splitlines()[-20:])]
    if recording is None:
        return "\n".join(filter(None, lines))
    try:
        from .simulation import Recording
        summary = Recording(recording, unit.device).samples.summary.strip().splitlines()
        lines += ["link decoded:", *("  " + line for line in summary if line.split()[1:] != ["0"])]
    except (OSError, GeuError) as failure:
        lines.append(f"link decoded: {failure}")
    return "\n".join(filter(None, lines))


def _event(line: str) -> str:
    """What happened; empty for the bytes of each frame."""
    try:
        event = json.loads(line)
    except ValueError:
        return line
    plain = {key: value for key, value in event.items() if not isinstance(value, (dict, list))}
    return "" if event.get("what") == "bytes" else " ".join(f"{key}={value}" for key, value in plain.items())


def _verdicts(unit: Emulator) -> str:
    """The verdicts on the expectations of the plan."""
    try:
        cases = xml.etree.ElementTree.parse(unit.junit or "").iter("testcase")
    except (OSError, xml.etree.ElementTree.ParseError):
        return ""
    verdicts = []
    for case in cases:
        failure = next(iter(case), None)
        verdicts.append(f"  {case.get('name')}: " + ("met" if failure is None else failure.get("message") or "not met"))
    return "\n".join(["expectations:", *verdicts]) if verdicts else ""
