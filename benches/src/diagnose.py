"""Selects regressors that explain a residual: TOOL (statsmodels or pysindy) and the residual as CSV.

Each gyro's residual is modelled by calibration terms (an offset, a drift and the three rates) and a few other terms: the
regressors, their products and the cubes of the rates, integrated per sample as the gyros do. Both tools use the extended BIC,
which counts the candidates; plain BIC selects fifteen terms without any injected effect. Prints a term a line: gyro, term,
coefficient.
"""
import itertools
import sys
import warnings

import numpy as np
import pandas as pd

SAMPLE_INTERVAL_S = 0.5
BLOCK = 10
MINUTE = 12
MAX_TERMS = 8
AUTOREGRESSION = 4


def library(table):
    """Each term integrated and averaged over blocks of 5 s: calibrations, then the candidates by name."""
    rates = [f"rate_{axis}" for axis in "xyz"]
    regressors = {name: table[name].to_numpy() for name in table.columns[5:]}
    regressors |= {f"abs({name})": np.abs(regressors[name]) for name in rates}
    regressors["time"] = table["time"].to_numpy() / 86400
    blocks = len(table) // BLOCK

    def angle(rate):
        return (np.cumsum(rate) * SAMPLE_INTERVAL_S)[: blocks * BLOCK].reshape(blocks, BLOCK).mean(axis=1)

    calibrations = [np.ones(blocks), angle(np.ones(len(table)))] + [angle(regressors[name]) for name in rates]
    products = {name: values for name, values in regressors.items() if name not in rates}
    for one, other in itertools.combinations_with_replacement(regressors, 2):
        # The square of a magnitude is that of the rate.
        if one != other or not one.startswith("abs"):
            products[f"{one}^2" if one == other else f"{one}*{other}"] = regressors[one] * regressors[other]
    products |= {f"{name}^3": regressors[name] ** 3 for name in rates}
    # A constant regressor is left out.
    return np.column_stack(calibrations), {name: angle(values) for name, values in products.items() if np.any(values)}


def statsmodels(calibrations, terms, residual):
    """Forward selection on angles with autoregressive noise."""
    import statsmodels.api as sm

    names, columns, chosen = list(terms), np.column_stack(list(terms.values())), []

    def fit(chosen):
        model = sm.GLSAR(residual, np.column_stack([calibrations, columns[:, chosen]]), rho=AUTOREGRESSION)
        result = model.iterative_fit(8)
        return model, result, result.bic + 2 * len(chosen) * np.log(len(names))

    model, best, min_score = fit(chosen)
    while len(chosen) < MAX_TERMS:
        basis = np.linalg.qr(model.wexog)[0]
        white = model.whiten(columns)
        left = white - basis @ (basis.T @ white)
        squares = (left**2).sum(axis=0)
        independent = squares > 1e-9 * (white**2).sum(axis=0)
        gain = np.where(independent, (left.T @ model.wendog) ** 2 / np.where(independent, squares, 1), 0)
        tried = chosen + [int(np.argmax(gain))]
        model, result, score = fit(tried)
        if score >= min_score:
            break
        chosen, best, min_score = tried, result, score
    return [(names[index], best.params[calibrations.shape[1] + place]) for place, index in enumerate(chosen)]


def pysindy(calibrations, terms, residual):
    """Sequentially thresholded least squares on rates over a minute."""
    import pysindy as ps

    def rates(columns):
        return np.diff(columns[::MINUTE], axis=0) / (MINUTE * BLOCK * SAMPLE_INTERVAL_S)

    names, rate = list(terms), rates(residual)
    features, basis = rates(np.column_stack(list(terms.values()))), np.linalg.qr(rates(calibrations[:, 1:]))[0]
    features, rate = features - basis @ (basis.T @ features), rate - basis @ (basis.T @ rate)
    min_score, best = np.inf, []
    for threshold in np.geomspace(0.03, 1, 12) * np.linalg.norm(rate):
        optimizer = ps.STLSQ(threshold=threshold, alpha=0.1, normalize_columns=True)
        sizes = optimizer.fit(features, rate).coef_.ravel()
        kept = np.flatnonzero(sizes)
        penalty = len(kept) * (np.log(len(rate)) + 2 * np.log(len(names)))
        score = len(rate) * np.log(np.sum((rate - features @ sizes) ** 2)) + penalty
        if score < min_score:
            min_score, best = score, [(names[index], sizes[index]) for index in kept]
    return best


tool, file = sys.argv[1:3]
warnings.simplefilter("ignore")
table = pd.read_csv(file)
calibrations, terms = library(table)
for gyro in table.columns[1:5]:
    own = table[gyro].to_numpy()[: len(calibrations) * BLOCK].reshape(-1, BLOCK).mean(axis=1)
    for name, coefficient in {"statsmodels": statsmodels, "pysindy": pysindy}[tool](calibrations, terms, own):
        print(f"{gyro.upper()} {name} {coefficient:.3g}")
