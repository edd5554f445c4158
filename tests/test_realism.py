"""The default constants give planforms the statistics of measured rivers; the law alone does not."""

import numpy as np
import pytest

import warpriver as wr

WIDTH, YEARS, SEEDS = 100.0, 2000.0, (0, 1, 2)


def pooled(params):
    """Means of the statistics of some valleys of 300 widths by their bends, and the greatest straight reach of all."""
    found = []
    for seed in SEEDS:
        line = wr.generate.noisy_line(300.0 * WIDTH, 0.5 * WIDTH, 0.5 * WIDTH, seed)
        network = wr.RiverNetwork.from_polylines([line], width=WIDTH)
        sim = wr.Simulation(network, params, seed=seed, threads=1)
        found.append(wr.metrics.statistics(sim.run(years=YEARS, record_every=10**9)))
    weight = [told.bends for told in found]
    means = {name: np.average([getattr(told, name) for told in found], weights=weight) for name, *_ in found[0].rows()}
    return means | {"straight_below_head": max(told.straight_below_head for told in found), "count": sum(weight)}


def test_rivers_of_2000_years_have_the_statistics_of_measured_ones():
    """Ranges of real rivers as in docs/realism.md; a tenth more where 150 bends tell no better, as shares of bends."""
    told = pooled(wr.MeanderParams(spacing=WIDTH))
    print({name: round(float(value), 2) for name, value in told.items()})
    assert told["count"] > 120
    assert 13.0 < told["wavelength"] < 20.0
    assert 9.0 < told["bend_length"] < 14.0
    assert 2.4 < told["radius"] < 3.6
    assert 0.15 < told["tight_share"] < 0.4
    for name, real in (("lean_slight", 0.43), ("lean_middle", 0.61), ("lean_strong", 0.73)):
        assert told[name] == pytest.approx(real, abs=0.2), name
    assert told["straight_below_head"] < 30.0
    assert 20.0 < told["oxbow_length"] < 40.0 and told["oxbow_spread"] < 0.8


def test_the_law_alone_has_longer_bends_and_leaves_the_head_straight():
    told = pooled(wr.MeanderParams.paper().replace(spacing=WIDTH))
    assert told["bend_length"] > 15.0 and told["radius"] > 4.0 and told["tight_share"] < 0.1
    assert told["straight_below_head"] > 50.0
