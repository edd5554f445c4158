"""``wr.meander.migration_rate`` against the float64 twins, closed forms, and what a step of a simulation does."""

import numpy as np
import pytest
import reference
import reference_rings
from data_folder import data_folder
from plain import plain_params

import warpriver as wr

TWIN = {"float64": 1e-9, "float32": 2e-3}  # of the greatest rate


def even_meander(count=120, spacing=25.0):
    """Even points on a sine-generated line."""
    return wr.generate.sine_generated(12.0 * spacing * 3.0, 1.2, count // 36 + 1, spacing)[:count]


def even_ring(count=90, radius=400.0):
    """Points on a wavy ring, even to a part in 1e12."""
    angle = np.linspace(0.0, 2.0 * np.pi, 20_001)
    wavy = (radius * (1.0 + 0.15 * np.cos(3.0 * angle)))[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(wavy, axis=0).T))])
    at = np.linspace(0.0, arc[-1], count + 1)[:-1]
    return np.stack([np.interp(at, arc, column) for column in wavy.T], axis=1)


def twin(xy, closed, width, depth, params, mean_width):
    """Rates by the twin, the push from upstream damped at both ends over so many mean widths."""
    law = reference.Law(
        friction=params.friction,
        memory_length=params.memory_length,
        curvature_saturation=params.curvature_saturation,
        scale_local=int(params.sinuosity_scaling == "whole"),
        scale_upstream=int(params.sinuosity_scaling != "none"),
        end_damping=params.end_damping,
    )
    if closed:
        spacing = reference_rings.segments(xy).mean()
        return reference_rings.migration_rate(xy, spacing, width, depth, law)
    spacing = np.linalg.norm(np.diff(xy, axis=0), axis=1).mean()
    return reference.migration_rate(xy, spacing, width, depth, law, mean_width)


@pytest.mark.parametrize("dtype", TWIN)
@pytest.mark.parametrize("varying", [False, True])
@pytest.mark.parametrize("scaling", ["upstream", "whole", "none"])
@pytest.mark.parametrize("felt", [{}, {"memory_length": 2.5, "curvature_saturation": 0.2}], ids=["law", "saturated"])
def test_rates_are_those_of_the_twins(dtype, varying, scaling, felt, device):
    lines, closed = [even_meander(), even_ring() + [5000.0, 0.0]], [False, True]
    section = [(30.0 + 8.0 * np.sin(np.arange(len(xy)) / 7.0), 2.0 + np.cos(np.arange(len(xy)) / 9.0)) for xy in lines]
    if not varying:
        section = [(np.full(len(xy), 40.0 + 5.0 * c), np.full(len(xy), 2.5)) for c, xy in enumerate(lines)]
    width, depth = ([part[k] for part in section] for k in (0, 1))
    network = wr.RiverNetwork.from_polylines(lines, width, depth, closed=closed, dtype=dtype, device=device)
    before = network.points()
    params = plain_params(sinuosity_scaling=scaling, reference_width=0.0, **felt)
    rates = wr.meander.migration_rate(network, params)
    np.testing.assert_array_equal(network.points(), before)
    for rate, xy, ring, w, d in zip(rates, lines, closed, width, depth, strict=True):
        expected = twin(xy, ring, w, d, params, w.mean())
        assert rate.dtype == np.float64 and rate.shape == (len(xy),)
        np.testing.assert_allclose(rate, expected, rtol=0.0, atol=TWIN[dtype] * abs(expected).max())


@pytest.mark.parametrize("turn", [1, -1])
def test_a_circle_grows_at_the_closed_form(turn, device):
    """R' = k w (gamma - 1) / R all round, outward: to the right of a ring that turns left."""
    radius, width, params = 500.0, 40.0, plain_params(upstream_weight=2.5, sinuosity_scaling="none")
    angle = turn * 2.0 * np.pi * np.arange(400) / 400
    xy = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    network = wr.RiverNetwork.from_polylines([xy], width, closed=True, device=device)
    (rate,) = wr.meander.migration_rate(network, params)
    np.testing.assert_allclose(rate, turn * params.migration_rate * width * 1.5 / radius, rtol=1e-9)


def test_a_bend_to_the_left_moves_to_the_right_by_the_upstream_term_and_to_the_left_by_the_local_one(device):
    """Positive to the right of the flow: the normal times the rate is what a short step does to the points."""
    line = even_meander()
    params = plain_params(spacing=25.0, time_step=1e-4, cutoff_distance=0.0)
    network = wr.RiverNetwork.from_polylines([line], 40.0, device=device)
    (rate,) = wr.meander.migration_rate(network, params)
    sim = wr.Simulation(network, params, device=device)
    start = sim.network.polylines()[0]
    sim.step()
    normal = reference.right_normals(start)
    # Resampling moves points along the line only, up to rounding.
    across = ((sim.network.polylines()[0] - start)[1:-1] * normal).sum(axis=1) / params.time_step
    np.testing.assert_allclose(across, rate[1:-1], atol=0.01 * abs(rate).max())
    local = wr.meander.migration_rate(network, params.replace(upstream_weight=0.0, end_damping=0.0))[0]
    bend = wr.metrics.curvature(line)
    strong = abs(bend) > 0.5 * abs(bend).max()
    strong[[0, -1]] = False  # beyond its ends a line counts as straight
    assert (np.sign(local[strong]) == -np.sign(bend[strong])).all()


@pytest.mark.parametrize("closed", [False, True])
def test_rates_of_uneven_points_are_those_of_the_curve(closed, device):
    """Points with segments from 0.5 to 1.5 of the mean lie on the same curve: the same rates at the same places."""

    def points(u):
        if closed:
            angle = 2.0 * np.pi * u
            return (600.0 * (1.0 + 0.1 * np.cos(2.0 * angle)))[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1)
        return np.stack([4000.0 * u, 300.0 * np.sin(4.0 * np.pi * u)], axis=1)

    def rates(u):
        network = wr.RiverNetwork.from_polylines([points(u)], 60.0, closed=closed, device=device)
        return wr.meander.migration_rate(network, plain_params())[0]

    count = 160
    u = np.linspace(0.0, 1.0, count + 1)[: count + (not closed)]
    uneven = u + 0.5 / (6.0 * np.pi) * np.sin(6.0 * np.pi * u)
    segments = np.linalg.norm(np.diff(points(uneven), axis=0), axis=1)
    assert segments.max() > 2.5 * segments.min()
    fine = np.linspace(0.0, 1.0, 8 * count + 1)[: 8 * count + (not closed)]
    exact = np.interp(uneven, fine, rates(fine))
    # Five widths from an end the second derivative of what is damped jumps; a cubic through even points misses that.
    np.testing.assert_allclose(rates(uneven), exact, atol=(5e-4 if closed else 2e-3) * abs(exact).max())


def test_rates_fade_with_the_slope_of_the_ground(device):
    line = even_meander() + [0.0, 1500.0]
    network, params = wr.RiverNetwork.from_polylines([line], 40.0, device=device), plain_params()
    (plain,) = wr.meander.migration_rate(network, params)
    size = (int(line[:, 0].max() / 25.0) + 40, 120)
    for slope in (0.0, 0.03, 0.075, 0.12, 0.15, 1.0):
        ground = wr.generate.tilted_plain((size[1], size[0]), 25.0, slope, device=device)
        t = min(slope / 0.15, 1.0)
        (rate,) = wr.meander.migration_rate(network, params, ground)
        np.testing.assert_allclose(rate, plain * (1.0 - t * t * (3.0 - 2.0 * t)), atol=1e-9 * abs(plain).max())
    half = ground.crop((0.0, 0.0, 0.5 * line[-1, 0], 3000.0))
    half.brush("flatten", (0.0, 1500.0), 1e6, 1.0, level=0.0)
    (rate,) = wr.meander.migration_rate(network, params, half)
    beyond = line[:, 0] > half.bounds[2]
    assert (rate[beyond] == 0.0).all() and abs(rate[~beyond]).max() > 0.1 * abs(plain).max()


def test_no_damping_leaves_the_law_alone_up_to_the_ends(device):
    network = wr.RiverNetwork.from_polylines([even_meander()], 40.0, device=device)
    (held,) = wr.meander.migration_rate(network, plain_params())
    (free,) = wr.meander.migration_rate(network, plain_params(end_damping=0.0))
    inner = slice(9, -9)  # five widths are 200 m, eight points
    np.testing.assert_array_equal(held[inner], free[inner])
    # A fused multiply and add of a GPU leaves some 1e-16 of 0.
    assert max(abs(held[0]), abs(held[-1])) < 1e-12 * abs(free).max() < abs(free[-1])


def test_a_straight_line_stays(device):
    line = np.stack([np.arange(0.0, 1000.0, 50.0), np.zeros(20)], axis=1)
    network = wr.RiverNetwork.from_polylines([line, line[[0, 1, 5]] + [0.0, 900.0]], 20.0, device=device)
    for rate in wr.meander.migration_rate(network, plain_params()):
        assert (abs(rate) < 1e-12).all()


def test_other_kinds_of_arguments_are_named(device):
    network = wr.RiverNetwork.from_polylines([even_meander()], 40.0, device=device)
    with pytest.raises(TypeError, match="params is a PathMeander; give a MeanderParams"):
        wr.meander.migration_rate(network, wr.PathMeander())
    with pytest.raises(TypeError, match="network is a list; give a RiverNetwork"):
        wr.meander.migration_rate(network.polylines(), plain_params())
    with pytest.raises(TypeError, match="terrain is an ndarray; give a Terrain or None"):
        wr.meander.migration_rate(network, plain_params(), np.zeros((5, 5)))
    far = wr.Terrain(np.zeros((5, 5)), 10.0, origin=(1e6, 1e6), device=device)
    with pytest.raises(ValueError, match="does not lie under the network"):
        wr.meander.migration_rate(network, plain_params(), far)


def test_a_measured_river_has_the_rates_of_the_twin_on_even_points(device):
    river = wr.read_network(data_folder("centerlines") / "jutai_19890805.csv.gz", device=device)
    for rate, xy in zip(wr.meander.migration_rate(river, plain_params()), river.polylines(), strict=True):
        assert np.isfinite(rate).all() and len(rate) == len(xy)
    reach = wr.RiverNetwork.from_polylines(
        [xy[:1200] for xy in river.polylines()], [w[:1200] for w in river.point_widths()], device=device
    )
    sim = wr.Simulation(reach, plain_params(spacing_in_widths=0.5, spacing=500.0), device=device)
    (rate,), (xy,) = wr.meander.migration_rate(sim.network, sim.params), sim.network.polylines()
    segments = np.linalg.norm(np.diff(xy, axis=0), axis=1)
    assert np.ptp(segments) < 0.01 * segments.mean()
    section = sim.network.point_widths()[0], sim.network.point_depths()[0]
    expected = twin(xy, False, *section, sim.params, sim.network.channel_width[0])
    np.testing.assert_allclose(rate, expected, atol=1e-9 * abs(expected).max())
