"""Widths that vary through bends: wider where the river migrates, none where they are off, and runs keep their bits."""

import numpy as np
from crossings import crosses_itself, crossings

import warpriver as wr

WIDTH = 40.0


def valley(widths, *, length=150.0, **options):
    line = wr.generate.noisy_line(length * WIDTH, 20.0, 10.0, 3)
    params = wr.MeanderParams(spacing=20.0, widths=widths, bank_spread=options.pop("bank_spread", 0.6))
    return wr.Simulation(wr.RiverNetwork.from_polylines([line], WIDTH), params, seed=9, **options)


def test_no_lag_and_none_give_the_same_bits(device):
    runs = [valley(widths, length=60.0, device=device) for widths in (None, wr.WidthParams(lag=0.0))]
    for run in runs:
        run.run(years=60)
    np.testing.assert_array_equal(*(run.network.points() for run in runs))
    assert runs[1].network.point_section is None


def test_bends_are_wider_at_their_apexes_than_between_them():
    """As surveyed rivers: by some tens of percent, with uniform banks as well."""
    sim = valley(wr.WidthParams(lag=0.3, time=10.0), bank_spread=0.0, threads=1)
    sim.run(years=300, record_every=10**6)
    (line,), (width,) = sim.network.polylines(), sim.network.point_widths()
    bends = wr.metrics.bends(line, WIDTH)
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    at_apex, between = (np.interp(place, arc, width) / WIDTH for place in (bends.apex, bends.start))
    assert len(bends.apex) > 15
    assert 1.1 < np.median(at_apex) < 1.6 and np.median(at_apex) > np.median(between) + 0.05
    assert width.min() >= WIDTH * (1.0 - 1e-9) and width.max() <= 2.0 * WIDTH * (1.0 + 1e-9)
    assert not len(crossings(line)) and not any(crosses_itself(c.xy) for c in sim.history.cutoffs)
    assert len(sim.history.cutoffs) > 3
    assert any(np.ptp(cutoff.section[:, 0]) > 0.0 for cutoff in sim.history.cutoffs), "oxbow lakes keep their widths"


def test_rivers_widen_next_to_fresh_cutoffs():
    """With unrest they migrate faster there, and so become wider, for some years."""
    unsettled = wr.FloodplainParams(plug_factor=1.0, bar_factor=1.0, unrest=3.0, unrest_time=10.0, unrest_reach=5.0)
    told = []
    for floodplain in (unsettled.replace(unrest=0.0), unsettled):
        line = wr.generate.sine_generated(15.0 * WIDTH, 1.7, 6, 20.0)
        params = wr.MeanderParams(
            spacing=20.0, inlet="none", bank_spread=0.0, floodplain=floodplain, widths=wr.WidthParams()
        )
        sim = wr.Simulation(wr.RiverNetwork.from_polylines([line], WIDTH), params, threads=1, device="cpu")
        while not sim.history.cutoffs:
            sim.step()
            sim._record()
        cut = sim.history.cutoffs[0]
        sim.run(years=5.0)
        near = np.hypot(*(sim.network.points() - 0.5 * (cut.xy[0] + cut.xy[-1])).T)
        width = sim.network.point_widths()[0]
        told.append(width[(near > 2.0 * WIDTH) & (near < 8.0 * WIDTH)].mean() / WIDTH)
    assert told[1] > told[0] + 0.03


def test_bits_do_not_depend_on_threads_or_a_stop(tmp_path):
    whole = valley(wr.WidthParams(), threads=1)
    whole.run(steps=500)
    several = valley(wr.WidthParams(), threads=3, capture=False)
    several.run(steps=500)
    np.testing.assert_array_equal(several.network.points(), whole.network.points())
    stopped = valley(wr.WidthParams(), threads=1)
    stopped.run(steps=300, store=tmp_path / "run", record_every=10**6)
    again = wr.Simulation.resume(tmp_path / "run", threads=1, device="cpu")
    again.run(steps=200)
    np.testing.assert_array_equal(again.network.points(), whole.network.points())
    np.testing.assert_array_equal(again.network.point_widths()[0], whole.network.point_widths()[0])
