"""What a calibration leaves in a folder: a scene to go on with, and tables of points and forecasts."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path

import numpy as np

from warpriver import __version__
from warpriver.calibration.fits import Fit
from warpriver.calibration.hindcasts import Hindcast
from warpriver.errors import PathError
from warpriver.files import beside
from warpriver.io.tables import as_toml
from warpriver.io.vector.networks import write_network
from warpriver.metrics.lines import arc_length_of
from warpriver.network import RiverNetwork
from warpriver.params import MeanderParams
from warpriver.public import public
from warpriver.validate import positive

__all__ = ["FIT_FILES", "FORECASTS", "write_fit", "write_hindcast"]

# The files of a fit, and that of forecasts.
FIT_FILES = ("scene.toml", "rivers.csv", "points.csv")
FORECASTS = "forecasts.csv"


@public
def write_fit(
    fit: Fit, folder: str | os.PathLike[str], network: RiverNetwork, *, years: float | None = None
) -> list[Path]:
    """Write a fit into a folder.

    - ``scene.toml``: a scene with the constants, that goes on from ``network``: ``warpriver simulate scene.toml``;
    - ``rivers.csv``: that network;
    - ``points.csv``: where the river was, how far it moved and should have moved by the law, and the law there.

    Args:
        fit: What :func:`calibrate` returned.
        folder: Where to write; it is made.
        network: The river to go on with, most often the later survey.
        years: How long the scene runs, yr; by default as long as there was between the surveys.

    Returns:
        The files.

    Raises:
        OSError: They cannot be written.
    """
    span = fit.years if years is None else positive(years, "years", "yr")
    target = Path(folder)
    try:
        target.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise PathError.of(error, f"cannot make {target}") from error
    scene, rivers, points = (target / name for name in FIT_FILES)
    write_network(network, rivers)
    with beside(scene) as temporary:
        temporary.write_text(_scene(fit, rivers.name, span), encoding="utf-8")
    with beside(points) as temporary:
        _write_points(fit, temporary)
    return [scene, rivers, points]


@public
def write_hindcast(past: Hindcast, path: str | os.PathLike[str]) -> None:
    """Write forecasts as a table, a line each, distances in m, constants as they were fitted.

    Args:
        past: What :func:`hindcast` returned.
        path: The file, .csv.

    Raises:
        OSError: It cannot be written.
    """
    names = ("begin", "end", "part", "distance", "no_change", "linear", "coverage", "band", "correlation")
    constants = ("migration_rate", "memory_length", "friction", "curvature_saturation")
    rows = [",".join((*names, *constants))]
    for forecast in past.forecasts:
        values = [getattr(forecast, name) for name in names] + [getattr(forecast.params, name) for name in constants]
        rows.append(",".join(value if isinstance(value, str) else f"{value:.6g}" for value in values))
    with beside(Path(path)) as temporary:
        temporary.write_text("\n".join(rows) + "\n", encoding="utf-8")


def _scene(fit: Fit, rivers: str, years: float) -> str:
    """The text of a scene with the constants of a fit."""
    rows = [
        f"# Calibrated by warpriver {__version__} on {fit.years:.6g} yr: r {fit.correlation:.3f} over "
        f"{fit.scored.sum()} points.",
    ]
    for name in fit.constants:
        low, value, high = fit.interval(name)
        rows.append(f"#   {name}: {value:.4g}, nine in ten between {low:.4g} and {high:.4g}")
    rows += ['name = "calibrated"', "", "[network]", f"file = {as_toml(rivers)}"]
    if fit.crs is not None:
        rows.append(f"crs = {as_toml(fit.crs)}")
    rows += ["", "[params]"]
    for field in dataclasses.fields(MeanderParams):
        value = getattr(fit.params, field.name)
        # Those left at their defaults follow these, but for what was fitted.
        if field.name in fit.constants or (value != field.default and value is not None and field.name != "avulsions"):
            rows.append(f"{field.name} = {as_toml(_rounded(value))}")
    rows += ["", "[run]", f"years = {as_toml(years)}", ""]
    return "\n".join(rows)


def _rounded(value: str | float) -> str | float:
    """A constant to six digits, beyond which no survey tells it."""
    return float(f"{value:.6g}") if isinstance(value, float) else value


def _write_points(fit: Fit, path: Path) -> None:
    """Write the points of a fit as a table."""
    lines = [fit.part(k) for k in range(len(fit.start) - 1)]
    number = np.concatenate([np.full(part.stop - part.start, k) for k, part in enumerate(lines)])
    along = np.concatenate([arc_length_of(fit.xy[part]) for part in lines])
    columns = (number, along, *fit.xy.T, fit.width, fit.observed, fit.predicted, fit.scored, *fit.law.T)
    memory = "memory_widths" if fit.params.memory_length > 0.0 else "memory_depths"
    head = f"line,along_m,x,y,width_m,observed_m,predicted_m,scored,migration_rate,{memory},curvature_saturation"
    formats = ("%d", "%.1f", "%.2f", "%.2f", "%.2f", "%.2f", "%.2f", "%d", "%.5g", "%.5g", "%.5g")
    np.savetxt(path, np.column_stack(columns), fmt=formats, delimiter=",", header=head, comments="")
