"""The unit in a Basilisk loop: examples/basilisk."""
import importlib.util
from pathlib import Path

import geu
import pytest

pytest.importorskip("Basilisk", reason="skipped: Basilisk is not installed: pip install bsk")
EXAMPLE = Path(__file__).resolve().parent.parent.parent / "examples/basilisk"


@pytest.fixture(scope="module")
def pointing():
    spec = importlib.util.spec_from_file_location("pointing", EXAMPLE / "pointing.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_drift_fault_turns_the_spacecraft_and_is_named(pointing, tmp_path):
    sound = pointing.simulate(3600)
    assert sound == pointing.simulate(3600), "the same numbers twice"
    drifting = pointing.simulate(3600, drift_arcsec_per_h=300, record=tmp_path / "run")
    assert drifting[:29] == sound[:29]
    # Half an hour at 300 arcsec/h.
    assert 100 < drifting[-1] - sound[-1] < 200
    diagnosis = geu.diagnose(tmp_path / "run/link.bin", tmp_path / "run/reference.csv", config=EXAMPLE / "unit.toml")
    assert diagnosis.verdict == "explained" and [(effect.code, effect.gyros) for effect in diagnosis.missing] == [("drift-step", ["GYRX"])]
    drift, onset = (diagnosis.missing[0].parameters[name] for name in ("arcsec_per_h", "time_s"))
    assert abs(drift.value - 300) < 4 * drift.sigma and abs(onset.value - 1800) < 4 * onset.sigma + 1

