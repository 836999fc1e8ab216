"""The filters on the square track: one lap, and RMSEs over replications."""

from __future__ import annotations

import numpy as np
import pandas as pd

from aoabench.config.compose import compose_cells
from aoabench.engine.draws import Draws
from aoabench.engine.tiles import estimate_tile
from aoabench.maths import statistics
from aoabench.store.summary import QUANTILES

from .models import MODELS


def fig3(scale: str) -> pd.DataFrame:
    """Replication 0 of each data model on the base layout: truth, particle filters' estimates,
    anchors.
    """
    filters = [f"pf_{model}" for model in MODELS]
    rows = []
    for noise in ("ae_flip", "vmf"):
        cell = compose_cells(
            [f"noise={noise}", f"filter=[{','.join(filters)}]", "scenario=square_track"]
        )[0]
        draws = Draws(cell.scenario, cell.noise, cell.seed)
        truth, _ = draws.tile(0, 1)
        tracks = {"truth": truth[0]}
        for name, estimator in cell.estimators.items():
            tracks[name] = estimate_tile(draws, estimator, 0)[1].position[0]
        for name, track in tracks.items():
            rows += [(noise, name, k, *x, np.nan, np.nan) for k, x in enumerate(track[:, :3])]
        anchors = cell.scenario.true_anchors
        poles = anchors.rotation[0, 0, :, 2]  # the global direction of each pole
        rows += [
            (noise, "anchor", j, *s, *poles[j, :2]) for j, s in enumerate(anchors.position[0, 0])
        ]
    return pd.DataFrame(
        rows, columns=["noise", "kind", "step", "x_m", "y_m", "z_m", "pole_x", "pole_y"]
    )


def frames(runs: pd.DataFrame) -> pd.DataFrame:
    """Mean RMSE of each filter in each anchor frame, and its paired change in percent from the
    unturned frames.
    """
    key = "scenario.anchors.frame_rpy_deg"
    rows = []
    for name, group in runs.groupby("estimator", sort=False):
        wide = group.pivot(index="replication", columns=key, values="rmse_3d_m")
        for frame in sorted(wide.columns, key=lambda c: (c != "[0, 0, 0]", c)):
            mean = statistics.mean(wide[frame])
            change = statistics.paired(wide[frame], wide["[0, 0, 0]"]).percent
            row = {"estimator": name, "frame_rpy_deg": frame}
            row |= mean.columns("rmse_mean_3d_m", "se_m")
            row |= change.columns("change_percent", "change_se")
            rows.append(row | {"replications": len(wide)})
    return pd.DataFrame(rows)


def fig4(runs: pd.DataFrame) -> pd.DataFrame:
    """Per layout, data model and filter: RMSE, its percentage difference from PF-VMF, paired
    differences of models.

    Columns q05 ... maximum are levels of the per-replication difference; above_X_percent is the
    paired difference of mean RMSE from the same filter with model X (pf_vmf: from PF-VMF);
    wins_percent is the share of laps with a smaller RMSE than the same filter with VMF, and
    beyond_pf_percent the excess over that filter less the particle filter's, in percentage points.
    """
    rows = []
    for (layout, noise), group in runs.groupby(["scenario", "noise"], sort=False):
        wide = group.pivot(index="replication", columns="estimator", values="rmse_3d_m")
        for name in wide.columns:
            family, _, model = name.partition("_")
            percent = 100 * (wide[name] / wide["pf_vmf"] - 1)
            levels = [statistics.quantile(percent, q) for q in QUANTILES]
            mean = statistics.mean(wide[name])
            row = {"layout": layout, "noise": noise, "estimator": name}
            row |= {"family": family, "model": model}
            row |= {"particles": int(group["filter.pf_vmf.particles"].iloc[0])}
            row |= {"replications": len(wide), **mean.columns("rmse_mean_3d_m", "se_m")}
            row |= {f"q{round(100 * q):02d}": level.value for q, level in zip(QUANTILES, levels)}
            row |= levels[2].columns("q50", "median_se")
            row |= {"minimum": percent.min(), "maximum": percent.max()}
            others = {"pf_vmf": "pf_vmf"} | {
                m: f"{family}_{m}" for m in ("vmf", "ae_nominal", "ae_fitted")
            }
            for other, against in others.items():
                pair = statistics.paired(wide[name], wide[against]).percent
                row |= pair.columns(f"above_{other}_percent", f"above_{other}_se")
            rows.append(row | _beside_vmf(wide, name))
    return pd.DataFrame(rows)


def _beside_vmf(wide: pd.DataFrame, name: str) -> dict[str, float]:
    """The columns wins_... and beyond_pf_... of a filter."""
    family, _, model = name.partition("_")
    pf = f"pf_{model.removesuffix('_augmented')}"
    vmf = wide[f"{family}_vmf"]
    wins = statistics.rate(int((wide[name] < vmf).sum()), len(wide)).percent()
    beyond = statistics.ratio_difference(wide[name], vmf, wide[pf], wide["pf_vmf"]).percent()
    return wins.columns("wins_percent", "wins_se") | beyond.columns(
        "beyond_pf_percent", "beyond_pf_se"
    )


def readings(runs: pd.DataFrame) -> pd.DataFrame:
    """The columns of `fig4` for AE-adaptive, with deviations about the truth and about the mean."""
    key = "filter.pf_ae_adaptive.measurement.adaptive_about"
    tables = [fig4(group).assign(about=about) for about, group in runs.groupby(key)]
    both = pd.concat(tables, ignore_index=True)
    return both[both["model"].str.startswith("ae_adaptive")].reset_index(drop=True)


def layouts(runs: pd.DataFrame) -> pd.DataFrame:
    """The columns of `fig4` for the layout variants."""
    return fig4(runs)


def adaptivity(runs: pd.DataFrame) -> pd.DataFrame:
    """Per layout, data model and form of AE-adaptive: paired percentage from the same filter with
    another AE model.
    """
    rows = []
    for (layout, noise), group in runs.groupby(["scenario", "noise"], sort=False):
        wide = group.pivot(index="replication", columns="estimator", values="rmse_3d_m")
        for name in ("ekf_ae_adaptive", "ukf_ae_adaptive", "ukf_ae_adaptive_augmented"):
            for other in ("ae_nominal", "ae_fitted"):
                against = f"{name.partition('_')[0]}_{other}"
                above = statistics.paired(wide[name], wide[against]).percent
                row = {"layout": layout, "noise": noise, "estimator": name, "other": other}
                row |= above.columns("above_percent", "above_se")
                rows.append(row | {"replications": len(wide)})
    return pd.DataFrame(rows)


def particles(runs: pd.DataFrame) -> pd.DataFrame:
    """Mean RMSE of each particle filter for each number of particles, and its paired excess over
    that with the largest number.
    """
    rows = []
    for (noise, name), group in runs.groupby(["noise", "estimator"], sort=True):
        wide = group.pivot(
            index="replication", columns="filter.pf_vmf.particles", values="rmse_3d_m"
        )
        for count in sorted(wide.columns):
            mean = statistics.mean(wide[count])
            above = statistics.paired(wide[count], wide[max(wide.columns)]).percent
            row = {"noise": noise, "particles": int(count), "estimator": name}
            row |= mean.columns("rmse_mean_3d_m", "se_m")
            row |= above.columns("above_largest_percent", "above_largest_se")
            rows.append(row | {"replications": len(wide)})
    return pd.DataFrame(rows)
