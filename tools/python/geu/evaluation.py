"""Calibration and diagnosis of recordings, as dataclasses."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from ._run import Paths, StrPath, configuration_file, options, paths, run, scratch
from .configuration import Configuration

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True)
class Estimate:
    """A number with its standard deviation; both are None if the data do not determine it."""

    value: float | None
    sigma: float | None

    @classmethod
    def of(cls, source: dict[str, Any] | None) -> Estimate:
        return cls(None, None) if source is None else cls(source["value"], source.get("sigma"))

    def __str__(self) -> str:
        if self.value is None:
            return "not determined"
        if not self.sigma:
            return f"{self.value:g}"
        digits = max(0, 1 - math.floor(math.log10(self.sigma)))
        return f"{self.value:.{digits}f} ± {self.sigma:.{digits}f}"


@dataclass(frozen=True)
class GyroCalibration:
    """Parameters of one gyro: scale factor, drift in arcsec per 0.5 s, misalignment in arcsec about two axes."""

    scale_factor: Estimate
    drift_arcsec_per_half_s: Estimate
    misalignment_arcsec: dict[str, Estimate]

    @classmethod
    def of(cls, source: dict[str, Any]) -> GyroCalibration:
        axes = {axis: Estimate.of(value) for axis, value in source["misalignment_arcsec"].items()}
        return cls(Estimate.of(source["scale_factor"]), Estimate.of(source["drift_arcsec_per_half_s"]), axes)


class _Result:
    json: dict[str, Any]
    text: str

    def to_dict(self) -> dict[str, Any]:
        """The JSON that the command writes, as a dict."""
        return self.json

    def __str__(self) -> str:
        return self.text


@dataclass(frozen=True)
class Calibration(_Result):
    """A calibration.

    Attributes
    ----------
    gyros : dict of str to GyroCalibration
    chi2, degrees_of_freedom, probability : float, int, float
        Goodness of the fit; the probability that noise alone gives so large a chi2.
    undetermined : list of str
        Parameters that the motion does not determine, of a described unit.
    text : str
        The table that the command prints.
    json : dict
        All results, covariance included.
    """

    gyros: dict[str, GyroCalibration]
    chi2: float
    degrees_of_freedom: int
    probability: float
    undetermined: list[str]
    text: str = field(repr=False)
    json: dict[str, Any] = field(repr=False)

    def plot(self, axes: Axes | None = None) -> Axes:
        """Plots residuals of the manoeuvres, in sigma; returns the matplotlib axes."""
        axes = axes or _axes()
        for place, gyro in enumerate(self.gyros):
            own = [(one["start_s"], one["residuals"][gyro]) for one in self.json["manoeuvres"] if gyro in one["residuals"]]
            sigmas = [residual["arcsec"] / residual["sigma_arcsec"] for _, residual in own]
            axes.plot([start_s for start_s, _ in own], sigmas, "o", label=gyro, color=f"C{place}")
        axes.set_xlabel("start of the manoeuvre (s)")
        axes.set_ylabel("residual (sigma)")
        axes.legend()
        return axes


@dataclass(frozen=True)
class Effect:
    """An effect that a diagnosis found.

    Attributes
    ----------
    code : str
        Its name in the catalogue, or ``discovered``.
    kind : str
        ``missing-effect`` or ``recalibration``.
    gyros : list of str
    parameters : dict of str to Estimate
    gap_share : float or None
        Its share of the fall of the residual.
    alternatives : list of dict
        Other effects that the recording may not exclude, with their cosines.
    """

    code: str
    kind: str
    gyros: list[str]
    parameters: dict[str, Estimate]
    gap_share: float | None
    alternatives: list[dict[str, Any]]

    @classmethod
    def of(cls, source: dict[str, Any]) -> Effect:
        parameters = {name: Estimate.of(value) for name, value in source["parameters"].items()}
        return cls(source["code"], source["class"], source["gyros"], parameters, source.get("gap_share"), source.get("rivals", []))

    def __str__(self) -> str:
        values = ", ".join(f"{name} {value}" for name, value in self.parameters.items())
        return f"{self.code} {' '.join(self.gyros)}: {values}"


@dataclass(frozen=True)
class Finding:
    """A result of an exact check: of the link, the clocks, the wiring."""

    kind: str
    place: str
    text: str


@dataclass(frozen=True)
class Diagnosis(_Result):
    """A diagnosis.

    Attributes
    ----------
    verdict : {"consistent", "explained", "unexplained"}
    effects : list of Effect
        All of them, recalibrations included; ``missing`` are the ones that the model lacks.
    findings : list of Finding
    gap : dict
        Residual before and after, of the fitted and of the held-out parts.
    unexplained : dict or None
        What is left, if anything.
    text : str
        The report that the command prints.
    json : dict
        All results.
    """

    verdict: str
    effects: list[Effect]
    findings: list[Finding]
    gap: dict[str, Any]
    unexplained: dict[str, Any] | None
    text: str = field(repr=False)
    json: dict[str, Any] = field(repr=False)

    @property
    def missing(self) -> list[Effect]:
        """list of Effect: effects that the model lacks."""
        return [effect for effect in self.effects if effect.kind == "missing-effect"]

    def plot(self, axes: Axes | None = None) -> Axes:
        """Plots the residual before and after, fitted and held out; returns the matplotlib axes."""
        axes = axes or _axes()
        parts = [(when, part) for part in ("fitted", "held_out") for when in ("before", "after")]
        values = [self.gap[when][part]["rms_arcsec"] for when, part in parts]
        axes.bar([f"{part.replace('_', ' ')}\n{when}" for when, part in parts], values, color=["C3", "C2", "C3", "C2"])
        axes.set_yscale("log")
        axes.set_ylabel("residual, rms (arcsec)")
        axes.set_title(f"{self.verdict}: " + ("; ".join(effect.code for effect in self.missing) or "no missing effect"))
        return axes


def _axes() -> Axes:
    import matplotlib.pyplot as plot
    return plot.subplots(layout="constrained")[1]


def _evaluated(command: str, config: StrPath | Configuration | None, link: Paths, accepted: Sequence[int],
               given: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    if isinstance(given.get("device"), os.PathLike):
        given["device"] = os.fspath(given["device"])
    with scratch() as directory, configuration_file(config) as path:
        result = directory / "result.json"
        arguments = options(config=path, link=paths(link), json=result, **given)
        text = run(command, *arguments, accepted=accepted)[0]
        return text, json.loads(result.read_text())


def calibrate(link: Paths, reference: StrPath | None = None, *, config: StrPath | Configuration | None = None,
              device: StrPath | None = None, reference_sigma: float | None = None, fss: StrPath | None = None, sse: StrPath | None = None,
              manoeuvres: StrPath | None = None, start: float | None = None, base: str | None = None, set: dict[str, Any] | None = None,
              out: StrPath | None = None, html: StrPath | None = None) -> Calibration:
    """Solves the in-orbit calibration parameters.

    Parameters
    ----------
    link : path or list of paths
        Recording of the link; several are one stream.
    reference : path, optional
        Reference attitude: reference.csv, a CCSDS attitude ephemeris or a table; or ``fss`` and ``sse``.
    config : path or Configuration, optional
        Prior configuration.
    device : str or path, optional
        Unit of the recording.
    reference_sigma : float, optional
        Noise of the reference about each axis, arcsec; estimated without it.
    fss, sse : path, optional
        Histories of the sun sensor and fixes of the star sensor.
    manoeuvres : path, optional
        Manoeuvres; cut where the motion changes without it.
    start : float, optional
        Unix time at which the unit's clock was 0.
    base : str, optional
        Base of the CAN identifiers, hexadecimal.
    set : dict, optional
        Values of the configuration.
    out, html : path, optional
        Files to write: the configuration with the solved values, a page with plots.

    Returns
    -------
    Calibration

    Raises
    ------
    InputError
        An input cannot be read, or the motion does not determine the parameters.
    """
    given = dict(device=device, reference=reference, reference_sigma=reference_sigma, fss=fss, sse=sse, manoeuvres=manoeuvres, start=start,
                 base=base, set=set, out=out, html=html)
    text, result = _evaluated("calibrate", config, link, (0,), given)
    gyros = {name: GyroCalibration.of(gyro) for name, gyro in result["gyros"].items()}
    chi2 = result["chi2"]
    return Calibration(gyros, chi2["value"], chi2["dof"], chi2["probability"], result.get("undetermined", []), text, result)


def diagnose(link: Paths, reference: StrPath, *, config: StrPath | Configuration | None = None, device: StrPath | None = None,
             manoeuvres: StrPath | None = None, start: float | None = None, base: str | None = None, seed: int | None = None,
             set: dict[str, Any] | None = None, out: StrPath | None = None, html: StrPath | None = None,
             next_manoeuvre: StrPath | None = None, no_cache: bool = False) -> Diagnosis:
    """Finds the effect that is missing in the model.

    Parameters
    ----------
    link : path or list of paths
        Recording of the link; several are one stream.
    reference : path
        Reference attitude: reference.csv, a CCSDS attitude ephemeris or a table.
    config : path or Configuration, optional
        The model: a configuration; the reference unit without it.
    device : str or path, optional
        Unit of the recording.
    manoeuvres : path, optional
        Manoeuvres; cut where the motion changes without it.
    start : float, optional
        Unix time at which the unit's clock was 0.
    base : str, optional
        Base of the CAN identifiers, hexadecimal.
    seed : int, optional
        Seed of the effect-free recordings that set the thresholds.
    set : dict, optional
        Values of the configuration.
    out, html, next_manoeuvre : path, optional
        Files to write: the configuration with the found effects, a page with plots, a scenario that separates alternatives.
    no_cache : bool
        Compute the thresholds again.

    Returns
    -------
    Diagnosis
        Also of a recording that stays unexplained.

    Raises
    ------
    InputError
        An input cannot be read.
    """
    given = dict(device=device, reference=reference, manoeuvres=manoeuvres, start=start, base=base, seed=seed, set=set, out=out, html=html,
                 next_manoeuvre=next_manoeuvre, no_cache=no_cache)
    text, result = _evaluated("diagnose", config, link, (0, 3), given)
    effects = [Effect.of(effect) for effect in result["effects"]]
    findings = [Finding(one["kind"], one["place"], one["text"]) for one in result["findings"]]
    return Diagnosis(result["verdict"], effects, findings, result["gap"], result["unexplained"], text, result)
