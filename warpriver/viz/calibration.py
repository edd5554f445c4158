"""Pictures of calibrations: where a fit is right and wrong along a river and on a map, and what forecasts are worth.

matplotlib is imported when something is drawn, not before, and its global state (``pyplot``) is never touched.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from warpriver.calibration.fits import Fit
from warpriver.calibration.hindcasts import Hindcast
from warpriver.metrics.lines import arc_length_of
from warpriver.public import public
from warpriver.validate import positive
from warpriver.viz.bands import Window
from warpriver.viz.sheet import FAINT, INK, PICTURES, check_drawing, grow_to_aspect, replacing, save_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["draw_fit", "draw_fit_map", "draw_hindcast"]

SEEN, SAID, STILL = "#2b2f2c", "#c8553d", "#9fb3ba"
# Misfit over width, from too far right to too far left; grey where nothing is scored.
LEFT, RIGHT, UNSCORED = "#2f6f93", "#b4653a", "#d9d6cb"
# Displacements along the river are drawn in rows of about so many widths.
ROW_WIDTHS, MOST_ROWS = 350.0, 6
# Length of the part of the river that is drawn in detail, widths.
DETAIL = 90.0
# Rivers whose window is so many times wider than tall lie above their detail, others beside it.
SQUARE = 1.5
# Limits of a colour scale or an axis leave out this part at either end.
TAIL = 0.01


@public
def draw_fit(fit: Fit, path: str | os.PathLike[str] | None = None, *, line: int = 0, dpi: float = 160.0) -> Figure:
    """Draw how far a river moved, and how far the law says it did: along the river, and against each other.

    Args:
        fit: What ``warpriver.calibration.calibrate`` returned.
        path: File to write (.png, .jpg, .pdf or .svg), or None.
        line: Number of the river, where there are several.
        dpi: Pixels per inch.

    Returns:
        The figure: a row of axes for each part of the river, and last the one of both displacements.

    Raises:
        ImportError: matplotlib is missing.
        ValueError: There is no such river, or an unknown suffix.
        OSError: The file cannot be written.
    """
    check_drawing(path)
    from matplotlib.figure import Figure

    part = fit.part(line)
    s, width = arc_length_of(fit.xy[part]) / 1e3, float(fit.width[part].mean())
    rows = int(np.clip(np.ceil(s[-1] * 1e3 / (ROW_WIDTHS * width)), 1, MOST_ROWS))
    high = 1.25 * rows + 0.9
    figure = Figure(figsize=(13.0, max(high, 3.6)), dpi=positive(dpi, "dpi"), facecolor="white")
    grid = figure.add_gridspec(
        rows, 2, width_ratios=(3.4, 1.0), left=0.06, right=0.985, bottom=0.55 / max(high, 3.6),
        top=1.0 - 0.45 / max(high, 3.6), hspace=0.35, wspace=0.16,
    )  # fmt: skip
    seen, said, scored = fit.observed[part], fit.predicted[part], fit.scored[part]
    top = 1.15 * float(np.nanquantile(np.abs(np.where(scored, seen, np.nan)), 1.0 - TAIL))
    for k in range(rows):
        axes = figure.add_subplot(grid[k, 0])
        _draw_along(axes, s, seen, said, scored, (s[-1] * k / rows, s[-1] * (k + 1) / rows), top)
        if k == 0:
            axes.legend(loc="upper right", fontsize=7.5, ncols=3, frameon=False, borderaxespad=0.1)
    axes.set_xlabel("distance along the river, km", fontsize=8.5, color=INK)
    figure.axes[(rows - 1) // 2].set_ylabel("displacement, m (left > 0)", fontsize=8.5, color=INK)
    _draw_against(figure.add_subplot(grid[:, 1]), fit)
    title = f"{fit.years:.4g} years; r {fit.correlation:.2f}, {fit.skill:.0%} of the mean displacement explained"
    figure.text(0.06, 1.0 - 0.26 / max(high, 3.6), title, fontsize=11, color=INK, weight="bold")
    _save(figure, path, dpi)
    return figure


@public
def draw_fit_map(fit: Fit, path: str | os.PathLike[str] | None = None, *, line: int = 0, dpi: float = 160.0) -> Figure:
    """Draw where a fit is right and wrong: the river by its misfit, and a part of it with all three lines.

    On the left the misfit, observed less predicted displacement, in widths: the river went farther to the left than the
    law says, or farther to the right. On the right the stretch whose mean misfit is nearest to that of the whole river,
    at the first survey, at the second, and as the law has it.

    Args:
        fit: What ``warpriver.calibration.calibrate`` returned.
        path: File to write (.png, .jpg, .pdf or .svg), or None.
        line: Number of the river, where there are several.
        dpi: Pixels per inch.

    Returns:
        The figure: the map, its colour bar, and the detail.

    Raises:
        ImportError: matplotlib is missing.
        ValueError: There is no such river, or an unknown suffix.
        OSError: The file cannot be written.
    """
    check_drawing(path)
    from matplotlib.collections import LineCollection
    from matplotlib.colors import LinearSegmentedColormap, Normalize

    part = fit.part(line)
    xy, width = fit.xy[part] / 1e3, float(fit.width[part].mean())
    misfit = np.where(fit.scored[part], (fit.observed[part] - fit.predicted[part]) / width, np.nan)
    stretch = _typical(xy, misfit, DETAIL * width / 1e3)
    figure, whole, detail, bar = _map_page(_window(xy), _window(xy[stretch]), positive(dpi, "dpi"))
    limit = max(0.1, float(np.nanquantile(np.abs(misfit), 1.0 - 3.0 * TAIL)))
    ramp, norm = LinearSegmentedColormap.from_list("misfit", (RIGHT, "#efe9d8", LEFT)), Normalize(-limit, limit)
    known = np.isfinite(misfit[1:]) & np.isfinite(misfit[:-1])
    colors = ramp(norm(np.nan_to_num(0.5 * (misfit[1:] + misfit[:-1]))))
    colors[~known] = (0.62, 0.63, 0.6, 1.0)
    pieces = list(np.stack([xy[:-1], xy[1:]], axis=1))
    whole.add_collection(LineCollection(pieces, colors="#4a4d48", linewidths=3.4, capstyle="round"))
    whole.add_collection(LineCollection(pieces, colors=colors, linewidths=2.4, capstyle="round"))
    bar.imshow(ramp(np.linspace(0.0, 1.0, 256))[None], extent=(-limit, limit, 0.0, 1.0), aspect="auto")
    bar.set(yticks=[])
    bar.set_title("observed less predicted, widths (left > 0)", fontsize=8, color=INK, pad=3)
    _style(bar)
    at_second = fit.lines()[line] + fit.offset
    for points, color, size, label in (
        (xy, STILL, 5.0, "first survey"),
        (fit.later(line) / 1e3, SEEN, 1.4, "second survey"),
        (at_second / 1e3, SAID, 1.4, "by the law"),
    ):
        detail.plot(*points.T, color=color, linewidth=size, label=label, solid_capstyle="round")
    detail.legend(loc="best", fontsize=8.5, frameon=True, framealpha=0.9, edgecolor="none")
    (west, south), (east, north) = xy[stretch].min(axis=0), xy[stretch].max(axis=0)
    whole.plot([west, east, east, west, west], [south, south, north, north, south], color=INK, linewidth=0.9)
    title = f"r {fit.correlation:.2f} over {fit.years:.4g} years; grey: not scored"
    whole.set_title(title, fontsize=11, color=INK, weight="bold", loc="left")
    _save(figure, path, dpi)
    return figure


@public
def draw_hindcast(past: Hindcast, path: str | os.PathLike[str] | None = None, *, dpi: float = 160.0) -> Figure:
    """Draw what forecasts were worth: their mean distances by lead beside the two without a model, and their bands.

    Args:
        past: What ``warpriver.calibration.hindcast`` returned.
        path: File to write (.png, .jpg, .pdf or .svg), or None.
        dpi: Pixels per inch.

    Returns:
        The figure: distances, and the part of the points within the bands.

    Raises:
        ImportError: matplotlib is missing.
        ValueError: An unknown suffix.
        OSError: The file cannot be written.
    """
    check_drawing(path)
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 4.0), dpi=positive(dpi, "dpi"), facecolor="white")
    left, right = figure.subplots(1, 2, gridspec_kw={"left": 0.075, "right": 0.985, "bottom": 0.14, "wspace": 0.24})
    lead = np.array([f.lead for f in past.forecasts])
    leads = [x for x in past.leads if any(past.nearest_lead(f.lead) == x for f in past.forecasts)]
    scores = [past.score(x) for x in leads]
    for name, label, color, marker in (
        ("no_change", "no change", STILL, "s"), ("linear", "linear extrapolation", "#c9a227", "^"),
        ("distance", "warpriver", SAID, "o"),
    ):  # fmt: skip
        values, means = np.array([getattr(f, name) for f in past.forecasts]), [getattr(s, name) for s in scores]
        if np.isfinite(values).any():
            left.scatter(lead, values, s=10, color=color, alpha=0.45, linewidths=0.0)
            left.plot(leads, means, color=color, marker=marker, markersize=6, linewidth=1.8, label=label)
    left.set_ylim(0.0, None)
    left.set_xlim(0.0, None)
    left.legend(fontsize=8.5, frameon=False, loc="upper left")
    left.set_xlabel("years ahead", fontsize=9, color=INK)
    left.set_ylabel("mean distance to the river that came, m", fontsize=9, color=INK)
    right.scatter([f.end for f in past.forecasts], [f.coverage for f in past.forecasts], s=12 + 6 * lead, color=SAID,
                  alpha=0.6, linewidths=0.0)  # fmt: skip
    right.axhline(past.level, color=INK, linewidth=0.8)
    right.axhspan(past.level - 0.05, past.level + 0.05, color=STILL, alpha=0.3, linewidth=0.0)
    right.set_ylim(min(0.6, min(f.coverage for f in past.forecasts) - 0.03), 1.0)
    right.set_xlabel("date of the survey that was forecast", fontsize=9, color=INK)
    right.set_ylabel("part of the river within the band", fontsize=9, color=INK)
    for axes in (left, right):
        _style(axes)
    _save(figure, path, dpi)
    return figure


def _draw_along(
    axes: Axes,
    s: NDArray[np.float64],
    seen: NDArray[np.float64],
    said: NDArray[np.float64],
    scored: NDArray[np.bool_],
    limits: tuple[float, float],
    top: float,
) -> None:
    """Displacements along a part of a river; what is not scored is shaded."""
    axes.fill_between(s, -top, top, where=~scored, color=UNSCORED, linewidth=0.0, label="not scored", step="mid")
    axes.axhline(0.0, color=FAINT, linewidth=0.5)
    axes.plot(s, np.where(scored, seen, np.nan), color=SEEN, linewidth=1.1, label="observed")
    axes.plot(s, np.where(scored, said, np.nan), color=SAID, linewidth=1.1, label="by the law")
    axes.set(xlim=limits, ylim=(-top, top))
    _style(axes)


def _draw_against(axes: Axes, fit: Fit) -> None:
    """Predicted against observed displacements of all scored points."""
    seen, said = fit.observed[fit.scored], fit.predicted[fit.scored]
    top = 1.2 * float(np.quantile(np.abs(np.concatenate([seen, said])), 1.0 - 0.5 * TAIL))
    axes.plot([-top, top], [-top, top], color=FAINT, linewidth=0.8)
    axes.hexbin(
        said, seen, gridsize=46, extent=(-top, top, -top, top), bins="log", cmap="Blues", linewidths=0.1, mincnt=1
    )
    axes.set(xlim=(-top, top), ylim=(-top, top), aspect="equal", anchor="N")
    axes.set_xlabel("by the law, m", fontsize=8.5, color=INK)
    axes.set_ylabel("observed, m", fontsize=8.5, color=INK)
    units = {"migration_rate": " m/yr", "memory_length": " widths"}
    rows = []
    for name in fit.constants:
        low, value, high = fit.interval(name)
        rows.append(f"{name.replace('_', ' ')}\n  {value:.3g} ({low:.3g} to {high:.3g}){units.get(name, '')}")
    axes.text(0.0, -0.22, "\n".join(rows), transform=axes.transAxes, fontsize=8.5, color=INK, va="top")
    _style(axes)


def _typical(xy: NDArray[np.float64], misfit: NDArray[np.float64], length: float) -> slice:
    """The stretch of so many km whose mean misfit is nearest to that of the whole river, and which is all scored."""
    step = arc_length_of(xy)[-1] / (len(xy) - 1)
    count = min(len(xy), max(8, int(length / step)))
    size = np.concatenate([[0.0], np.cumsum(np.nan_to_num(np.abs(misfit)))])
    good = np.concatenate([[0.0], np.cumsum(np.isfinite(misfit))])
    mean = (size[count:] - size[:-count]) / np.maximum(good[count:] - good[:-count], 1.0)
    whole = size[-1] / max(good[-1], 1.0)
    missing = 1.0 - (good[count:] - good[:-count]) / count
    first = int(np.argmin(np.abs(mean / whole - 1.0) + 10.0 * missing))
    return slice(first, first + count)


def _window(xy: NDArray[np.float64]) -> Window:
    """West, south, east and north of points, with a margin."""
    (west, south), (east, north) = xy.min(axis=0), xy.max(axis=0)
    pad = 0.04 * max(east - west, north - south)
    return west - pad, south - pad, east + pad, north + pad


def _map_page(whole: Window, detail: Window, dpi: float) -> tuple[Figure, Axes, Axes, Axes]:
    """A page with two maps and a colour bar: one above the other where the first one is wide, else side by side."""
    from matplotlib.figure import Figure

    aspect = float(np.clip((whole[2] - whole[0]) / (whole[3] - whole[1]), 0.3, 5.0))
    side, margin, strip = 12.0, 0.6, 0.9
    if aspect > SQUARE:
        tall, below = side / aspect, 5.4
        high = tall + below + 2.0 * margin + strip
        sizes = ((margin, below + margin + strip, side, tall), (margin, margin, side, below))
        legend = (side + margin - 3.2, below + margin + 0.45, 3.0, 0.12)
    else:
        tall, across = 6.4, 6.4 * max(aspect, 0.6)
        high = tall + 2.0 * margin + strip
        sizes = ((margin, margin + strip, across, tall), (across + 2.0 * margin, margin, side - across, tall + strip))
        legend = (margin + 0.2, margin + 0.1, 3.0, 0.12)
    wide = side + (2.0 if aspect > SQUARE else 2.6) * margin
    figure = Figure(figsize=(wide, high), dpi=dpi, facecolor="white")
    axes = [figure.add_axes((x / wide, y / high, w / wide, h / high)) for x, y, w, h in (*sizes, legend)]
    for each, window, (_, _, w, h) in zip(axes, (whole, detail), sizes, strict=False):
        west, south, east, north = grow_to_aspect(window, w / h)
        each.set(xlim=(west, east), ylim=(south, north))
        each.set_xlabel("easting, km", fontsize=8, color=FAINT, labelpad=2)
        each.set_ylabel("northing, km", fontsize=8, color=FAINT, labelpad=2)
        each.ticklabel_format(useOffset=False, style="plain")
        each.set_autoscale_on(False)
        _style(each)
    return figure, axes[0], axes[1], axes[2]


def _style(axes: Any) -> None:
    axes.tick_params(labelsize=7.5, colors=FAINT, labelcolor=INK, width=0.6, length=3, pad=2)
    for spine in axes.spines.values():
        spine.set(linewidth=0.6, color=FAINT)


def _save(figure: Figure, path: str | os.PathLike[str] | None, dpi: float) -> None:
    if path is not None:
        with replacing(path, PICTURES) as temporary:
            save_figure(figure, temporary, dpi)
