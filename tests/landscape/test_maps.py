"""Landscape maps: closed forms of channels that stand still, and what maps of a river that meanders must show."""

import dataclasses

import numpy as np
import pytest
from histories import History as MadeByHand
from plain import plain_params
from scipy.ndimage import label

import warpriver as wr
from warpriver.history import EventLog
from warpriver.landscape import GROUND, PLANTS, LandscapeParams, landscape_maps
from warpriver.landscape.falloff import smoothstep

MODULE = LandscapeParams()


def straight(y, width, length=2000.0, heading=(1.0, 0.0)):
    s = np.arange(0.0, length + 1.0, 20.0)[:, None]
    return np.array([0.0, y]) + s * np.array(heading), width


def still(lines, years=30.0, depth=None):
    """A history of channels that stay where they are, recorded three times."""
    network = wr.RiverNetwork.from_polylines([xy for xy, _ in lines], width=[width for _, width in lines], depth=depth)
    times = np.array([0.0, 0.3 * years, years])
    return made(times, [network] * 3)


def made(times, networks, events=()):
    class Made(MadeByHand):
        def __len__(self):
            return len(self.times)

    return Made(
        times=times,
        networks=networks,
        events=EventLog(events),
        crs=None,
        params=plain_params(),
        steps=np.arange(len(times)),
    )


def maps_of(history, cell_size, bounds, **options):
    return landscape_maps.__wrapped__(history, None, cell_size, bounds=bounds, **options)


@pytest.fixture(scope="module")
def river():
    """200 years of a river 100 m wide, recorded each 10 steps."""
    line = wr.generate.noisy_line(length=9_000, spacing=50, amplitude=50, seed=0)
    return wr.Simulation(wr.RiverNetwork.from_polylines([line], width=100.0), plain_params(), threads=1).run(
        years=200, record_every=10
    )


@pytest.fixture(scope="module")
def landscape(river):
    return landscape_maps(river, cell_size=20.0)


# ---- closed forms


def test_a_straight_channel_has_the_profile():
    """At w / 10 cells: deposits 1 at the banks, 0 in the middle and from 4 widths on, moisture 0 beyond 6."""
    width, years = 100.0, 30.0
    maps = maps_of(still([straight(0.0, width)], years), 10.0, (500.0, -705.0, 1500.0, 705.0))
    away = np.abs(705.0 - (np.arange(141) + 0.5) * 10.0) / width
    moisture = maps.moisture.numpy() / (MODULE.moisture_rate * years)
    np.testing.assert_allclose(moisture, np.repeat(wr.landscape.moisture_falloff(away)[:, None], 100, 1), atol=1e-8)
    assert (moisture[away > 6.0] == 0.0).all() and moisture[70, 0] == pytest.approx(1.0, abs=1e-9)
    laid = MODULE.sediment_rate * years * wr.landscape.sediment_falloff(away)
    depth = float(wr.RiverNetwork.from_polylines([straight(0.0, width)[0]], width=width).channel_depth[0])
    np.testing.assert_allclose(maps.sediment.numpy()[:, 50], depth * -np.expm1(-laid / depth), rtol=0.01, atol=1e-9)
    assert laid[65] == laid.max() == MODULE.sediment_rate * years and laid[70] == 0.0
    assert (maps.sediment.numpy()[away >= 4.0] == 0.0).all()
    under = away <= 0.5
    assert (maps.occupied.numpy()[under] == years).all() and (maps.age.numpy()[under] == 0.0).all()
    assert np.isnan(maps.age.numpy()[~under]).all() and (maps.belt.numpy() == under[:, None]).all()
    # The integral across is 2 * 6 w * 16 / 35.
    volume = moisture[:, 50].sum() * 10.0
    assert volume == pytest.approx(12.0 * width * 16.0 / 35.0, rel=1e-6)


def test_a_channel_that_moves_evenly_sweeps_all_between_its_records():
    """By 300 m in 30 years: each place in between was under the channel for w / speed, and left in turn."""
    lines = [straight(y, 60.0)[0] for y in (-150.0, 150.0)]
    networks = [wr.RiverNetwork.from_polylines([xy], width=60.0) for xy in lines]
    maps = maps_of(made(np.array([0.0, 30.0]), networks), 5.0, (900.0, -300.0, 1100.0, 300.0))
    y = 300.0 - (np.arange(120) + 0.5) * 5.0
    between = np.abs(y) < 115.0
    np.testing.assert_allclose(maps.occupied.numpy()[between], 6.0, atol=1e-6)
    age = 30.0 - (y + 30.0 + 150.0) / 10.0
    np.testing.assert_allclose(maps.age.numpy()[between, 20], age[between], atol=1e-6)
    assert (maps.belt.numpy() == (np.abs(y) <= 180.0)[:, None]).all()
    assert (maps.ground.numpy()[between] == GROUND.index("point bar")).all()


def test_a_brook_that_crosses_a_river_leaves_no_seam():
    """Two cells side by side differ by no more than the steepest slope of the profile, of the brook at most."""
    river, brook = straight(0.0, 200.0, 3000.0), straight(-400.0, 10.0, 1200.0, (0.0, 1.0))
    brook = (brook[0] + [1500.0, 0.0], brook[1])
    cell, years = 4.0, 50.0
    maps = maps_of(still([river, brook], years), cell, (1100.0, -600.0, 1900.0, 1000.0))
    steepest = {"moisture": 1.0 / 6.0 * 1.72, "sediment": 1.5 / 0.5}
    x = 1100.0 + (np.arange(200) + 0.5) * cell
    far = np.abs(x - 1500.0) > 150.0
    for name, rate in (("moisture", MODULE.moisture_rate), ("sediment", MODULE.sediment_rate)):
        values = maps.rasters[name].numpy()
        limit = rate * years * steepest[name] * cell
        steps = [np.abs(np.diff(values, axis=axis)) for axis in (0, 1)]
        assert max(step.max() for step in steps) <= 1.02 * limit / 10.0, name
        # Where the brook is as far as the river in its widths, too: there the river's slope counts.
        assert steps[0][:, far].max() <= 1.02 * limit / 200.0, name


# ---- a river


def test_maps_do_not_depend_on_how_often_a_run_was_recorded():
    line = wr.generate.noisy_line(length=6_000, spacing=50, amplitude=60, seed=0)
    network = wr.RiverNetwork.from_polylines([line], width=100.0)
    runs = [wr.Simulation(network, plain_params(), threads=1).run(years=90, record_every=every) for every in (1, 5, 20)]
    bounds = (-700.0, -1800.0, 6700.0, 1800.0)
    fine, *others = (landscape_maps(run, cell_size=20.0, bounds=bounds) for run in runs)
    assert len(runs[0].cutoffs) == len(runs[2].cutoffs)
    for maps in others:
        for name in ("moisture", "sediment", "vegetation", "elevation_change", "age"):
            one, other = (np.nan_to_num(m.rasters[name].numpy()) for m in (fine, maps))
            assert np.abs(other - one).sum() < 0.02 * np.abs(one).sum(), name
        # A hole: ground that no channel has ever covered, and that is closed in by the belt.
        islands, count = label(maps.belt.numpy() == 0, np.ones((3, 3)))
        known = np.unique(islands[fine.belt.numpy() == 0])
        outside = np.unique(np.concatenate([islands[0], islands[-1], islands[:, 0], islands[:, -1]]))
        assert set(range(1, count + 1)) <= set(known) | set(outside)
        # Some cells at its edge apart: the river moves by up to two widths between the records.
        assert (maps.belt.numpy() != fine.belt.numpy()).mean() < 0.005 * fine.belt.numpy().mean()


def test_a_bend_that_runs_along_its_bank_leaves_no_teeth():
    """Of two records of a bend, 1.3 widths apart: ground under its apex in between."""
    x = np.linspace(-1000.0, 1000.0, 51)
    lines = [np.stack([x, 300.0 * np.exp(-(((x - at) / 220.0) ** 2))], axis=1) for at in (-50.0, 0.0, 50.0, 80.0)]
    networks = [wr.RiverNetwork.from_polylines([line], width=100.0) for line in lines]
    maps = maps_of(made(np.array([0.0, 10.0, 20.0, 26.0]), networks), 2.0, (-300.0, -100.0, 300.0, 400.0))
    column = maps.belt.numpy()[:, 125:215]
    top = 400.0 - 2.0 * column.argmax(axis=0)
    # From x = -50 to 130; apices are at -50 to 80, 300 m + half the width.
    under = slice(0, 65)
    assert np.ptp(top[under]) <= 2.0 and abs(top[under].mean() - 350.0) < 3.0


def test_the_ground_between_a_neck_and_the_new_course_is_swept():
    """The neck is two widths wide; the channel that cuts it straightens before the next record."""
    y, turn = np.linspace(600.0, -600.0, 61), np.linspace(np.pi, 2.0 * np.pi, 20)[1:-1]
    bottom = np.stack([80.0 * np.cos(turn), -600.0 + 80.0 * np.sin(turn)], axis=1)
    down, up = np.stack([np.full(61, -80.0), y], axis=1), np.stack([np.full(61, 80.0), y[::-1]], axis=1)
    before = np.concatenate([down, bottom, up])
    loop = np.concatenate([down[30:], bottom, up[:31]])
    x = np.linspace(-80.0, 80.0, 12)
    after = np.concatenate([down[:23], np.stack([x, 100.0 + 60.0 * (x / 80.0) ** 2], axis=1)[1:-1], up[38:]])
    networks = [wr.RiverNetwork.from_polylines([line], width=80.0) for line in (before, after)]
    event = wr.history.Cutoff(4.0, 0, 80.0, loop)
    maps = maps_of(made(np.array([0.0, 8.0]), networks, [event]), 4.0, (-300.0, -700.0, 300.0, 600.0))
    column = maps.belt.numpy()[:, 75]
    y = 600.0 - 4.0 * (np.arange(len(column)) + 0.5)
    assert column[(y > -38.0) & (y < 138.0)].all() and not column[(y < -45.0) & (y > -635.0)].any()
    age = maps.age.numpy()[:, 75][(y > -38.0) & (y < 60.0)]
    assert (age <= 4.0 + 1e-6).mean() > 0.9 and age.min() < 1.0


def test_bars_lie_on_the_inner_side_of_bends(landscape):
    """Of the ground that a bend of |w C| > 0.1 left behind; the channel goes by the curvature upstream."""
    bar = landscape.ground.numpy() == GROUND.index("point bar")
    inner = landscape.inner.numpy()[bar]
    sharp = np.abs(inner) > 0.1
    assert sharp.sum() > 5000
    assert (inner[sharp] > 0.0).mean() > 0.95


def test_a_mirrored_river_gives_the_mirrored_map(river, landscape):
    # 128 rows: blocks of cells are worked at together, and these are mirrored, too.
    networks = [
        wr.RiverNetwork.from_polylines([n.polylines()[0] * [1.0, -1.0]], width=100.0, depth=float(n.channel_depth[0]))
        for n in (river.networks[k] for k in range(20))
    ]
    mirrored = maps_of(made(river.times[:20], networks), 25.0, (0.0, -1600.0, 9000.0, 1600.0))
    plain = landscape_maps(river, cell_size=25.0, bounds=(0.0, -1600.0, 9000.0, 1600.0), until=19)
    for name in ("moisture", "sediment", "age", "occupied", "inner"):
        one, other = plain.rasters[name].numpy(), mirrored.rasters[name].numpy()[::-1]
        np.testing.assert_allclose(other, one, atol=1e-5, err_msg=name)


def test_every_oxbow_is_in_the_maps_at_its_age(river, landscape):
    assert len(river.cutoffs) >= 3
    record = np.diff(river.times).max()
    kind = landscape.ground
    for event in river.cutoffs:
        middle = event.xy[len(event.xy) // 4 : -len(event.xy) // 4]
        age = landscape.age.sample(middle)
        stayed = np.abs(age - (landscape.time - event.time)) <= record
        ground = kind.sample(middle)
        # Where no channel came back.
        assert stayed.any() and np.isin(ground[stayed], [GROUND.index("oxbow lake"), GROUND.index("plug")]).mean() > 0.8


def test_lakes_fill_from_their_ends_and_stay_visible(river):
    """A loop that was cut off long ago is dry after a few tau, its hollow visible to 2 tau at least."""
    event = river.cutoffs[0]
    for tau, wet in ((200.0, True), (5.0, False)):
        maps = landscape_maps(river, cell_size=20.0, params=MODULE.replace(lake_time=tau))
        lake = maps.lake.numpy() > 0.0
        assert lake.any() == wet
        ends = maps.ground.numpy() == GROUND.index("plug")
        depth = maps.lake.numpy()
        rest = maps.ground.numpy() == GROUND.index("oxbow lake")
        assert ends.any() and (not wet or depth[ends].mean() < 0.5 * depth[rest].mean())
    age = landscape_maps(river, cell_size=20.0).time - event.time
    maps = landscape_maps(river, cell_size=20.0, params=MODULE.replace(lake_time=0.5 * age))
    under = (maps.ground.numpy() == GROUND.index("oxbow lake")) & (np.abs(maps.age.numpy() - age) < 0.1)
    assert (
        under.sum() > 20
        and maps.elevation_change.numpy()[under].min()
        < maps.elevation_change.numpy()[maps.ground.numpy() == GROUND.index("point bar")].mean() - 0.1
    )


def test_plants_grow_in_the_belt(landscape):
    """Three times as densely as outside, where dry ground has its own; none in the water."""
    belt, density = landscape.belt.numpy() == 1, landscape.vegetation.numpy()
    felt = np.isfinite(landscape.water.numpy()) | belt | (landscape.moisture.numpy() > 0.0)
    assert density[belt].mean() > 3.0 * density[~felt].mean() == pytest.approx(3.0 * MODULE.dry_cover)
    assert (density[landscape.plants.numpy() == PLANTS.index("water")] == 0.0).all()
    age = landscape.age.numpy()
    grown = smoothstep(landscape.moisture.numpy())
    dry = grown + (1.0 - grown) * MODULE.dry_cover
    bar = landscape.ground.numpy() == GROUND.index("point bar")
    np.testing.assert_allclose(density[bar], (dry * -np.expm1(-age / MODULE.cover_time))[bar], atol=1e-12)


def test_a_window_of_one_record_is_the_present_channel(river):
    maps = landscape_maps(river, cell_size=25.0, window=1)
    span = river.times[-1] - river.times[-2]
    expected = MODULE.moisture_rate * span * wr.landscape.moisture_falloff(np.nan_to_num(maps.water.numpy(), nan=9.0))
    np.testing.assert_allclose(maps.moisture.numpy(), expected, atol=1e-8)
    whole = landscape_maps(river, cell_size=25.0)
    assert maps.moisture.numpy().sum() < 0.1 * whole.moisture.numpy().sum()
    np.testing.assert_array_equal(maps.age.numpy(), whole.age.numpy())


def test_streams_of_the_ground_moisten_it():
    terrain = wr.generate.fluvial_terrain((60, 70), 50.0, 200.0, 1)
    network = wr.RiverNetwork.from_polylines([np.linspace((500.0, -1500.0), (3000.0, -1500.0), 60)], width=60.0)
    history = made(np.array([0.0, 10.0]), [network] * 2)
    maps = landscape_maps.__wrapped__(history, terrain, 50.0)
    power = wr.hydrology.stream_power(wr.hydrology.fill_depressions(terrain)).numpy()
    assert maps.power_scale == pytest.approx(np.percentile(power[np.isfinite(power)], 99.0))
    dry = landscape_maps.__wrapped__(history, None, 50.0, bounds=terrain.bounds)
    added = maps.moisture.numpy() - dry.moisture.numpy()
    np.testing.assert_allclose(added, np.clip(np.nan_to_num(power) / maps.power_scale, 0.0, 1.0), atol=1e-12)
    assert np.isnan(dry.power_scale)


def test_own_falloffs_take_the_place_of_ours():
    maps = maps_of(
        still([straight(0.0, 100.0)], 10.0),
        10.0,
        (500.0, -700.0, 1500.0, 700.0),
        moisture_falloff=lambda widths: (np.abs(widths) < 2.0) * 1.0,
        params=MODULE.replace(moisture_rate=1.0),
    )
    away = np.abs(700.0 - (np.arange(140) + 0.5) * 10.0)
    inside = np.abs(away - 200.0) > 10.0
    np.testing.assert_allclose(maps.moisture.numpy()[inside, 50], 10.0 * (away < 200.0)[inside], atol=1e-6)
    with pytest.raises(ValueError, match="must fade to 0"):
        maps_of(still([straight(0.0, 100.0)]), 10.0, (0.0, 0.0, 100.0, 100.0), sediment_falloff=lambda w: 1.0 + 0.0 * w)


def test_levees_fall_away_from_the_banks():
    """By a factor e in a width; the sum over time of a straight channel, capped at its depth."""
    maps = maps_of(
        still([straight(0.0, 100.0)], 10.0),
        10.0,
        (500.0, -700.0, 1500.0, 700.0),
        sediment_falloff=wr.landscape.levee_falloff,
    )
    away = np.abs(700.0 - (np.arange(140) + 0.5) * 10.0) / 100.0
    laid = MODULE.sediment_rate * 10.0 * np.exp(0.5 - away)
    depth = float(wr.RiverNetwork.from_polylines([straight(0.0, 100.0)[0]], width=100.0).channel_depth[0])
    beside = (away > 0.5) & (away < 4.0)
    got = maps.sediment.numpy()[:, 50]
    np.testing.assert_allclose(got[beside], (depth * -np.expm1(-laid / depth))[beside], rtol=0.01)
    assert (np.diff(got[(away > 0.5)][:64]) >= 0.0).all() and got[away >= 6.0].max() < 1e-6


def test_crevasses_leave_lobes_on_the_outer_side():
    line = straight(0.0, 50.0)[0]
    network = wr.RiverNetwork.from_polylines([line], width=50.0)
    event = wr.history.Crevasse(5.0, 0, 50.0, 0.2, 1000.0, 0.0, "")
    maps = maps_of(made(np.array([0.0, 10.0]), [network] * 2, [event]), 10.0, (500.0, -500.0, 1500.0, 500.0))
    lobe = maps.ground.numpy() == GROUND.index("lobe")
    row, column = np.nonzero(lobe)
    # It turns left, to the north: the lobe lies in the south, within its length, and widens.
    assert lobe.sum() > 50 and (row > 50).all() and (row < 50 + (6.5 + 1.5) * 5).all()
    assert np.ptp(column[row > 70]) > np.ptp(column[row < 56])


def test_plants_hold_banks():
    line = wr.generate.noisy_line(length=4_000, spacing=50, amplitude=60, seed=1)
    network = wr.RiverNetwork.from_polylines([line], width=80.0)
    free, held = wr.Simulation(network, plain_params(), threads=1), wr.Simulation(network, plain_params(), threads=1)
    free.run(years=40, record_every=20)
    bounds = (-500.0, -1000.0, 4500.0, 1000.0)
    history = wr.landscape.simulate_with_plants(held, 40.0, bounds=bounds, every=20.0, strength=0.9, record_every=20)
    assert held.step_count == free.step_count and len(held.controls) == 1
    moved = [np.abs(sim.network.points()[:, 1]).max() for sim in (free, held)]
    assert moved[1] < moved[0]
    factor = held.controls[0].raster.numpy()
    assert factor.min() >= 0.1 - 1e-9 and factor.max() <= 1.0 and np.ptp(factor) > 0.2
    assert len(history.edits) == 2


def test_what_cannot_be_mapped_is_refused(river):
    with pytest.raises(ValueError, match="holds records 0 to"):
        landscape_maps(river, until=len(river))
    with pytest.raises(ValueError, match="fewer than 2 x 2 cells"):
        landscape_maps(river, bounds=(0.0, 0.0, 5.0, 5.0))
    with pytest.raises(ValueError, match="2\\^31"):
        landscape_maps(river, cell_size=0.01)
    with pytest.raises(ValueError, match="strength"):
        wr.landscape.erodibility(landscape_maps(river, cell_size=200.0), 2.0)
    assert dataclasses.is_dataclass(MODULE)
