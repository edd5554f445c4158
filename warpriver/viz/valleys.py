"""Pictures of synthetic valleys: contoured surface over covariance structures, and sections with the long profile.

matplotlib is imported when something is drawn, not before, and its global state (``pyplot``) is never touched.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from warpriver.errors import InputError
from warpriver.public import public
from warpriver.terrain import Terrain
from warpriver.validate import positive
from warpriver.valley.valley import Valley
from warpriver.viz.relief import relief_picture
from warpriver.viz.sheet import BANK, FAINT, INK, PICTURES, WATER, check_drawing, checked_axes, replacing, save_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["draw_valley", "draw_valley_sections"]

# Contour intervals to choose from, m; the document draws every 2 m.
INTERVALS = (0.1, 0.2, 0.25, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
# About as many contours as a map shows well, and every how many one is strong.
CONTOURS, STRONG = 14, 5
# Cells along the longer side of the map.
CELLS = 1000
# Fraction of the reach at each end that the sections shown keep away from: there the ground may end beside the channel.
END = 0.06
# Largest ratio of the map's sides, either way.
MAX_ASPECT = 6.0
RIFFLE, POOL = "#b4653a", "#2f6f93"
SERIES = {"thalweg_width": ("c(z$_T$, W)", POOL), "thalweg_curvature": ("c(z$_T$, |C|)", RIFFLE)}


@public
def draw_valley(
    valley: Valley,
    path: str | os.PathLike[str] | None = None,
    *,
    interval: float | None = None,
    dpi: float = 160.0,
    ax: Axes | None = None,
) -> Figure | Axes:
    """Draw a valley as [Brown2014], Figs 4 to 6: its surface with contours, and under it its covariance structures.

    Args:
        valley: Valley.
        path: File to write (.png, .jpg, .pdf or .svg), or None.
        interval: Contour interval in m; by default one that gives about 14 contours.
        dpi: Pixels per inch.
        ax: Axes of your own for the surface alone, without covariance structures and colour bar.

    Returns:
        The figure, whose axes are the surface, the bar of its heights and the covariance structures; with ``ax`` those
        axes.

    Raises:
        ImportError: matplotlib is missing.
        ValueError: An interval that is not positive, or an unknown suffix.
        OSError: The file cannot be written.
    """
    check_drawing(path)
    from matplotlib.figure import Figure

    west, south, east, north = valley.bounds
    terrain = valley.raster(max(east - west, north - south) / CELLS)
    if ax is not None:
        (axes,) = checked_axes(ax, 1)
        _draw_surface(axes, None, terrain, interval)
        _draw_channel(axes, valley)
        if path is not None:
            _save(axes.figure, path, dpi)
        return axes
    aspect = float(np.clip((east - west) / (north - south), 1.0 / MAX_ASPECT, MAX_ASPECT))
    width = 10.0 if aspect > 1.0 else 7.0
    inner = width - 1.9
    tall = min(inner / aspect, 9.0)
    figure = Figure(figsize=(width, tall + 3.6), dpi=dpi, facecolor="white")
    high = tall + 3.6
    axes = figure.add_axes((0.9 / width, 2.85 / high, inner / width, tall / high))
    bar = figure.add_axes(((width - 0.85) / width, 2.85 / high, 0.14 / width, min(tall, 3.0) / high))
    step = _draw_surface(axes, bar, terrain, interval)
    _draw_channel(axes, valley)
    p = valley.params
    title = f"{p.name}: sinuosity {valley.sinuosity:.2f}, depth {valley.bankfull_depth:.2f} m, width {p.width:g} m"
    figure.text(0.9 / width, (high - 0.35) / high, title, fontsize=12, color=INK, weight="bold")
    flow = "; flow to the right" if abs(valley.stations.frame.angle) < 0.5 else ""
    axes.set_title(f"contours every {step:g} m{flow}", fontsize=8.5, color=FAINT, loc="right", pad=4)
    plot = figure.add_axes((0.9 / width, 0.55 / high, inner / width, 1.7 / high))
    _draw_covariance(plot, valley)
    _save(figure, path, dpi)
    return figure


@public
def draw_valley_sections(
    valley: Valley,
    path: str | os.PathLike[str] | None = None,
    *,
    positions: Sequence[float] | None = None,
    dpi: float = 160.0,
    ax: Sequence[Axes] | None = None,
) -> Figure | Sequence[Axes]:
    """Draw cross sections, seen downstream, and the long profile of a valley.

    Args:
        valley: Valley.
        path: File to write (.png, .jpg, .pdf or .svg), or None.
        positions: Where sections are drawn, fractions of the reach; by default at the highest and the lowest thalweg
            and in the sharpest left and right bends.
        dpi: Pixels per inch.
        ax: Axes of your own, one for each section and one for the profile.

    Returns:
        The figure, whose axes are the sections and then the profile; with ``ax`` those axes.

    Raises:
        ImportError: matplotlib is missing.
        ValueError: A position outside 0 to 1, or an unknown suffix.
        OSError: The file cannot be written.
    """
    check_drawing(path)
    from matplotlib.figure import Figure

    places = _section_places(valley) if positions is None else {f"at {v:g} of the reach": float(v) for v in positions}
    if not places or any(not 0.0 <= v <= 1.0 for v in places.values()):
        raise InputError(f"positions are {list(places.values())}; give fractions of the reach, 0 to 1")
    if ax is not None:
        panels = checked_axes(ax, len(places) + 1)
        for panel, (name, fraction) in zip(panels, places.items(), strict=False):
            _draw_section(panel, valley, name, fraction)
        _draw_profile(panels[-1], valley)
        if path is not None:
            _save(panels[0].figure, path, dpi)
        return ax
    rows = (len(places) + 1) // 2
    figure = Figure(figsize=(10.0, 2.3 * rows + 3.4), dpi=dpi, facecolor="white", layout="constrained")
    layout = figure.add_gridspec(rows + 1, 2, height_ratios=[1.0] * rows + [1.35])
    for k, (name, fraction) in enumerate(places.items()):
        _draw_section(figure.add_subplot(layout[k // 2, k % 2]), valley, name, fraction)
    _draw_profile(figure.add_subplot(layout[rows, :]), valley)
    figure.suptitle(f"{valley.params.name}: sections seen downstream, and long profile", fontsize=12, color=INK)
    _save(figure, path, dpi)
    return figure


def _draw_surface(axes: Axes, bar: Axes | None, terrain: Terrain, interval: float | None) -> float:
    """Tinted relief, contours and the bar of heights; returns the contour interval in m."""
    height = terrain.to_numpy()
    low, high = float(np.nanmin(height)), float(np.nanmax(height))
    if interval is None:
        interval = next((v for v in INTERVALS if (high - low) / v <= CONTOURS), INTERVALS[-1])
    positive(interval, "interval", "m")
    west, south, east, north = terrain.bounds
    rows, columns = height.shape
    shade = relief_picture(terrain, terrain.bounds, (rows, columns)).shade
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    norm, tints = Normalize(low, high), colormaps["gist_earth"].resampled(256)
    # The map's sea and snow are left out.
    color = tints(0.25 + 0.62 * np.nan_to_num(norm(height)))[..., :3] * np.clip(shade, 0.55, 1.1)[..., None]
    pixels = np.dstack([np.clip(color, 0.0, 1.0), np.isfinite(height)])
    axes.imshow(pixels, extent=(west, east, south, north), origin="upper", interpolation="bilinear", aspect="equal")
    size = terrain.cell_size
    x, y = west + size * (np.arange(columns) + 0.5), north - size * (np.arange(rows) + 0.5)
    levels = interval * np.arange(np.ceil(low / interval), np.floor(high / interval) + 1)
    if len(levels):
        strong = np.where(np.round(levels / interval) % STRONG == 0, 0.9, 0.4)
        axes.contour(x, y, height, levels=levels, colors=INK, linewidths=strong, alpha=0.75)
    axes.set(xlim=(west, east), ylim=(south, north))
    axes.set_xlabel("x, m", fontsize=8.5, color=FAINT, labelpad=2)
    axes.set_ylabel("y, m", fontsize=8.5, color=FAINT, labelpad=2)
    axes.tick_params(labelsize=8, colors=FAINT, labelcolor=INK, width=0.6, length=3)
    from matplotlib.colors import ListedColormap

    ramp = ListedColormap(tints(np.linspace(0.25, 0.87, 256)))
    if bar is None:
        return float(interval)
    colorbar = axes.figure.colorbar(ScalarMappable(norm, ramp), cax=bar)
    colorbar.ax.tick_params(labelsize=8, colors=FAINT, labelcolor=INK, width=0.6, length=2.5)
    colorbar.ax.set_title("m", fontsize=8.5, color=FAINT)
    return float(interval)


def _draw_channel(axes: Axes, valley: Valley) -> None:
    """Banks and thalweg, and what stands over them."""
    from matplotlib.colors import ListedColormap

    lines = valley.breaklines()
    for name in ("left_bank", "right_bank"):
        axes.plot(*lines[name][:, :2].T, color=BANK, linewidth=1.1)
    axes.plot(*lines["thalweg"][:, :2].T, color=WATER, linewidth=0.9, linestyle=(0, (5, 2)))
    for line, half, _ in valley.threads:
        normal = np.column_stack([-line.tangent[:, 1], line.tangent[:, 0]])
        for bank in (line.xy + half[:, :1] * normal, line.xy - half[:, 1:] * normal):
            axes.plot(*valley.stations.frame.to_map(bank).T, color=BANK, linewidth=0.8)
    for structure in valley.structures():
        x, y = structure.points()[:, :2].T
        axes.tripcolor(
            x,
            y,
            np.zeros(len(x)),
            triangles=structure.triangles(),
            cmap=ListedColormap([FAINT]),
            zorder=3,
        )


def _draw_covariance(axes: Axes, valley: Valley) -> None:
    """Structures against the distance along the channel, with their means."""
    found = valley.covariance
    axes.axhline(0.0, color=FAINT, linewidth=0.7)
    for name, (label, color) in SERIES.items():
        value, mean = getattr(found, name), getattr(found, f"mean_{name}")
        if np.isfinite(mean):
            axes.plot(
                found.station, value, color=color, linewidth=1.5, label=f"{label}, mean {round(mean, 2) + 0.0:.2f}"
            )
            axes.axhline(mean, color=color, linewidth=0.7, linestyle=(0, (4, 3)))
    axes.set_xlim(found.station[0], found.station[-1])
    axes.set_xlabel("distance along the channel, m", fontsize=8.5, color=FAINT, labelpad=2)
    axes.set_ylabel("covariance", fontsize=8.5, color=FAINT)
    axes.margins(y=0.18)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize=8.5, frameon=False, loc="upper left", ncols=2, bbox_to_anchor=(0.0, 1.14), borderpad=0.0)
    else:
        text = "the thalweg does not vary with width or curvature"
        axes.text(0.5, 0.6, text, transform=axes.transAxes, ha="center", fontsize=9, color=FAINT)
    _plain(axes)


def _section_places(valley: Valley) -> dict[str, float]:
    """Where the thalweg is highest and lowest, and where the channel turns most; fractions of the reach."""
    stations, reach = valley.stations, valley.stations.reach
    fraction = stations.line.s[reach] / stations.length
    inside = (fraction >= END) & (fraction <= 1.0 - END)
    fraction, residual, bend = (
        fraction[inside],
        stations.residual[reach][inside],
        stations.line.curvature[reach][inside],
    )
    places = {"riffle": int(residual.argmax()), "pool": int(residual.argmin())}
    if np.abs(bend).max() * stations.length > 1e-6:
        places |= {"sharpest left turn": int(bend.argmax()), "sharpest right turn": int(bend.argmin())}
    return {name: float(fraction[k]) for name, k in places.items()}


def _draw_section(axes: Axes, valley: Valley, name: str, fraction: float) -> None:
    """Ground across the channel and some of the floor at one station, with the water at top of bank."""
    stations, reach = valley.stations, valley.stations.reach
    k = reach.start + round(fraction * valley.params.increments)
    half, tangent = stations.half[k], stations.line.tangent[k]
    n = np.linspace(-2.2 * half.max(), 2.2 * half.max(), 601)
    place = stations.line.xy[k] + n[:, None] * np.array([-tangent[1], tangent[0]])
    height = valley.height(stations.frame.to_map(place))
    across = -n
    bank = valley.bank_height_at(place[:, 0]) + stations.lift[k]
    inside = (n <= half[0]) & (n >= -half[1])
    axes.fill_between(across, height, bank, where=inside & (bank > height), color=WATER, alpha=0.35, linewidth=0.0)
    axes.plot(across, height, color=INK, linewidth=1.3)
    axes.set_title(f"{name}, {fraction * stations.length:.0f} m", fontsize=9, color=INK, loc="left", pad=3)
    axes.set_xlabel("left bank (-)  ·  m from the centreline  ·  right bank (+)", fontsize=7.5, color=FAINT, labelpad=1)
    axes.set_ylabel("height, m", fontsize=8, color=FAINT)
    _plain(axes)


def _draw_profile(axes: Axes, valley: Valley) -> None:
    """Thalweg, top of bank, floor's edge and valley top along the channel."""
    stations, reach = valley.stations, valley.stations.reach
    lines, s = valley.breaklines(), stations.line.s[reach]
    x = stations.line.xy[reach, 0]
    at = valley.lines.start + valley.lines.step * np.arange(len(valley.lines.table))
    for name, label, color, style in (
        ("left_top", "valley top", FAINT, (0, (1, 1.5))),
        ("left_floor", "floor's edge", RIFFLE, (0, (4, 2))),
    ):
        axes.plot(s, np.interp(x, at, lines[name][:, 2]), color=color, linewidth=1.1, linestyle=style, label=label)
    axes.plot(s, lines["left_bank"][:, 2], color=BANK, linewidth=1.2, label="top of bank")
    axes.plot(s, lines["thalweg"][:, 2], color=WATER, linewidth=1.5, label="thalweg")
    axes.set_xlim(s[0], s[-1])
    axes.set_xlabel("distance along the channel, m", fontsize=8.5, color=FAINT)
    axes.set_ylabel("height, m", fontsize=8.5, color=FAINT)
    axes.legend(fontsize=8, frameon=False, ncols=4, loc="upper right")
    axes.margins(y=0.2)
    _plain(axes)


def _plain(axes: Axes) -> None:
    """Thin spines, small ticks."""
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set(linewidth=0.6, color=FAINT)
    axes.tick_params(labelsize=8, colors=FAINT, labelcolor=INK, width=0.6, length=3)
    axes.ticklabel_format(useOffset=False)


def _save(figure: Any, path: str | os.PathLike[str] | None, dpi: float) -> None:
    """Write a figure, if a file is named."""
    if path is not None:
        with replacing(path, PICTURES) as temporary:
            save_figure(figure, temporary, dpi)
