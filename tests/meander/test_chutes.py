"""Chute cutoffs in runs: recorded as such, never at a hazard of 0, and the same bits whatever the threads and stops."""

import numpy as np
import pytest
from crossings import crosses_itself, crossings

import warpriver as wr

WIDTH = 40.0


def valley(chutes, *, length=150.0, **options):
    line = wr.generate.noisy_line(length * WIDTH, 20.0, 10.0, 3)
    params = wr.MeanderParams(spacing=20.0, chutes=chutes)
    return wr.Simulation(wr.RiverNetwork.from_polylines([line], WIDTH), params, seed=9, **options)


def test_a_hazard_of_0_and_none_give_the_same_bits(device):
    runs = [valley(chutes, length=60.0, device=device) for chutes in (None, wr.ChuteParams(rate=0.0))]
    for run in runs:
        run.run(years=60)
    np.testing.assert_array_equal(*(run.network.points() for run in runs))


def test_chutes_are_recorded_and_cut_whole_bends(tmp_path):
    sim = valley(wr.ChuteParams(rate=0.01, winding=1.4, longest=7.0), threads=1)
    history = sim.run(years=400, store=tmp_path / "run", record_every=200)
    chutes = [cutoff for cutoff in history.cutoffs if cutoff.chute]
    necks = [cutoff for cutoff in history.cutoffs if not cutoff.chute]
    assert len(chutes) > 6 and len(necks) > 3
    for cutoff in chutes:
        chord = np.hypot(*(cutoff.xy[-1] - cutoff.xy[0]))
        arc = np.hypot(*np.diff(cutoff.xy, axis=0).T).sum()
        assert 2.0 * WIDTH < chord <= 7.0 * WIDTH * (1.0 + 1e-9) and arc > 1.35 * chord
    assert all(np.hypot(*(cutoff.xy[-1] - cutoff.xy[0])) <= 2.0 * WIDTH for cutoff in necks)
    loaded = wr.History.load(tmp_path / "run")
    assert [cutoff.chute for cutoff in loaded.cutoffs] == [cutoff.chute for cutoff in history.cutoffs]
    lengths = [np.median([np.hypot(*np.diff(c.xy, axis=0).T).sum() for c in part]) for part in (chutes, necks)]
    assert lengths[0] < lengths[1], "what chutes leave is shorter"
    assert not len(crossings(sim.network.polylines()[0])) and not any(crosses_itself(c.xy) for c in chutes)


def test_bits_do_not_depend_on_threads_or_a_stop(tmp_path):
    often = wr.ChuteParams(rate=0.02)
    whole = valley(often, threads=1)
    whole.run(steps=500)
    assert any(cutoff.chute for cutoff in whole.history.cutoffs)
    several = valley(often, threads=3, capture=False)
    several.run(steps=500)
    np.testing.assert_array_equal(several.network.points(), whole.network.points())
    stopped = valley(often, threads=1)
    stopped.run(steps=350, store=tmp_path / "run", record_every=10**6)
    again = wr.Simulation.resume(tmp_path / "run", threads=1, device="cpu")
    again.run(steps=150)
    np.testing.assert_array_equal(again.network.points(), whole.network.points())


@pytest.mark.parametrize("rate", [0.002])
def test_oxbow_lakes_are_shorter_with_chutes(rate):
    told = []
    for chutes in (None, wr.ChuteParams(rate=rate)):
        sim = valley(chutes, threads=1)
        told.append(wr.metrics.statistics(sim.run(years=700, record_every=10**6)).oxbow_length)
    assert told[1] < told[0]
