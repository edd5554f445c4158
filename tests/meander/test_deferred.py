"""Tributaries that run along the belt of a river before they run into it."""

import functools

import numpy as np
import pytest
from plain import plain_params
from trees import assert_forest

from warpriver import RiverNetwork, Simulation, Terrain, edits, generate
from warpriver.meander import JunctionParams

WIDTH = 80.0


@functools.cache
def river():
    """A river that has meandered for 90 years."""
    line = generate.noisy_line(14_000.0, 40.0, 100.0, 3)
    sim = Simulation(
        RiverNetwork.from_polylines([line], width=WIDTH), plain_params(sinuosity_scaling="whole"), device="cpu"
    )
    sim.run(years=90.0, record_every=10_000)
    return sim.network.polylines()[0]


def with_brook(side=1.0, terrain=None, drop=0.0, **options):
    """The river with a brook from the north, or mirrored from the south; ``drop``: it ends so far beside the river."""
    xy = river() * [1.0, side]
    k = len(xy) // 3
    mouth = xy[k] + [0.0, side * drop]
    brook = np.linspace(mouth + [-1_500.0, 4_000.0 * side], mouth, 120)
    lines = [xy[: k + 1], xy[k:], brook] if drop == 0.0 else [xy, brook]
    widths = [WIDTH, WIDTH + 1.0, 15.0] if drop == 0.0 else [WIDTH, 15.0]
    flows = [200.0, 204.0, 4.0] if drop == 0.0 else [200.0, 4.0]
    network = RiverNetwork.from_polylines(lines, width=widths, discharge=flows)
    return Simulation(network, plain_params(sinuosity_scaling="whole", **options), terrain=terrain, device="cpu")


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_tributary_is_led_along_the_belt_by_hand(side, device):
    sim = with_brook(side)
    before = sim.network.points()
    sim.apply(edits.DeferJunction(2))
    network = sim.network
    assert_forest(network)
    assert network.channel_count == 3 and network.channel_discharge.max() == pytest.approx(204.0)
    (event,) = sim.history.avulsions
    along = event.course[-1] - event.xy[-1]
    assert along[0] > 10.0 * WIDTH, "the mouth lies farther down the river"
    # Up to where it comes in it keeps outside of the river, which it joins at the bend that reaches farthest out.
    main = np.concatenate([xy for c, xy in enumerate(network.polylines()) if network.channel_width[c] > 50.0])
    away = np.hypot(*(event.course[:-8, None] - main[None]).transpose(2, 0, 1)).min(axis=1)
    assert away.min() > 0.5 * WIDTH
    reach = main[np.abs(main[:, 0] - event.course[-1, 0]) < 4.0 * WIDTH, 1] * side
    assert event.course[-1, 1] * side > reach.max() - 0.5 * WIDTH
    sim.undo()
    np.testing.assert_array_equal(sim.network.points(), before)
    sim.redo()
    sim.run(years=20.0, record_every=10_000)
    assert_forest(sim.network)
    again = Simulation.replay(with_brook(side), sim.history)
    np.testing.assert_array_equal(again.network.points(), sim.network.points())


@pytest.mark.parametrize("deferred", [0.0, 0.1])
def test_by_option_a_brook_that_touches_the_river_runs_along_it(deferred):
    """It would flow in where it touches; the ground is carved, and a resumed run does the same."""
    ground = 60.0 - 5e-4 * np.arange(25.0, 15_000.0, 50.0) * np.ones((240, 1))
    terrain = Terrain(ground, 50.0, (-500.0, 6_000.0))
    sim = with_brook(drop=20.0, terrain=terrain, junctions=JunctionParams(deferred=deferred))
    sim.run(years=1.0, record_every=10_000)
    assert_forest(sim.network)
    assert len(sim.history.collisions) == 1 and len(sim.history.avulsions) == (deferred > 0.0)
    if deferred:
        (event,) = sim.history.avulsions
        assert (np.diff(event.bed) < 0.0).all() and (sim.terrain.to_numpy() < ground - 1e-9).any()
        assert event.course[-1, 0] > event.xy[-1, 0] + 10.0 * WIDTH
        assert sim.network.channel_count == 3


def test_what_cannot_be_deferred_is_refused():
    sim = with_brook()
    before = sim.network.points()
    for channel, words in ((1, "does not flow into a river"), (9, "there is no channel 9")):
        with pytest.raises(ValueError, match=words):
            sim.apply(edits.DeferJunction(channel))
    np.testing.assert_array_equal(sim.network.points(), before)
    short = [river()[:40], river()[39:70], np.linspace(river()[39] + [0.0, 900.0], river()[39], 60)]
    network = RiverNetwork.from_polylines(short, width=[WIDTH, WIDTH, 15.0], discharge=[200.0, 204.0, 4.0])
    with pytest.raises(ValueError, match="finds no course"):
        Simulation(network, plain_params()).apply(edits.DeferJunction(2))
