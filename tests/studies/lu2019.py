"""Made-up tables of the study lu2019, whose truth is known."""

import sys

import numpy as np
import pandas as pd

from aoabench.studies import study

LU = study.load("lu2019")
N = LU.numbers
LEVELS = [0.0, 0.1, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0]


def made_up(levels, rng, trials=40, slopes=(1.0, 2.0, 0.0), begin=2.0, shape=100):
    """Trials whose errors grow with the uncertainty by `slopes`, the filters' from 1 cm and the
    centroid's from `begin` m on; the larger the shape, the less the trials differ.
    """
    rows = []
    for kind in ("independent", "common"):
        for sigma in levels:
            for name, slope, offset in zip(N.METHODS, slopes, (0.01, 0.01, begin)):
                for r, e in enumerate(rng.gamma(shape, 1 / shape, trials)):
                    rmse = offset * e + slope * sigma * e
                    rows.append((f"{kind}{sigma}", kind, sigma, name, r, rmse, 0.1 * rmse))
    columns = [
        "cell",
        "noise.an_error",
        "noise.an_sigma_m",
        "estimator",
        "replication",
        "rmse_3d_m",
        "rmse_z_m",
    ]
    return pd.DataFrame(rows, columns=columns)


def errata_runs(rng):
    rows = []
    for sigma in (0.0, 5.0):
        for gain in ("[]", '["gain"]'):
            for flags in ("[]", '["jacobian"]', '["wrap"]', '["shared"]', '["cross"]'):
                for name in ("ekf_toa_aoa", "ekf_aoa", "wcg", "wcg_as_printed"):
                    factor = (
                        1
                        + ("gain" in gain)
                        + 2 * ("wrap" in flags) * ("ekf" in name)
                        + 3 * ("printed" in name)
                    )
                    for r, e in enumerate(rng.gamma(100, 0.01, 5)):
                        rows.append(
                            (f"{sigma}{gain}{flags}", sigma, gain, flags, name, r, factor * e)
                        )
    columns = [
        "cell",
        "noise.an_sigma_m",
        "noise.as_printed",
        "filter.ekf_toa_aoa.as_printed",
        "estimator",
    ]
    return pd.DataFrame(rows, columns=[*columns, "replication", "rmse_3d_m"])


def pilots():
    """A table of Figure 3, made up: one number for each name and setting."""
    curves = [("cdf", "chosen", n, x, 0.5, np.nan, 8) for n in N.setting.GRIDS for x in (-1.0, 1.0)]
    numbers = [
        (kind, setting, name, np.nan, 90.0, 1.0, 8)
        for setting in N.setting.READINGS
        for name, (kind, _) in N.setting.NUMBERS.items()
    ]
    exact = [("exact", "chosen", "clock_m", np.nan, 3.0, 0.0, 0)]
    columns = ["kind", "setting", "name", "x", "value", "se", "trials"]
    return pd.DataFrame(curves + numbers + exact, columns=columns)


def readings_of(rng, monkeypatch, excess=1.3):
    """The table of the readings, of made-up trials whose filters err `excess` times the
    centroid.
    """

    def trials(cell, count):
        centroid = rng.gamma(4, 0.5, count)
        return {
            name: dict.fromkeys(("3d", "z"), centroid * (1 if name == "wcg" else excess))
            for name in N.METHODS
        }

    module = sys.modules[f"{N.__name__}.readings"]
    monkeypatch.setattr(module, "trial_rmses", trials)
    monkeypatch.setattr(module, "cell_of", lambda *_: None)
    return N.readings("quick")
