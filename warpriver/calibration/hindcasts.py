"""Hindcasts: what forecasts would have been worth, by surveys that were not used to make them."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt
import warp as wp
from numpy.typing import NDArray

from warpriver.arrays import FloatArray
from warpriver.calibration.courses import Lines
from warpriver.calibration.fits import NAMES, Fit, checked_names, fit_observed, measured_law
from warpriver.calibration.observed import Observed, Survey, match_all, observe, survey
from warpriver.errors import InputError
from warpriver.extras import IMPORTING
from warpriver.metrics.lines import arc_length_of, norm
from warpriver.network import RiverNetwork
from warpriver.params import MeanderParams
from warpriver.public import public
from warpriver.simulation import Simulation
from warpriver.validate import floats, not_negative, one_of, positive, shown

__all__ = ["Forecast", "Hindcast", "Score", "hindcast", "nearest_distances"]

# Surveys of another age than was asked for, as a fraction of it, and in years.
AGE_TOLERANCE, MOST_TOLERANCE = 0.25, 0.5
# Fits of several intervals count by their uncertainty, and at most as if it were this: rivers change.
DRIFT = 0.15
# Bands follow how far the river is said to move in so many classes, each of as many points.
CLASSES = 5
# Distances are measured to points so close together along a line.
FINE = 0.05  # widths
# A step of the simulation is at most that of its parameters; at least one a year of forecast.
ENOUGH_SURVEYS = 3


@dataclasses.dataclass(frozen=True)
class Forecast:
    """A forecast, beside the two that need no model, held against a later survey.

    Distances are means over the points of the survey to come, along the river but not near cutoffs, nor near its ends.

    Attributes:
        begin: Date of the survey that it begins at, yr.
        end: Date of the survey that it is held against, yr.
        part: "all", or "upper" or "lower": the half of the river that it was held against, the other having been used.
        distance: Mean distance to the forecast line, m.
        no_change: Mean distance to the line that it began at, m.
        linear: Mean distance to the line moved on at the rate of the years before, m; nan where it is not known.
        coverage: Part of the points within the band around the forecast line.
        band: Mean half-width of the band, m.
        correlation: Pearson's r of displacements, where it was computed (by half of the reach), else nan.
        params: What was simulated with.
    """

    begin: float
    end: float
    part: str
    distance: float
    no_change: float
    linear: float
    coverage: float
    band: float
    correlation: float
    params: MeanderParams

    @property
    def lead(self) -> float:
        """Time from the first survey to the one that was forecast, yr."""
        return self.end - self.begin


@dataclasses.dataclass(frozen=True)
class Score:
    """Means over forecasts of one lead; skills are 1 - distance / that of the other forecast.

    Attributes:
        lead: Years ahead.
        count: How many forecasts there were.
        distance: Mean distance of the forecasts, m.
        no_change: That of no change, m.
        linear: That of linear extrapolation, m, nan where there is none.
        coverage: Mean part of the points within the bands.
    """

    lead: float
    count: int
    distance: float
    no_change: float
    linear: float
    coverage: float

    @property
    def skill_over_no_change(self) -> float:
        """1 where forecasts are perfect, 0 where no change is as good."""
        return 1.0 - self.distance / self.no_change

    @property
    def skill_over_linear(self) -> float:
        """1 where forecasts are perfect, 0 where linear extrapolation is as good."""
        return 1.0 - self.distance / self.linear


@dataclasses.dataclass(frozen=True)
class Hindcast:
    """Forecasts from the surveys before them, and what they were worth.

    Attributes:
        forecasts: One for each survey that began one and each lead.
        leads: Years ahead that were asked for.
        level: Part of the points that bands are made to hold.
        split: "time" or "reach".
    """

    forecasts: tuple[Forecast, ...]
    leads: tuple[float, ...]
    level: float
    split: str

    def score(self, lead: float) -> Score:
        """Means over the forecasts of one of the leads."""
        found = [f for f in self.forecasts if self.nearest_lead(f.lead) == lead]
        if not found:
            raise InputError(f"there are no forecasts of {shown(lead)} yr; there are some of {self.leads}")
        means = [
            float(np.mean([getattr(f, name) for f in found]))
            for name in ("distance", "no_change", "linear", "coverage")
        ]
        return Score(lead, len(found), *means)

    def nearest_lead(self, lead: float) -> float:
        """The lead that was asked for to which a time is nearest."""
        return min(self.leads, key=lambda each: abs(each - lead))

    def __str__(self) -> str:
        rows = ["lead, yr  forecasts  distance, m  no change  linear  in the band"]
        for lead in self.leads:
            if any(self.nearest_lead(f.lead) == lead for f in self.forecasts):
                s = self.score(lead)
                linear = "-" if math.isnan(s.linear) else f"{s.linear:.1f}"
                rows.append(
                    f"{lead:8.3g}  {s.count:9}  {s.distance:11.1f}  {s.no_change:9.1f}  {linear:>6}  {s.coverage:10.0%}"
                )
        return "\n".join(rows)


@public
def hindcast(
    networks: Sequence[RiverNetwork],
    dates: npt.ArrayLike,
    *,
    split: str = "time",
    leads: Sequence[float] = (1.0, 3.0, 5.0),
    window: float = 5.0,
    level: float = 0.9,
    params: MeanderParams | None = None,
    fit: Sequence[str] = NAMES,
    smoothing: float = 0.5,
) -> Hindcast:
    """Forecast surveys of a river from those before them, and tell what the forecasts are worth.

    By time, a forecast begins at each survey that has others ``window`` years and more before it. The constants are
    fitted to these alone, interval by interval back in time, and the river is simulated from there, cutoffs included.
    By reach, the constants are fitted to one half of the river, first to last survey, and held against the other half.

    Beside each forecast stand two without a model: no change, and linear extrapolation, by which each point goes on as
    it did in the window before. Bands are made of how far earlier forecasts of that lead missed, by how far they moved
    the river: they hold ``level`` of the points if errors stay as they were [Lei2018].

    Example::

        past = wr.hindcast(networks, dates=[1986, 1987, 1988, ...], leads=(1, 3, 5))
        print(past)                                        # mean distances by lead, beside no change and linear
        past.score(5).skill_over_no_change

    Args:
        networks: Surveys of one river, in the order of time, with widths, on the same coordinates.
        dates: Their dates in years, such as 1987.78.
        split: "time" or "reach".
        leads: Years ahead, by time.
        window: Years of an interval that constants are fitted to, and that linear extrapolation goes back.
        level: Part of the points that bands are to hold.
        params: As for :func:`calibrate`.
        fit: Constants to fit, as for :func:`calibrate`.
        smoothing: As for :func:`calibrate`.

    Returns:
        The forecasts and their scores.

    Raises:
        TypeError: An argument is of another kind.
        ValueError: Fewer than two surveys, or three by time; dates that do not rise; no survey that has others a window
            before it, and one of the leads after it; surveys that cannot be compared, as :func:`calibrate` tells.
    """
    one_of(split, "split", ("time", "reach"))
    surveys = list(networks)
    for network in surveys:
        if not isinstance(network, RiverNetwork):
            raise InputError(f"networks holds a {type(network).__name__}; give a RiverNetwork for each date")
    times = floats(dates, "dates", "one date in years for each network")
    least = ENOUGH_SURVEYS if split == "time" else 2
    if times.shape != (len(surveys),) or len(surveys) < least:
        raise InputError(
            f"there are {len(surveys)} networks and dates of shape {times.shape}; give as many of both, {least} or more"
        )
    if not np.isfinite(times).all() or not (np.diff(times) > 0.0).all():
        raise InputError(f"dates are {shown(times.tolist())}; they must be years that rise")
    names = checked_names(fit, ())[0]
    if not 0.0 < positive(level, "level") < 1.0:
        raise InputError(f"level is {shown(level)}; give a fraction between 0 and 1")
    ahead = tuple(positive(lead, "leads", "yr") for lead in leads)
    if not ahead:
        raise InputError("leads is empty; give years ahead, such as (1, 3, 5)")
    smoothing = not_negative(smoothing, "smoothing", "widths")
    law = (params or measured_law()).for_widths(surveys[0].channel_width)
    lines = [survey(network, f"networks[{k}]", smoothing) for k, network in enumerate(surveys)]
    device = surveys[0].device
    if split == "reach":
        return _by_reach(lines[0], lines[-1], (times[0], times[-1]), law, names, level, device)
    run = _ByTime(lines, times, law, names, positive(window, "window", "yr"), level, device)
    return Hindcast(tuple(run.forecasts(ahead)), ahead, level, split)


# ---- by half of the reach


def _by_reach(
    first: Survey, last: Survey, dates: tuple[float, float], law: MeanderParams, names: Sequence[str], level: float,
    device: wp.DeviceLike,
) -> Hindcast:  # fmt: skip
    years = float(dates[1] - dates[0])
    whole, forecasts = observe(first, last, years), []
    halves = _upper_half(first.lines)
    for part, used in (("lower", halves), ("upper", ~halves)):
        fitted = fit_observed(dataclasses.replace(whole, scored=whole.scored & used), law, names, device=device)
        held = whole.scored & ~used & np.isfinite(fitted.predicted) & np.isfinite(fitted.observed)
        if not held.any():
            raise InputError(f"nothing of the {part} half of the river can be scored; give a longer reach")
        miss, moved = np.abs(fitted.observed - fitted.predicted), np.abs(fitted.predicted)
        width = _band(moved[fitted.scored], miss[fitted.scored], level)(moved[held])
        forecasts.append(
            Forecast(
                *dates,
                part,
                float(miss[held].mean()),
                float(np.abs(fitted.observed[held]).mean()),
                math.nan,
                float((miss[held] <= width).mean()),
                float(width.mean()),
                float(np.corrcoef(fitted.predicted[held], fitted.observed[held])[0, 1]),
                fitted.params,
            )
        )
    return Hindcast(tuple(forecasts), (years,), level, "reach")


def _upper_half(lines: Lines) -> NDArray[np.bool_]:
    counts = np.diff(lines.start)
    return np.concatenate([np.arange(n) < n // 2 for n in counts])


# ---- by time


@dataclasses.dataclass(frozen=True)
class _Made:
    """A forecast line and what came: by points of the survey to come, all that are scored.

    Attributes:
        distance: Distance to the forecast line, m.
        moved: How far the forecast had moved the river there, m.
        no_change: Distance to the line that it began at, m.
        linear: Distance to the line by linear extrapolation, m; nan where there is none.
    """

    distance: FloatArray
    moved: FloatArray
    no_change: FloatArray
    linear: FloatArray


class _ByTime:
    """Forecasts of surveys, each from what was known where it begins."""

    def __init__(
        self, surveys: list[Survey], times: FloatArray, law: MeanderParams, names: Sequence[str], window: float,
        level: float, device: wp.DeviceLike,
    ):  # fmt: skip
        self._surveys, self._times, self._law, self._names = surveys, times, law, tuple(names)
        self._window, self._level, self._device = window, level, device
        self._fits: dict[tuple[int, int], Fit] = {}
        self._params: dict[int, MeanderParams] = {}
        self._made: dict[tuple[int, int], _Made] = {}
        known = [k for k in range(len(times)) if self._back(k) is not None]
        if not known:
            raise InputError(
                f"no survey has another {window:g} yr before it: dates run from {times[0]:g} to {times[-1]:g}; give a "
                "shorter window, or more surveys"
            )
        self._first = known[0]

    def forecasts(self, leads: Sequence[float]) -> list[Forecast]:
        """All forecasts that begin where something is known."""
        found = []
        for begin, lead in itertools.product(range(self._first, len(self._times)), leads):
            end = self._ahead(begin, lead)
            if end is not None and self._back(begin) is not None:
                found.append(self._forecast(begin, end, lead))
        if not found:
            raise InputError(
                f"no survey lies {' or '.join(f'{lead:g}' for lead in leads)} yr after one that has others before it; "
                "give other leads, or a shorter window"
            )
        return found

    def _forecast(self, begin: int, end: int, lead: float) -> Forecast:
        made = self._make(begin, end)
        width = self._band_of(begin, lead)(made.moved)
        linear = float(made.linear.mean())
        return Forecast(
            float(self._times[begin]),
            float(self._times[end]),
            "all",
            float(made.distance.mean()),
            float(made.no_change.mean()),
            linear,
            float((made.distance <= width).mean()),
            float(width.mean()),
            math.nan,
            self._params_at(begin),
        )

    def _back(self, k: int) -> int | None:
        """The latest survey that is a window before another one."""
        found = np.flatnonzero(self._times <= self._times[k] - self._window + 1e-6)
        return int(found[-1]) if len(found) else None

    def _ahead(self, k: int, lead: float) -> int | None:
        """The survey whose time is nearest to so many years after another one."""
        away = np.abs(self._times - self._times[k] - lead)
        best = int(away.argmin())
        return best if best > k and away[best] <= min(AGE_TOLERANCE * lead, MOST_TOLERANCE) else None

    def _params_at(self, k: int) -> MeanderParams:
        """Constants by all intervals up to a survey, back in time; before the first that is known, those of it."""
        k = max(k, self._first)
        if k not in self._params:
            logs, weights, end = [], [], k
            while (begin := self._back(end)) is not None:
                fitted = self._fit(begin, end)
                logs.append([math.log(fitted.constants[name]) for name in self._names])
                weights.append([1.0 / (fitted.log_error[name] ** 2 + DRIFT**2) for name in self._names])
                end = begin
            mean = np.average(np.array(logs), axis=0, weights=np.array(weights))
            values = dict(zip(self._names, np.exp(mean).tolist(), strict=True))
            self._params[k] = self._law.replace(**values)
        return self._params[k]

    def _fit(self, begin: int, end: int) -> Fit:
        if (begin, end) not in self._fits:
            years = float(self._times[end] - self._times[begin])
            observed = observe(self._surveys[begin], self._surveys[end], years)
            self._fits[begin, end] = fit_observed(observed, self._law, self._names, device=self._device)
        return self._fits[begin, end]

    def _make(self, begin: int, end: int) -> _Made:
        """A forecast by what was known where it begins, and how far what came is from it."""
        if (begin, end) not in self._made:
            start, target = self._surveys[begin], self._surveys[end]
            years = float(self._times[end] - self._times[begin])
            seen: Observed = observe(target, start, years)
            points = target.lines.xy[seen.scored]
            gap = FINE * float(start.lines.mean_width().mean())
            forecast = _fine(_simulated(start, self._params_at(begin), years, self._device), gap)
            still = _fine(start.polylines(), gap)
            distance, nearest = _nearest(points, forecast)
            moved = _nearest(forecast, still)[0]
            back = self._back(begin)
            linear = np.full(len(points), math.nan)
            if back is not None:
                linear = _nearest(points, _fine(self._extrapolated(back, begin, years), gap))[0]
            self._made[begin, end] = _Made(distance, moved[nearest], _nearest(points, still)[0], linear)
        return self._made[begin, end]

    def _extrapolated(self, back: int, begin: int, years: float) -> list[FloatArray]:
        """Lines that go on as they did since an earlier survey; where that is not known they stay."""
        start = self._surveys[begin]
        past = observe(start, self._surveys[back], years)
        # Seen from the later survey, the earlier one lies on the other side.
        since = -np.nan_to_num(np.concatenate([match.distance for match in match_all(start.lines, past.after)]))
        part = years / float(self._times[begin] - self._times[back])
        moved = start.lines.xy + past.normal * (since * part)[:, None]
        return np.split(moved, start.lines.start[1:-1])

    def _band_of(self, begin: int, lead: float) -> Callable[[FloatArray], FloatArray]:
        """Half-width of the band of a forecast, by those whose outcome was known where it begins."""
        for known in sorted({lead, *self._spans(begin)}, key=lambda span: abs(span - lead)):
            pairs = [(k, self._ahead(k, known)) for k in range(begin)]
            past = [self._make(k, end) for k, end in pairs if end is not None and end <= begin]
            if past:
                moved = np.concatenate([made.moved for made in past])
                missed = np.concatenate([made.distance for made in past])
                inner, factor = _band(moved, missed, self._level), max(1.0, lead / known)
                return lambda values: factor * inner(values)
        raise InputError("no earlier forecast tells how far this one may be off")

    def _spans(self, begin: int) -> list[float]:
        """Times between surveys up to one of them."""
        return [float(b - a) for a, b in itertools.combinations(self._times[: begin + 1], 2)]


def _simulated(start: Survey, params: MeanderParams, years: float, device: wp.DeviceLike) -> list[FloatArray]:
    """Lines of a survey after so many years, in steps that divide them evenly."""
    lines, cut = start.lines, start.lines.start[1:-1]
    network = RiverNetwork.from_polylines(
        np.split(lines.xy, cut), np.split(lines.width, cut), np.split(lines.depth, cut), crs=start.crs, device=device
    )
    steps = math.ceil(years / params.time_step)
    # Steps are counted: the end is that of the last one.
    simulation = Simulation(network, params.replace(time_step=years / steps))
    simulation.step(steps)
    return simulation.network.polylines()


def _fine(polylines: list[FloatArray], gap: float) -> FloatArray:
    """Points of lines, so close together that the nearest one is as good as the nearest place."""
    parts = []
    for xy in polylines:
        s = arc_length_of(xy)
        t = np.linspace(0.0, s[-1], max(2, math.ceil(s[-1] / gap)) + 1)
        parts.append(np.column_stack([np.interp(t, s, xy[:, 0]), np.interp(t, s, xy[:, 1])]))
    return np.concatenate(parts)


def nearest_distances(points: FloatArray, polylines: list[FloatArray], gap: float = 20.0) -> FloatArray:
    """Distance of points to lines, (n,), m, measured to points of these ``gap`` m apart."""
    return _nearest(points, _fine(polylines, gap))[0]


def _nearest(points: FloatArray, others: FloatArray) -> tuple[FloatArray, NDArray[np.intp]]:
    with IMPORTING:
        from scipy.spatial import cKDTree

    index = cKDTree(others).query(points)[1]
    return norm(others[index] - points), index


def _band(moved: FloatArray, missed: FloatArray, level: float) -> Callable[[FloatArray], FloatArray]:
    """The quantile of misses by how far the river was said to move: that of classes, linear in between."""
    order = np.argsort(moved, kind="stable")
    classes = np.array_split(order, CLASSES) if len(order) >= 20 * CLASSES else [order]
    middle = np.array([np.median(moved[part]) for part in classes])
    width = np.array([np.quantile(missed[part], level) for part in classes])
    return lambda values: np.interp(values, middle, width)
