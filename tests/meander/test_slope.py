import numpy as np
import pytest
from plain import plain_params

from warpriver import RiverNetwork, Simulation, Terrain, generate, metrics

SPACING = 25.0


def across(slope, threshold=0.15, years=1.0, *, device, **terrain):
    """Displacement over a while of a sine-generated channel on a plain of that slope."""
    line = generate.sine_generated(1500.0, 1.0, 4, SPACING)
    ground = generate.tilted_plain((120, 320), 25.0, slope, device=device)
    network = RiverNetwork.from_polylines([line + [1000.0, 1500.0]], width=80.0)
    params = plain_params(spacing=SPACING, slope_threshold=threshold, time_step=0.05, cutoff_distance=0.0)
    sim = Simulation(network, params, terrain=ground, device=device)
    before = sim.network.polylines()[0]
    sim.run(years=years)
    return metrics.migration(before, sim.network.polylines()[0])


def test_the_rate_falls_with_the_slope_as_a_smoothstep(device):
    """On a plane the slope is the same everywhere, so every step is shorter by the same factor g."""
    # One step only, so that the courses are still the same: 0.05 yr.
    flat = across(0.0, years=0.05, device=device)
    moving = np.abs(flat) > 0.01 * np.nanmax(np.abs(flat))
    for slope in (0.03, 0.075, 0.12):
        t = slope / 0.15
        # The foot on the other line is found at points 25 m apart: a hundredth of a step.
        ratio = np.nanmedian(across(slope, years=0.05, device=device)[moving] / flat[moving])
        assert ratio == pytest.approx(1.0 - t * t * (3.0 - 2.0 * t), abs=0.01)


@pytest.mark.parametrize("slope", [0.15, 0.16, 1.0])
def test_nothing_moves_where_it_is_too_steep(slope, device):
    # Resampling alone moves points along the line, by less than a micrometre across it.
    assert np.nanmax(np.abs(across(slope, device=device))) < 1e-6


def test_a_channel_is_held_off_the_terrain_and_where_there_is_no_data(device):
    line = generate.sine_generated(1500.0, 1.0, 4, SPACING)
    height = np.zeros((120, 240))
    height[:, 120:150] = np.nan
    ground = Terrain(height, 25.0, origin=(0.0, 1500.0), device=device)
    sim = Simulation(
        RiverNetwork.from_polylines([line], width=80.0), plain_params(spacing=SPACING), terrain=ground, device=device
    )
    before = sim.network.polylines()[0]
    sim.run(years=5)
    moved = np.abs(metrics.migration(before, sim.network.polylines()[0]))
    gap = (before[:, 0] > 3050.0) & (before[:, 0] < 3700.0)
    # Points that are held are sampled anew with those that are not: they shift along the line, by bends of it.
    assert np.nanmax(moved[gap]) < 2.0 and np.nanmax(moved[~gap]) > 20.0
    beyond = RiverNetwork.from_polylines([line + [3000.0, 0.0]], width=80.0)
    sim = Simulation(beyond, plain_params(spacing=SPACING), terrain=ground, device=device)
    before = sim.network.polylines()[0]
    sim.run(years=5)
    outside = before[:, 0] > 6100.0
    assert np.nanmax(np.abs(metrics.migration(before, sim.network.polylines()[0])[outside])) < 1.0


def test_brushing_the_terrain_is_felt_at_the_next_step(device):
    line = generate.sine_generated(1500.0, 1.0, 4, SPACING)
    ground = generate.tilted_plain((120, 320), 25.0, 0.3, device=device)
    network = RiverNetwork.from_polylines([line + [1000.0, 1500.0]], width=80.0)
    sim = Simulation(network, plain_params(spacing=SPACING), terrain=ground, device=device)
    before = sim.network.polylines()[0]
    sim.run(years=2)
    np.testing.assert_allclose(sim.network.polylines()[0], before, atol=1e-6)
    ground.brush("flatten", (4000.0, 1500.0), 1500.0, 1.0)
    sim.run(years=4)
    moved = np.abs(metrics.migration(before, sim.network.polylines()[0]))
    near = np.hypot(before[:, 0] - 4000.0, before[:, 1] - 1500.0) < 600.0
    assert np.nanmax(moved[near]) > 5.0 > 10 * np.nanmax(moved[before[:, 0] < 2000.0])


def test_figure_27_meanders_on_the_plain_and_stays_straight_on_the_front(device):
    """Plain, mountain front and valley in one run of 300 years [Paris2023, Fig. 27]."""
    ground = generate.mountain_front(cell_size=100.0, seed=1, device=device)
    line = generate.mountain_front_line(spacing=50.0, seed=1)
    sim = Simulation(RiverNetwork.from_polylines([line], width=60.0), plain_params(), terrain=ground, device=device)
    sim.run(years=300)
    now = sim.network.polylines()[0]
    sinuosity = {}
    for name, (east, west) in {"plain": (18_000.0, 3_000.0), "front": (20_700.0, 19_300.0)}.items():
        inside = (now[:, 0] < east) & (now[:, 0] > west)
        part = now[inside.argmax() : len(inside) - inside[::-1].argmax()]
        sinuosity[name] = metrics.sinuosity(part)
    print(sinuosity)
    assert sinuosity["plain"] > 1.8 and sinuosity["front"] < 1.1


def test_a_terrain_elsewhere_is_refused():
    line = generate.sine_generated(1500.0, 1.0, 4, SPACING)
    network = RiverNetwork.from_polylines([line], width=80.0, crs="EPSG:32619")
    params = plain_params(spacing=SPACING)
    with pytest.raises(ValueError, match="does not lie under the network"):
        Simulation(network, params, terrain=Terrain(np.zeros((9, 9)), 10.0, origin=(5e5, 5e5)))
    with pytest.raises(ValueError, match="the terrain is in EPSG:32633, the network in EPSG:32619"):
        Simulation(network, params, terrain=Terrain(np.zeros((999, 999)), 10.0, (0.0, 5000.0), "EPSG:32633"))
