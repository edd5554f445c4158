"""``widen_points`` against its twin and its closed forms, however the points are dealt out."""

import numpy as np
import pytest
import warp as wp
from kernel_arrays import (
    DEALS,
    SCALARS,
    channels_of,
    forms,
    points_of,
    share_out,
    starts_of,
    struct_of,
    to_device,
    vec2_of,
)

from warpriver.kernels import widths

LAG, TIME, CAP = 0.3, 10.0, 2.0
POWER = 1.41  # w = 18.8 d^1.41 [Konsoer2013]


def twin(xy, moved, section, form, step):
    """Places and widths after a sub-step of one channel; ``form`` has its width, depth and greatest width."""
    size = np.hypot(*(moved - xy).T)
    rest = form[0] * (section[:, 1] / form[1]) ** POWER
    goal = np.minimum(rest + LAG * TIME * size / step, np.minimum(CAP * rest, np.maximum(form[2], rest)))
    width = goal + (section[:, 0] - goal) * np.exp(-step / TIME)
    with np.errstate(divide="ignore", invalid="ignore"):
        outer = np.where(size > 0.0, (size - 0.5 * (width - section[:, 0])) / size, 1.0)
    return xy + outer[:, None] * (moved - xy), width


def widened(lines, ways, sections, form, step, *, deal="one slab", device="cpu", dtype="float64"):
    """Places and widths after a sub-step, by the kernel."""
    scalar, count = SCALARS[dtype], len(lines)
    kernel, vec2 = widths.build(scalar), vec2_of(scalar)
    xy, section = np.concatenate(lines), np.concatenate(sections)
    width, depth, widest = np.array(form).T
    arrays = {"spacing": np.full(count, 20.0), "step": np.broadcast_to(step, count)}
    arrays = {name: to_device(values, scalar, device) for name, values in arrays.items()}
    start = to_device(starts_of(lines), int, device)
    channels = channels_of(scalar, start=start, form=forms(width, depth, widest, width, scalar, device), **arrays)
    sections = [to_device(section, vec2, device) for _ in range(2)]
    points = points_of(scalar, to_device(xy, vec2, device), sections[0])
    moved = points_of(scalar, to_device(xy + np.concatenate(ways), vec2, device), sections[1])
    struct = struct_of(kernel.Widening, lag=LAG, time=TIME, widest=CAP)
    for part in share_out(deal, count, len(xy), device):
        wp.launch(kernel.widen_points, part.threads, [channels, points, struct, part.work, moved], [], device=device)
    return moved.xy.numpy().astype(np.float64), moved.section.numpy().astype(np.float64)


@pytest.mark.parametrize("deal", DEALS)
def test_widths_and_places_are_those_of_the_twin_and_channels_that_rest_stay(deal, device, dtype):
    rng = np.random.default_rng(6)
    counts, form = (30, 17, 9), [(40.0, 2.0, 80.0), (25.0, 1.2, 30.0), (60.0, 3.0, 120.0)]
    lines = [np.cumsum(rng.normal([20.0, 0.0], 3.0, (n, 2)), axis=0) for n in counts]
    ways = [rng.normal(0.0, 3.0, (n, 2)) for n in counts]
    ways[0][::5] = 0.0
    sections = [
        np.stack([w * rng.uniform(0.9, 1.9, n), d * rng.uniform(0.8, 1.2, n)], axis=1)
        for n, (w, d, _) in zip(counts, form, strict=True)
    ]
    step = np.array([0.3, 2.0, 0.0])
    xy, section = widened(lines, ways, sections, form, step, deal=deal, device=device, dtype=dtype)
    tolerance = 1e-9 if dtype == "float64" else 1e-3
    begin = 0
    for line, way, own, shape, dt in zip(lines, ways, sections, form, step, strict=True):
        part = slice(begin, begin + len(line))
        place, width = (line + way, own[:, 0]) if dt == 0.0 else twin(line, line + way, own, shape, dt)
        np.testing.assert_allclose(xy[part], place, atol=tolerance)
        np.testing.assert_allclose(section[part, 0], width, atol=tolerance)
        np.testing.assert_allclose(section[part, 1], own[:, 1], rtol=1e-6)
        begin += len(line)


def test_a_bend_that_migrates_steadily_widens_by_lag_rate_time_and_then_moves_by_the_law():
    """W0 + lag E T (1 - e^(-t/T)), E 2 m/yr, in steps of any length; the outer bank goes E t all along."""
    for step, count in ((0.25, 80), (5.0, 4)):
        line, section, way = np.zeros((1, 2)), np.array([[40.0, 2.0]]), np.array([[0.0, 2.0 * step]])
        for _ in range(count):
            line, section = widened([line], [way], [section], [(40.0, 2.0, 80.0)], step)
        gained = LAG * 2.0 * TIME * (1.0 - np.exp(-20.0 / TIME))
        assert section[0, 0] == pytest.approx(40.0 + gained, rel=1e-12)
        assert line[0, 1] + 0.5 * section[0, 0] == pytest.approx(20.0 + 40.0, rel=1e-12)
    # Once it has its width the middle moves as the outer bank does.
    steady = np.array([[40.0 + LAG * 2.0 * TIME, 2.0]])
    place, after = widened([np.zeros((1, 2))], [np.array([[0.0, 2.0]])], [steady], [(40.0, 2.0, 80.0)], 1.0)
    assert after[0, 0] == pytest.approx(steady[0, 0]) and place[0, 1] == pytest.approx(2.0)


def test_a_reach_at_rest_goes_back_to_its_width():
    section = np.array([[60.0, 2.0]])
    for _ in range(7):
        place, section = widened([np.zeros((1, 2))], [np.zeros((1, 2))], [section], [(40.0, 2.0, 80.0)], 1.0)
    assert section[0, 0] == pytest.approx(40.0 + 20.0 * np.exp(-0.7), rel=1e-12) and (place == 0.0).all()
