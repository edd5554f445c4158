"""``warpriver calibrate``: constants of migration from dated surveys of a river, and what forecasts are worth."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warpriver.cli.output import say
from warpriver.cli.parser import number
from warpriver.cli.shared import (
    OK,
    add_line_options,
    add_systems,
    can_draw,
    command,
    fresh_folder,
    quiet_warp,
    read_lines,
    results_in,
)
from warpriver.errors import InputError

if TYPE_CHECKING:
    from warpriver.calibration import Fit, Hindcast
    from warpriver.network import RiverNetwork

__all__ = ["add"]

CONSTANTS = ("migration_rate", "memory_length", "friction", "curvature_saturation")
PICTURES = ("fit.png", "map.png", "forecasts.png")


def add(commands: Any) -> None:
    """Add the command to the parser."""
    parser = command(
        commands,
        "calibrate",
        _calibrate,
        help="fit the constants of migration to dated surveys of a river",
        description="Read two or more surveys of one river, oldest first, and find the constants with which it moves\n"
        "from the first to the last: by simulating all the time between, with cutoffs left out of the score. Written\n"
        "are a scene to go on with (simulate DIR/scene.toml), tables, and pictures of where the fit is right and\n"
        "wrong. The constants of either half of the river are held against the other half; of three surveys or more,\n"
        "forecasts from the earlier ones are held against the later ones, beside no change and linear extrapolation.",
        epilog="examples:\n"
        "  warpriver calibrate 1987.gpkg 2017.gpkg --years 30 -o out/purus\n"
        "  warpriver calibrate 1987.csv 2017.csv --years 29.7 --width 240 --vary migration_rate -o out/jurua\n"
        "  warpriver calibrate 1986.csv 1991.csv 1996.csv --dates 1986 1991 1996 --leads 5 --width 390 -o out/mamore\n"
        "  warpriver simulate out/purus/scene.toml               # 30 years on, from the later survey",
    )
    parser.add_argument("surveys", nargs="+", metavar="SURVEY", help="river lines at each date, oldest first")
    parser.add_argument("-o", "--out", required=True, metavar="FOLDER", help="folder for the results")
    time = parser.add_argument_group("time")
    time.add_argument(
        "--years", type=number(above=0.0, unit="years"), metavar="YEARS", help="time between two surveys, in years"
    )
    time.add_argument(
        "--dates", type=number(unit="years"), nargs="+", metavar="YEAR", help="date of each survey, as 1987.78"
    )
    time.add_argument(
        "--leads",
        type=number(above=0.0, unit="years"),
        nargs="+",
        default=[1.0, 3.0, 5.0],
        metavar="YEARS",
        help="years ahead to forecast, with --dates of three surveys or more (default 1 3 5)",
    )
    time.add_argument(
        "--window",
        type=number(above=0.0, unit="years"),
        default=5.0,
        metavar="YEARS",
        help="years of an interval that forecasts are fitted to (default 5)",
    )
    fitted = parser.add_argument_group("what is fitted")
    fitted.add_argument(
        "--fit",
        choices=CONSTANTS,
        nargs="+",
        default=["migration_rate", "memory_length", "curvature_saturation"],
        metavar="NAME",
        help=f"constants to fit, of {', '.join(CONSTANTS)} (default: all but friction)",
    )
    fitted.add_argument(
        "--vary", choices=CONSTANTS, nargs="+", default=[], metavar="NAME", help="those of them that vary along a river"
    )
    fitted.add_argument(
        "--length",
        type=number(10.0, unit="widths"),
        default=50.0,
        metavar="WIDTHS",
        help="distance between the knots of what varies, in widths (default 50)",
    )
    fitted.add_argument(
        "--smoothing",
        type=number(0.0, unit="widths"),
        default=0.5,
        metavar="WIDTHS",
        help="standard deviation of the smoothing of the lines, in widths (default 0.5)",
    )
    fitted.add_argument("--no-offset", action="store_true", help="do not fit an offset between the surveys")
    lines = parser.add_argument_group("river lines")
    lines.add_argument(
        "--width", type=number(above=0.0, unit="m"), metavar="M", help="bankfull width in m (default: the files')"
    )
    add_line_options(lines)
    add_systems(lines, "a file")
    parser.add_argument("--device", default="cpu", help='"cpu", "cuda", "cuda:1" ... (default cpu)')


def _calibrate(options: argparse.Namespace) -> int:
    from warpriver import calibration

    dates = _dates(options)
    folder = fresh_folder(options.out, *calibration.FIT_FILES, calibration.FORECASTS, *PICTURES, make=False)
    quiet_warp()
    networks = [read_lines(Path(source), options, device=options.device) for source in options.surveys]
    fit = calibration.calibrate(
        networks[0],
        networks[-1],
        dates[-1] - dates[0],
        fit=options.fit,
        vary=options.vary,
        length=options.length,
        smoothing=options.smoothing,
        offset=not options.no_offset,
    )
    for line in str(fit).splitlines():
        say(line)
    with results_in(folder):
        told = [str(path) for path in calibration.write_fit(fit, folder, networks[-1])]
        past = _held_against(networks, dates, options)
        if past is not None:
            calibration.write_hindcast(past, folder / calibration.FORECASTS)
            told.append(str(folder / calibration.FORECASTS))
        told += _draw(fit, past, folder)
        for path in told:
            say(f"  written  {path}")
    return OK


def _dates(options: argparse.Namespace) -> list[float]:
    """The date of each survey; with --years the first is 0."""
    count = len(options.surveys)
    if count < 2:
        raise InputError(f"there is one survey, {options.surveys[0]}; give two or more, oldest first")
    if (options.years is None) == (options.dates is None):
        raise InputError("give --years between two surveys, or --dates of all of them")
    if options.years is not None:
        if count > 2:
            raise InputError(f"--years is for two surveys, and there are {count}; give --dates")
        return [0.0, options.years]
    if len(options.dates) != count:
        raise InputError(f"--dates has {len(options.dates)} years, and there are {count} surveys; give as many")
    if any(b <= a for a, b in zip(options.dates, options.dates[1:], strict=False)):
        raise InputError("--dates must rise: give the surveys oldest first")
    return list(options.dates)


def _held_against(networks: list[RiverNetwork], dates: list[float], options: argparse.Namespace) -> Hindcast | None:
    """Forecasts that the surveys allow, which are told; None where there are none."""
    from warpriver import calibration

    past = None
    for split in ("reach", "time"):
        if split == "time" and len(networks) < 3:
            continue
        try:
            past = calibration.hindcast(
                networks, dates, split=split, leads=options.leads, window=options.window, fit=options.fit,
                smoothing=options.smoothing,
            )  # fmt: skip
        except InputError as error:
            say(f"no forecasts by {split}: {error}")
            continue
        if split == "reach":
            for f in past.forecasts:
                say(
                    f"{f.part} half by the constants of the other: r {f.correlation:.3f}, mean misfit {f.distance:.1f} "
                    f"m (no change {f.no_change:.1f} m), {f.coverage:.0%} in the band of {f.band:.0f} m"
                )
        else:
            for line in str(past).splitlines():
                say(line)
    return past


def _draw(fit: Fit, past: Hindcast | None, folder: Path) -> list[str]:
    """Draw what can be drawn, and return the files."""
    if not can_draw():
        return []
    from warpriver import viz

    fit_picture, map_picture, forecast_picture = (folder / name for name in PICTURES)
    viz.draw_fit(fit, fit_picture)
    viz.draw_fit_map(fit, map_picture)
    if past is None or past.split != "time":
        return [str(fit_picture), str(map_picture)]
    viz.draw_hindcast(past, forecast_picture)
    return [str(fit_picture), str(map_picture), str(forecast_picture)]
