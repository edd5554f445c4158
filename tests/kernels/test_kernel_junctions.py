import math

import numpy as np
import pytest
import warp as wp
from kernel_arrays import REALS, SCALARS, channels_of, forms, share_out, starts_of, struct_of, to_device, unwritten

from warpriver.kernels import junctions
from warpriver.kernels.channels import Stems

SPACING, WIDTH, STEP, REACH = 20.0, 8.0, 0.4, 12.0
# Sums of coordinates of some hundred metres.
TOLERANCE = {"float64": 4e-12, "float32": 4e-4}


def random_forest(rng, count):
    """Lines that flow into each other: lines, the channel below each, and what it starts with, all by hand."""
    below = np.full(count, -1)
    arrivals = np.zeros(count, int)
    for c in range(1, count):
        d = int(rng.integers(0, c))
        if arrivals[d] < 2 and rng.random() < 0.9:
            below[c] = d
            arrivals[d] += 1
    lines = [None] * count
    for c in range(count):
        line = rng.uniform(-300.0, 300.0, 2) + np.cumsum(rng.normal(0.0, SPACING, (int(rng.integers(3, 30)), 2)), 0)
        if below[c] >= 0:
            line[-1] = lines[below[c]][0]
        lines[c] = line
    return lines, below, arrivals


def follow(line, shift, mouth):
    """A tributary whose mouth went by ``shift``: its last reach is taken along, and drawn towards its chord."""
    count = min(int(REACH * WIDTH / SPACING), (len(line) - 1) // 2)
    t = np.clip(1.0 - np.arange(len(line))[::-1] / max(count, 1), 0.0, 1.0)
    weight = (t * t * (3.0 - 2.0 * t))[:, None]
    moved = line + shift * weight
    base = line[-1 - count]
    moved += weight * min(np.hypot(*shift) / WIDTH, 1.0) * (base + t[:, None] * (mouth - base) - moved)
    moved[-1] = mouth
    return moved


def twin(lines, below, arrivals, drift, step, number, lesser, lead):
    """The same lines after the drift."""
    moved = [line.copy() for line in lines]
    for c, line in enumerate(lines):
        upper = np.flatnonzero(below == c)
        long = (len(line) - 1) * SPACING > 10.0 * WIDTH
        if number != 0 or not len(upper) or not long or step[c] == 0.0 or not (step[upper] > 0.0).all():
            continue
        along, speed = line[1] - line[0], drift[c]
        if lesser[c] >= 0:
            speed *= lead[lesser[c]]
            if speed < 0.0:
                other = lines[upper[upper != lesser[c]][0]]
                if (len(other) - 1) * SPACING <= 10.0 * WIDTH:
                    continue
                along, speed = other[-2] - line[0], -speed
        size = np.hypot(*along)
        moved[c][0] = line[0] + along / size * min(speed * STEP, 0.5 * size)
        shift = moved[c][0] - line[0]
        for u in upper:
            moved[u] = follow(moved[u], shift, moved[c][0])
    return moved


@pytest.mark.parametrize("number", [0, 1])
def test_drift_matches_the_twin(device, dtype, number):
    rng, scalar = np.random.default_rng(5), SCALARS[dtype]
    kernel, shifted = junctions.build(scalar), 0
    for _ in range(20):
        lines, below, arrivals = random_forest(rng, int(rng.integers(2, 25)))
        count = len(lines)
        drift, step = rng.uniform(0.0, 40.0, count), rng.choice([0.0, STEP, STEP, STEP, STEP], count)
        points = to_device(np.concatenate(lines).astype(REALS[dtype]), kernel.vec2, device)
        start = to_device(starts_of(lines), wp.int32, device)
        downstream, tributaries = (to_device(v.astype(np.int32), wp.int32, device) for v in (below, arrivals))
        lesser, beside = np.full(count, -1), np.full(count, -1)
        for c in np.flatnonzero(arrivals == 2):
            pair = np.flatnonzero(below == c)
            beside[pair] = pair[::-1]
            lesser[c] = pair[0] if rng.random() < 0.7 else -1
        lead = rng.uniform(-1.0, 1.0, count)
        meet = struct_of(
            kernel.Junctions, downstream=downstream, tributaries=tributaries, drift=to_device(drift, scalar, device),
            lesser=to_device(lesser.astype(np.int32), wp.int32, device),
            beside=to_device(beside.astype(np.int32), wp.int32, device),
        )  # fmt: skip
        form, spacing = forms(WIDTH, 1.0, np.full(count, WIDTH), SPACING, scalar, device), np.full(count, SPACING)
        spacing, steps = (to_device(v, scalar, device) for v in (spacing, step))
        channels = channels_of(scalar, start=start, form=form, spacing=spacing, step=steps)
        active, substep = wp.zeros(count, dtype=int, device=device), to_device([number, 3], wp.int32, device)
        wp.launch(kernel.count_active, count, [channels, meet], [active], device=device)
        shift = unwritten(count, kernel.vec2, device)
        inputs = [channels, points, share_out(1, count, 1, device)[0].work]
        wp.launch(kernel.settle_heads, count, inputs, [shift, points], device=device)
        assert not shift.numpy().any(), "no channel goes on in another one"
        inputs = [channels, meet, scalar(STEP), substep, active, to_device(lead, scalar, device)]
        wp.launch(kernel.shift_heads, count, inputs, [shift, points], device=device)
        wp.launch(kernel.follow_heads, count, [channels, meet, scalar(REACH), shift], [points], device=device)
        moves = np.hypot(*shift.numpy().T) > 0.0
        expected = np.concatenate(twin(lines, below, arrivals, drift, step, number, lesser, lead))
        np.testing.assert_allclose(points.numpy(), expected, atol=TOLERANCE[dtype], rtol=0.0)
        shifted += int(moves.sum())
        heads = starts_of(lines)
        for c in np.flatnonzero(below >= 0):
            if moves[below[c]]:
                np.testing.assert_array_equal(points.numpy()[heads[c + 1] - 1], points.numpy()[heads[below[c]]])
    assert shifted > 10 or number > 0


def test_heads_of_links_settle_where_the_link_upstream_ends(device, dtype):
    """And tributaries follow, as if it had drifted there; of the link upstream only the last point does."""
    rng, scalar = np.random.default_rng(7), SCALARS[dtype]
    kernel = junctions.build(scalar)
    node = np.array([100.0, 50.0])
    stem = node + np.arange(-20, 1)[:, None] * [SPACING, 3.0]
    lower = node + np.arange(21)[:, None] * [SPACING, -2.0]
    brook = node + np.arange(-20, 1)[:, None] * [3.0, SPACING]
    lines = [lower, stem, brook]
    start = to_device(starts_of(lines), wp.int32, device)
    before = to_device(np.concatenate(lines).astype(REALS[dtype]), kernel.vec2, device)
    moved = [line + rng.normal(0.0, 1.0, line.shape) for line in lines]
    moved[0][0], moved[2][-1] = lower[0], brook[-1]
    after = to_device(np.concatenate(moved).astype(REALS[dtype]), kernel.vec2, device)
    upper, down = (to_device(np.array(v, np.int32), wp.int32, device) for v in ([1, -1, -1], [-1, 0, -1]))
    channels = channels_of(
        scalar, start=start, form=forms(WIDTH, 1.0, np.full(3, WIDTH), SPACING, scalar, device),
        spacing=to_device(np.full(3, SPACING), scalar, device), stems=struct_of(Stems, upper=upper, lower=down),
    )  # fmt: skip
    meet = struct_of(kernel.Junctions, downstream=to_device(np.array([-1, 0, 0], np.int32), wp.int32, device))
    shift = unwritten(3, kernel.vec2, device)
    work = share_out(1, 3, 1, device)[0].work
    wp.launch(kernel.settle_heads, 3, [channels, before, work], [shift, after], device=device)
    wp.launch(kernel.follow_heads, 3, [channels, meet, scalar(REACH), shift], [after], device=device)
    found = np.split(after.numpy().astype(np.float64), starts_of(lines)[1:-1])
    expected = [moved[0].copy(), moved[1], follow(moved[2], moved[1][-1] - node, moved[1][-1])]
    expected[0][0] = moved[1][-1]
    for a, b in zip(found, expected, strict=True):
        np.testing.assert_allclose(a, b, atol=TOLERANCE[dtype], rtol=0.0)
    np.testing.assert_array_equal(found[0][0], found[1][-1])
    np.testing.assert_array_equal(found[0][0], found[2][-1])


# Of the templates: reach and straight end in widths, bend, least, free and most angle, rad.
SHAPE = {"reach": 6.0, "straight": 1.5, "bend": 0.1, "least": 0.8, "free": 1.3, "most": 2.1}


def toward(line, away):
    """Unit vector from the first point of a line to the place so far along it, at most half of it."""
    place = min(away / SPACING, 0.5 * (len(line) - 1))
    k = min(int(place), len(line) - 2)
    way = (k + 1 - place) * line[k] + (place - k) * line[k + 1] - line[0]
    return way / np.hypot(*way)


def turn(a, b):
    return math.atan2(a[0] * b[1] - a[1] * b[0], a @ b)


def aimed(own, other, lower, angle, width, width_below, goes_on):
    """Direction in which a tributary is to arrive, and the part of the speed with which its mouth is led.

    Where the river goes on through the node the angle is that to its course there, in the middle of its bend.
    """
    near = SHAPE["straight"] * width_below
    down, up, here = toward(lower, near), toward(other[::-1], near), toward(own[::-1], near)
    side = 1.0 if turn(down, here) % (2 * math.pi) <= turn(down, up) % (2 * math.pi) else -1.0
    c, s = math.cos(-side * angle), math.sin(-side * angle)
    course = (down - up) / np.hypot(*(down - up)) if goes_on else down
    aim = np.array([c * course[0] - s * course[1], s * course[0] + c * course[1]])
    bend = side * turn(-up, down) / SHAPE["straight"]
    lead = min(max(0.5 + 0.5 * bend / SHAPE["bend"], 0.0), 1.0)
    arrives = side * turn(-toward(own[::-1], 0.5 * SHAPE["reach"] * (width + width_below)), down)
    scale = SHAPE["free"] - SHAPE["least"]
    back = min(max((arrives - SHAPE["least"]) / scale, -1.0), 1.0)
    lead = min(lead, back) if back < 1.0 else lead
    onward = min((arrives - SHAPE["most"]) / scale, 1.0)
    return aim, max(lead, onward) if onward > 0.0 else lead


def through(device):
    """Stems of three channels of which the second goes on as the first."""
    links = {"upper": [1, -1, -1], "lower": [-1, 0, -1]}
    return struct_of(Stems, **{k: to_device(np.array(v, np.int32), wp.int32, device) for k, v in links.items()})


def shaped(line, aim, width, width_below, part):
    """A tributary whose last reach was drawn towards its template."""
    count = min(int(0.5 * SHAPE["reach"] * (width + width_below) / SPACING), (len(line) - 1) // 2)
    moved = line.copy()
    if count < 3:
        return moved
    end = min(SHAPE["straight"] * width_below, 0.5 * count * SPACING)
    base, leaving = line[-1 - count], line[-count] - line[-2 - count]
    leaving = leaving / np.hypot(*leaving)
    mouth = line[-1] - end * aim
    chord = np.hypot(*(mouth - base))
    for k in range(1, count):
        s = k / count * (chord + end)
        t = min(s / chord, 1.0)
        place = base + t * t * (3.0 - 2.0 * t) * (mouth - base)
        place += chord * t * (1.0 - t) * ((1.0 - t) * leaving - t * aim) + max(s - chord, 0.0) * aim
        moved[len(line) - 1 - count + k] += part * (place - moved[len(line) - 1 - count + k])
    return moved


@pytest.mark.parametrize("part", [0.3, 1.0])
def test_mouths_are_aimed_and_shaped_as_by_the_twin(device, dtype, part):
    """A river that bends to either side, and a tributary from any direction, wide or narrow."""
    rng, scalar = np.random.default_rng(11), SCALARS[dtype]
    kernel, sides, leads = junctions.build(scalar), set(), []
    for trial in range(40):
        node, along, heading, bend = rng.uniform(-300.0, 300.0, 2), np.arange(1, 41), rng.uniform(0, 6.28), rng.normal()
        widths = rng.uniform(5.0, 60.0, 3)
        river = heading + 0.02 * bend * np.arange(-40, 41)
        step = SPACING * np.stack([np.cos(river), np.sin(river)], axis=1)
        lower = node + np.concatenate([np.zeros((1, 2)), np.cumsum(step[41:], axis=0)])
        upper = (node - np.concatenate([np.zeros((1, 2)), np.cumsum(step[39::-1], axis=0)]))[::-1]
        way = heading + rng.uniform(0.3, 5.9) + np.cumsum(rng.normal(0.0, 0.05, 40))
        brook = np.stack([np.cos(way), np.sin(way)], axis=1)
        brook = node + np.concatenate([np.zeros((1, 2)), SPACING * np.cumsum(brook, axis=0)])[::-1]
        lines, angle = [lower, upper, brook[-len(along) :]], float(rng.uniform(0.3, 1.7))
        floats = {"angle": [-1.0, -1.0, angle], "ease": [0.0, 0.0, part / STEP]}
        whole = {"downstream": [-1, 0, 0], "beside": [-1, 2, 1]}
        meet = struct_of(
            kernel.Junctions,
            **{name: to_device(np.array(v), scalar, device) for name, v in floats.items()},
            **{name: to_device(np.array(v, np.int32), wp.int32, device) for name, v in whole.items()},
        )
        mouths = kernel.Template()
        for name, value in SHAPE.items():
            setattr(mouths, name, value)
        points = to_device(np.concatenate(lines).astype(REALS[dtype]), kernel.vec2, device)
        channels = channels_of(
            scalar, start=to_device(starts_of(lines), wp.int32, device),
            form=forms(widths, 1.0, widths, SPACING, scalar, device),
            spacing=to_device(np.full(3, SPACING), scalar, device), step=to_device(np.full(3, STEP), scalar, device),
            **({"stems": through(device)} if trial % 2 else {}),
        )  # fmt: skip
        aim, lead = unwritten(3, kernel.vec2, device), unwritten(3, scalar, device)
        work = share_out(1, 3, 1, device)[0].work
        wp.launch(kernel.aim_mouths, 3, [channels, meet, mouths, work, points], [aim, lead], device=device)
        wp.launch(kernel.shape_mouths, 3, [channels, meet, mouths, aim], [points], device=device)
        expected, part_led = aimed(lines[2], upper, lower, angle, widths[2], widths[0], trial % 2 == 1)
        np.testing.assert_allclose(aim.numpy(), [[0, 0], [0, 0], expected], atol=10 * TOLERANCE[dtype], rtol=0.0)
        np.testing.assert_allclose(lead.numpy(), [0, 0, part_led], atol=100 * TOLERANCE[dtype], rtol=0.0)
        moved = np.concatenate([lower, upper, shaped(lines[2], expected, widths[2], widths[0], part)])
        np.testing.assert_allclose(points.numpy(), moved, atol=10 * TOLERANCE[dtype], rtol=0.0)
        sides.add(turn(expected, lower[1] - node) > 0.0)
        leads.append(part_led)
    assert sides == {True, False} and min(leads) < 0.0 and max(leads) == 1.0


def eased(upper, lower, reach, width, part):
    """The lines above and below a locked point after they were drawn towards two cubics that meet there."""
    above = min(int(reach * width / SPACING), (len(upper) - 4) // 2)
    below = min(int(reach * width / SPACING), (len(lower) - 4) // 2)
    upper, lower, lock = upper.copy(), lower.copy(), upper[-1]
    a, b = lock - upper[-2], lower[1] - lock
    bend = 2.0 * abs(turn(a, b)) / (np.hypot(*a) + np.hypot(*b))
    part *= min(max(2.0 * bend * width - 1.0, 0.0), 1.0)
    base, end = upper[-1 - above], lower[below]
    into, out = upper[-above] - upper[-2 - above], lower[below + 1] - lower[below - 1]
    before, after = lock - base, end - lock
    size_before, size_after = np.hypot(*before), np.hypot(*after)
    through = before * size_after / size_before + after * size_before / size_after
    into, out, through = (v / np.hypot(*v) for v in (into, out, through))

    def cubic(p, q, leaving, arriving, t):
        way, u = q - p, 1.0 - t
        return p + t * t * (3.0 - 2.0 * t) * way + np.hypot(*way) * t * u * (u * leaving - t * arriving)

    for k in range(1, above):
        j = len(upper) - 1 - above + k
        upper[j] += part * (cubic(base, lock, into, through, k / above) - upper[j])
    for k in range(1, below):
        lower[k] += part * (cubic(lock, end, through, out, k / below) - lower[k])
    return upper, lower


def test_corners_at_locked_points_are_rounded_as_by_the_twin(device, dtype):
    rng, scalar, moved = np.random.default_rng(3), SCALARS[dtype], []
    kernel = junctions.build(scalar)
    for _ in range(30):
        counts, heading = rng.integers(12, 60, 2), rng.uniform(0.0, 6.28)
        corner, width = rng.choice([0.0, rng.normal(0.0, 1.0)]), rng.uniform(10.0, 60.0)
        way = heading + np.cumsum(rng.normal(0.0, 0.05, counts.sum())) + corner * (np.arange(counts.sum()) >= counts[0])
        step = SPACING * np.stack([np.cos(way), np.sin(way)], axis=1)
        xy = rng.uniform(-300.0, 300.0, 2) + np.concatenate([np.zeros((1, 2)), np.cumsum(step, axis=0)])
        lines = [xy[: counts[0] + 1], xy[counts[0] :]]
        points = to_device(np.concatenate(lines).astype(REALS[dtype]), kernel.vec2, device)
        integers = {"upper": [-1, 0], "lower": [1, -1], "held": [1, 0]}
        channels = channels_of(
            scalar, start=to_device(starts_of(lines), wp.int32, device),
            form=forms(np.full(2, width), 1.0, np.full(2, width), SPACING, scalar, device),
            spacing=to_device(np.full(2, SPACING), scalar, device), step=to_device(np.full(2, STEP), scalar, device),
            stems=struct_of(
                Stems, **{name: to_device(np.array(v, np.int32), wp.int32, device) for name, v in integers.items()}
            ),
        )  # fmt: skip
        work, ease = share_out(1, 2, 1, device)[0].work, to_device(np.full(2, 0.7), scalar, device)
        wp.launch(kernel.ease_locks, 2, [channels, scalar(5.0), work, ease], [points], device=device)
        expected = np.concatenate(eased(*lines, 5.0, width, 0.7 * STEP))
        np.testing.assert_allclose(points.numpy(), expected, atol=10 * TOLERANCE[dtype], rtol=0.0)
        moved.append((abs(corner) > 0.5, np.abs(expected - np.concatenate(lines)).max() > 0.1))
    assert all(corner == far for corner, far in moved if corner) and any(corner for corner, _ in moved)
    assert not all(far for _, far in moved), "what does not bend sharply is left"
