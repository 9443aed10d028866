"""The Python package against the command."""
import csv
import io
import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import geu
import pytest

ROOT = Path(__file__).resolve().parent.parent.parent
COMMAND = [sys.executable, "-m", "geu"]
# The program that cargo built, which starts faster than that of the wheel.
PROGRAM = [os.environ["GEU"]] if "GEU" in os.environ else COMMAND


@pytest.fixture(scope="module")
def recording():
    return geu.simulate(duration="1h", seed=4, faults=[], start=1.7e9)


def rows_of_command(*arguments):
    text = subprocess.run([*COMMAND, "decode", *arguments, "--quiet", "--flags", "bits"], check=True, capture_output=True, text=True).stdout
    return list(csv.DictReader(io.StringIO(text)))


def test_the_first_page_runs_as_it_stands(tmp_path):
    page = (ROOT / "tools/python/README.md").read_text()
    program = "\n".join(re.findall(r"```python\n(.*?)```", page, re.S))
    assert program.count("geu.") > 10
    done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert re.search(r"^explained\ndrift-step \['GYRX'\] 1[3-9]", done.stdout, re.M), done.stdout


def test_the_page_on_scripts_runs_as_it_stands(tmp_path):
    page = (ROOT / "docs/tasks/script.md").read_text()
    program = "\n".join(re.findall(r"```python\n(.*?)```", page, re.S))
    done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("explained\n") and "gyrx_valid" in done.stdout, done.stdout


def test_columns_are_those_of_the_command(recording):
    frame = recording.samples.to_polars()
    rows = rows_of_command(recording.link)
    assert len(rows) == len(frame) == 7200
    assert set(frame.columns) - set(rows[0]) == {"time", "time_rest_ns", "t_s_decimals", "is_received"} and set(rows[0]) < set(frame.columns)
    for name in rows[0]:
        assert [float(row[name]) for row in rows] == frame[name].cast(float).to_list(), name
    assert frame["time"].dt.epoch("us").to_list() == [round(float(row["t_s"]) * 1e6) for row in rows]


@pytest.mark.parametrize("device", ["stim300", "mm5.10", "tetrad"])
def test_columns_of_described_units_are_those_of_the_command(device):
    simulated = geu.simulate(device=device, duration=2, seed=1)
    frame = simulated.samples.to_polars()
    rows = list(csv.DictReader(io.StringIO(subprocess.run(
        [*COMMAND, "decode", simulated.link, "--device", device, "--quiet"], check=True, capture_output=True, text=True).stdout)))
    assert len(rows) == len(frame) > 10
    for name in rows[0]:
        assert [float(row[name]) if row[name] else None for row in rows] == frame[name].cast(float).to_list(), name


def test_the_truth_of_a_simulation_as_columns(tmp_path):
    import polars
    recording = geu.simulate(duration=10, format="parquet", out=tmp_path / "run")
    truth = polars.read_parquet(recording.truth)
    samples = recording.samples.to_polars()
    assert truth.filter(polars.col("gyro") == "GYRX")["count"].to_list() == samples["gyrx"].to_list()
    assert geu.simulate(duration=1).truth.endswith("truth.csv")


def test_every_engine_reads_the_stream(recording):
    import duckdb
    import pandas
    import polars
    import pyarrow
    samples = recording.samples
    total = sum(int(row["gyrza"]) for row in rows_of_command(recording.link))
    assert pyarrow.table(samples)["gyrza"].to_numpy().sum() == total
    assert polars.DataFrame(samples)["gyrza"].sum() == total
    assert isinstance(samples.to_pandas(), pandas.DataFrame) and samples.to_pandas()["gyrza"].sum() == total
    assert duckdb.sql("SELECT sum(gyrza) FROM samples").fetchall() == [(total,)]
    # Twice: a consumer does not use the table up.
    assert pyarrow.table(samples).equals(pyarrow.table(samples))
    schema = pyarrow.table(samples).schema
    assert schema.metadata[b"geu.device"] == b"iras" and schema.field("gyrx").metadata == {b"unit": b"count"}


def test_defects_and_broken_inputs_are_listed(recording, tmp_path):
    lines = Path(recording.link).read_text().splitlines(keepends=True)
    broken = tmp_path / "broken.log"
    broken.write_text("".join([*lines[:4], lines[4][:-3] + "FF\n", *lines[5:9], "(nonsense\n", *lines[9:30]]))
    samples = geu.decode(broken)
    assert 6 <= len(samples) <= 9
    assert {"place", "kind"} <= samples.defects[0].keys()
    with pytest.raises(geu.GeuError, match="defects"):
        geu.decode(broken, strict=True)


def test_errors_have_their_parts(tmp_path):
    wrong = tmp_path / "wrong.toml"
    wrong.write_text("seed = 1\n\n[unit]\nclock-frequency = { ppm = 1e9 }\n")
    with pytest.raises(geu.InputError) as caught:
        geu.simulate(wrong, duration=10)
    error = caught.value
    assert (error.file, error.line, error.code) == (str(wrong), 4, 2)
    assert "1000" in error.expected and error.got
    with pytest.raises(geu.InputError, match="--baud"):
        geu.decode("x", baud="many")
    with pytest.raises(geu.InputError, match="no such file"):
        geu.decode(tmp_path / "absent.log")
    with pytest.raises(geu.InputError, match="did you mean"):
        geu.Device("stim30")
    with pytest.raises(geu.InputError, match="not a mode"):
        geu.decode("not a mode")
    with pytest.raises(geu.InputError, match="serial link"):
        geu.Decoder("mm5.10")
    with pytest.raises(geu.InputError, match="cannot be read"):
        geu.Configuration(tmp_path / "absent.toml")
    with pytest.raises(geu.InputError, match="link.log"):
        geu.Recording(tmp_path)
    with pytest.raises(geu.InputError):
        geu.Emulator(pty=tmp_path / "no" / "such" / "directory").start()


def test_simulation_and_configuration_are_those_of_the_command(tmp_path):
    configuration = geu.Configuration().set({"gyro.GYRY.drift.arcsec_per_h": 25}, seed=9)
    recording = geu.simulate(configuration, duration=60, out=tmp_path / "own")
    text = tmp_path / "configuration.toml"
    text.write_text(configuration.to_toml())
    subprocess.run([*COMMAND, "simulate", text, "--duration", "60", "--out", tmp_path / "command"], check=True, capture_output=True)
    assert Path(recording.link).read_bytes() == (tmp_path / "command/link.log").read_bytes()
    with pytest.raises(geu.InputError, match="force"):
        geu.simulate(duration=60, out=tmp_path / "own")


def test_results_are_those_of_the_command(tmp_path):
    recording = geu.simulate(duration="4h", seed=2, set={"gyro.GYRZA.scale-factor.ppm": 300}, out=tmp_path / "recording")
    calibration = geu.calibrate(recording.link, recording.reference)
    done = subprocess.run([*COMMAND, "calibrate", "--link", recording.link, "--reference", recording.reference, "--json", tmp_path / "json"],
                          check=True, capture_output=True, text=True)
    assert calibration.to_dict() == json.loads((tmp_path / "json").read_text()) and str(calibration) == done.stdout
    scale = calibration.gyros["GYRZA"].scale_factor
    assert scale.sigma > 0 and calibration.degrees_of_freedom > 0
    diagnosis = geu.diagnose(recording.link, recording.reference)
    subprocess.run([*COMMAND, "diagnose", "--link", recording.link, "--reference", recording.reference, "--json", tmp_path / "diagnosis"],
                   check=True, capture_output=True)
    assert diagnosis.to_dict() == json.loads((tmp_path / "diagnosis").read_text())
    import matplotlib
    matplotlib.use("agg")
    assert diagnosis.plot().get_title().startswith(diagnosis.verdict)
    assert len(calibration.plot().lines) == 4


def test_an_emulator_runs_and_ends(tmp_path):
    with geu.Emulator(speed=10, seed=3, record=tmp_path / "run") as unit:
        kind, path = unit.links[0]
        assert kind == "pty" and Path(path).exists()
        assert unit.inject("stuck-count", "GYRX", counts=77) in {fault["id"] for fault in unit.faults()}
        samples = geu.decode(unit.link, duration=2)
        assert samples.to_polars()["gyrx"].to_list()[-1] == 77
        assert unit.command("PING")["values"] == {"major": 1, "minor": 0}
        name, event = next(unit.events())
        assert name and event
        unit.clear()
        until = time.monotonic() + 5
        while any(fault["state"] == "active" for fault in unit.faults()):
            assert time.monotonic() < until
        with pytest.raises(geu.InputError, match="did you mean"):
            unit.inject("stuck-coun", "GYRX")
        ids = unit.inject_plan('[[fault]]\nid = "one"\nat_s = 1e6\ngyro = "GYRX"\nfault = "dead"\n')
        assert ids == ["one"]
    assert not unit.is_running and not Path(path).exists()
    with pytest.raises(geu.GeuError, match="before"):
        unit.start()
    recorded = geu.Recording(tmp_path / "run")
    assert len(recorded) > 10


def test_bytes_decode_as_they_arrive():
    recording = geu.simulate(duration=20, wire="serial")
    data = Path(recording.link).read_bytes()
    decoder, rows = geu.Decoder(), []
    for place in range(0, len(data), 7):
        rows += decoder.feed(data[place:place + 7])
    frame = recording.samples.to_polars()
    assert decoder.defects == 0 and len(rows) == len(frame) == 40
    for name in ("sequence", "gyrx", "gyrzb_valid", "sensor_c", "t_s"):
        assert [row[name] for row in rows] == frame[name].to_list(), name
    unit = geu.simulate(device="stim300", duration=0.01)
    assert len(geu.Decoder("stim300").feed(Path(unit.link).read_bytes())) == 20


def test_any_command_runs():
    assert "pivot-clearance" in geu.command("faults", "list")
    assert "GYRX" in geu.command("describe", "header")
    with pytest.raises(geu.InputError, match="unrecognized"):
        geu.command("checkoud")


def test_ctrl_c_ends_a_silent_link():
    master, slave = os.openpty()
    threading.Timer(1.0, signal.raise_signal, [signal.SIGINT]).start()
    started = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        geu.decode(os.ttyname(slave))
    assert time.monotonic() - started < 5
    os.close(master)
    os.close(slave)


@pytest.mark.parametrize("program", [
    "unit = geu.Emulator(tcp=True, record=sys.argv[1]).start(); print(0, flush=True); time.sleep(60)",
    "print(0, flush=True); geu.simulate(duration='300d', out=sys.argv[1])",
])
def test_no_process_outlives_python(program, tmp_path):
    parent = subprocess.Popen([sys.executable, "-c", f"import geu, sys, time; {program}", tmp_path / "out"], stdout=subprocess.PIPE, text=True)
    parent.stdout.readline()
    time.sleep(1)
    marks = {f"--out={tmp_path / 'out'}", f"--record={tmp_path / 'out'}"}

    def running():
        found = []
        for entry in Path("/proc").glob("[0-9]*/cmdline"):
            try:
                words = entry.read_text(errors="replace").split("\0")
            except OSError:
                continue
            if marks & set(words):
                found.append(int(entry.parent.name))
        return found

    before = running()
    assert before
    parent.kill()
    parent.wait()
    until = time.monotonic() + 10
    while set(running()) & set(before):
        assert time.monotonic() < until, "the command runs on"
        time.sleep(0.1)


def test_ctrl_c_ends_a_live_decoding():
    with geu.Emulator(tcp=True) as unit:
        threading.Timer(1.0, signal.raise_signal, [signal.SIGINT]).start()
        started = time.monotonic()
        with pytest.raises(KeyboardInterrupt):
            geu.decode(unit.link)
        assert time.monotonic() - started < 5


def test_other_threads_run_while_python_decodes():
    recording = geu.simulate(duration="10d", seed=1)
    ticks, done = [], threading.Event()

    def tick():
        while not done.wait(0.005):
            ticks.append(time.monotonic())

    thread = threading.Thread(target=tick)
    thread.start()
    for _ in range(3):
        geu.decode(recording.link)
    done.set()
    thread.join()
    assert len(ticks) > 20 and max(after - before for before, after in zip(ticks, ticks[1:])) < 0.5


def test_a_million_lines_decode_as_fast_as_the_command(tmp_path):
    import polars
    recording = geu.simulate(duration=166_667, seed=1, out=tmp_path / "recording")
    assert sum(1 for _ in open(recording.link, "rb")) > 1_000_000

    def seconds(work):
        start = time.perf_counter()
        work()
        return time.perf_counter() - start

    def decode():
        return polars.DataFrame(geu.decode(recording.link))

    def command():
        subprocess.run([*PROGRAM, "decode", recording.link, "--format", "summary"], check=True, capture_output=True)

    # Alternately, so that a load of the machine meets both; a longer load is given time to end.
    for _ in range(8):
        times = [(seconds(decode), seconds(command)) for _ in range(7)]
        own, without_rows = (min(column) for column in zip(*times))
        print(f"\ndecode to Polars: {own:.3f} s, the command without rows {without_rows:.3f} s, ratio {own / without_rows:.2f}")
        if own < 1.3 * without_rows:
            break
    else:
        pytest.fail(f"ratio {own / without_rows:.2f}")


OWN_TESTS = """
import time

import pytest

PLAN = '''
[[fault]]
id = "stuck"
at_s = 1.0
gyro = "GYRX"
fault = "stuck-rate"

[[expect]]
id = "answers"
after = "stuck"
condition = "command(PING)"
within_s = 2.0
'''

@pytest.mark.geu(faults=PLAN, speed=10)
def test_met(geu):
    for _ in range(20):
        geu.command("PING")
        time.sleep(0.05)

@pytest.mark.geu(faults=PLAN, speed=10)
def test_not_met(geu):
    time.sleep(1)

@pytest.mark.geu(link="cnn")
def test_wrong_link(geu):
    pass
"""


def pytest_of(directory, *arguments):
    return subprocess.run([sys.executable, "-m", "pytest", "-q", *arguments], cwd=directory, capture_output=True, text=True).stdout


def test_expectations_of_a_plan_decide(tmp_path):
    (tmp_path / "test_own.py").write_text(OWN_TESTS)
    text = pytest_of(tmp_path)
    assert "FAILED test_own.py::test_not_met" not in text and "ERROR test_own.py::test_not_met" in text, text
    assert "answers" in text
    assert "ERROR test_own.py::test_wrong_link" in text and "link: expected pty or tcp, got cnn" in text
    assert "2 passed, 2 errors" in text and "INTERNALERROR" not in text
    # Twice into one directory, with tests of one name in two files.
    (tmp_path / "test_other.py").write_text("def test_same(geu): pass\n")
    (tmp_path / "test_third.py").write_text("def test_same(geu): pass\n")
    for _ in range(2):
        text = pytest_of(tmp_path, "test_other.py", "test_third.py", f"--geu-recordings={tmp_path / 'kept'}")
        assert "2 passed" in text, text
    assert len(list((tmp_path / "kept").iterdir())) == 4


@pytest.mark.parametrize("bug, found", [
    ("sound", None),
    ("wrong-sign", "test_a_known_angle_has_its_sign_and_size[GYRY-1]"),
    ("no-crc-check", "test_corrupted_frames_are_rejected"),
    ("sequence-ignored", "test_lost_frames_are_noticed"),
])
def test_the_example_finds_each_planted_bug(bug, found):
    text = pytest_of(ROOT / "examples/gyro_driver", "--driver", bug, "-p", "no:cacheprovider")
    failed = re.findall(r"^FAILED test_gyro_driver.py::(\S+)", text, re.M)
    assert failed == ([found] if found else []), text
    if found:
        assert "recording: " in text and "what=injected" in text
