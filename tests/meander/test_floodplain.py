"""What a river leaves behind and meets again: plugs, bars and unrest do what is stated, and runs keep their bits."""

import numpy as np
import pytest
from crossings import crosses_itself, crossings

import warpriver as wr
from warpriver.engine import state as engine_state
from warpriver.engine.saved import SavedError
from warpriver.kernels.floodplain import NEVER, TICKS
from warpriver.meander.floodplain import Floodplain

WIDTH = 40.0
NEUTRAL = wr.FloodplainParams(plug_factor=1.0, bar_factor=1.0, unrest=0.0)
PLAIN = wr.MeanderParams(spacing=20.0, inlet="none", bank_spread=0.0)


def phase_of(sim):
    (found,) = (phase for phase in sim.stepper.phases if isinstance(phase, Floodplain))
    return found


def cell_of(phase, xy):
    """Indices of the cells that places lie in."""
    size, west, north, _, columns = phase._layout
    column, row = np.floor((xy[:, 0] - west) / size), np.floor((north - xy[:, 1]) / size)
    return (row * columns + column).astype(int)


def bent(params, *, years=0.0, device="cpu", **options):
    line = wr.generate.sine_generated(15.0 * WIDTH, 1.0, 6, 20.0)
    sim = wr.Simulation(wr.RiverNetwork.from_polylines([line], WIDTH), params, device=device, **options)
    if years:
        sim.run(years=years)
    return sim


@pytest.mark.parametrize(
    ("kind", "constants", "expected"),
    [
        ("plug", {"plug_factor": 0.2, "plug_time": 400.0}, 1.0 - 0.8 * np.exp(-100.0 / 400.0)),
        ("river", {"bar_factor": 1.6, "bar_time": 50.0}, 1.0 + 0.6 * np.exp(-100.0 / 50.0)),
        ("unrest", {"unrest": 2.0, "unrest_time": 80.0}, 1.0 + 2.0 * np.exp(-100.0 / 80.0)),
    ],
)
def test_a_channel_that_meets_it_moves_by_the_stated_factor(kind, constants, expected, device):
    """The whole land has one date, a hundred years before: every point moves by the factor of that age."""
    moved = []
    for laid in (False, True):
        params = PLAIN.replace(floodplain=NEUTRAL.replace(**constants), time_step=1e-3, cutoff_distance=0.0)
        sim = bent(params, device=device)
        phase = phase_of(sim)
        if laid:
            cells = getattr(phase, kind)
            cells.assign(np.full(len(cells), -100 * TICKS, np.int32))
        before = sim.network.polylines()[0]
        sim.step()
        moved.append(sim.network.polylines()[0] - before)
    normal = np.stack([-np.gradient(before[:, 1]), np.gradient(before[:, 0])], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    free, held = ((move * normal).sum(axis=1) for move in moved)
    strong = np.abs(free) > 0.2 * np.abs(free).max()
    # Sampling anew carries points along the line by a thousandth of what they moved.
    np.testing.assert_allclose(held[strong] / free[strong], expected, rtol=5e-3)
    assert strong.sum() > 40


def test_neutral_values_and_none_give_the_same_bits(device):
    runs = [bent(PLAIN.replace(floodplain=f), years=60, device=device) for f in (None, NEUTRAL)]
    np.testing.assert_array_equal(*(run.network.points() for run in runs))
    assert len(runs[0].history.cutoffs) > 0
    assert not any(isinstance(phase, Floodplain) for phase in runs[0].stepper.phases), "off, it costs nothing"


def test_a_cutoff_leaves_a_plug_and_unrest_at_its_own_time_and_the_neck_open(device):
    constants = wr.FloodplainParams(plug_factor=0.3, bar_factor=1.0, unrest=1.0, unrest_reach=5.0, unrest_time=10.0)
    params = PLAIN.replace(floodplain=constants)
    sim = bent(params, device=device)
    phase = phase_of(sim)
    while not sim.history.cutoffs:
        assert (phase.plug.numpy() == NEVER).all() and (phase.unrest.numpy() == NEVER).all()
        sim.step()
        sim._record()
    cut = sim.history.cutoffs[0]
    apart = np.minimum(*(np.hypot(*(cut.xy - end).T) for end in (cut.xy[0], cut.xy[-1])))
    plug = phase.plug.numpy()[cell_of(phase, cut.xy)]
    assert (plug[apart < 2.0 * WIDTH] == NEVER).all() and (apart < 2.0 * WIDTH).sum() > 1
    assert (plug[apart > 3.2 * WIDTH] != NEVER).all() and (apart > 3.2 * WIDTH).sum() > 5
    # The date is that of the beginning of the sub-step in which it was cut off, the event that of its end.
    date = (cut.time - params.time_step / sim.substeps) * TICKS
    assert plug.max() == pytest.approx(date, abs=1.0)
    away = np.array([[0.0, 0.0], [0.0, 100.0], [0.0, 200.0]])
    unrest = phase.unrest.numpy()[cell_of(phase, 0.5 * (cut.xy[0] + cut.xy[-1]) + away)]
    # Half a cell's diagonal is 0.24 widths: 1/20 of the reach, that is half a year.
    np.testing.assert_allclose((plug.max() - unrest) / TICKS, [0.0, 5.0, 10.0], atol=0.6)


def test_a_river_that_comes_back_takes_a_plug_away():
    params = PLAIN.replace(floodplain=NEUTRAL.replace(plug_factor=0.5))
    sim = bent(params)
    phase = phase_of(sim)
    phase.plug.fill_(-TICKS)
    sim.step()
    under = cell_of(phase, sim.network.points())
    assert (phase.river.numpy()[under] > -TICKS).mean() > 0.9
    saved = phase.saved(sim.stepper.state)
    assert not np.isin(under[phase.river.numpy()[under] > -TICKS], saved["floodplain_plug_cell"]).any()


def valley(params=None, **options):
    lines = [wr.generate.noisy_line(100.0 * WIDTH, 20.0, 10.0, 3), wr.generate.noisy_line(3000.0, 20.0, 10.0, 4)]
    network = wr.RiverNetwork.from_polylines([lines[0], lines[1] + [0.0, 5000.0]], [WIDTH, 50.0])
    params = params or wr.MeanderParams(spacing=20.0, floodplain=wr.FloodplainParams(bar_time=3.0))
    return wr.Simulation(network, params, seed=9, **options)


def test_bits_do_not_depend_on_threads_or_a_stop(tmp_path):
    whole = valley(threads=1)
    whole.run(steps=400)  # with room made for more points on the way
    assert len(whole.history.cutoffs) > 3
    several = valley(threads=3, capture=False)
    several.run(steps=400)
    np.testing.assert_array_equal(several.network.points(), whole.network.points())
    stopped = valley(threads=1)
    stopped.run(steps=300, store=tmp_path / "run")
    assert len(stopped.history.cutoffs) > 0
    again = wr.Simulation.resume(tmp_path / "run", threads=1, device="cpu")
    again.run(steps=100)
    np.testing.assert_array_equal(again.network.points(), whole.network.points())


def test_all_events_together_are_the_same_in_the_layout_of_a_gpu_and_when_checked(monkeypatch):
    all_of_them = {"floodplain": wr.FloodplainParams(), "chutes": wr.ChuteParams(rate=0.02), "widths": wr.WidthParams()}
    runs = []
    for chunk, check in ((0, False), (32, False), (0, True)):
        monkeypatch.setattr(engine_state, "CPU_CHUNK", chunk)
        sim = valley(wr.MeanderParams(spacing=20.0, **all_of_them), threads=1, check=check)
        sim.run(steps=500, record_every=10**6)
        runs.append(sim)
    assert {cutoff.chute for cutoff in runs[0].history.cutoffs} == {False, True}
    for other in runs[1:]:
        np.testing.assert_array_equal(other.network.points(), runs[0].network.points())


def test_a_damaged_record_is_refused():
    sim = valley(threads=1)
    sim.run(steps=20)
    saved = sim.stepper.state.saved()
    phase = phase_of(sim)
    for name, value in (
        ("floodplain_layout", np.array([1.0, np.nan, 0.0, 5.0, 5.0])),
        ("floodplain_layout", np.array([1.0, 0.0, 0.0, 5.0, 1e9])),
        ("floodplain_river_cell", np.array([-1])),
        ("floodplain_river_date", np.array([1.5])),
    ):
        with pytest.raises(SavedError, match="floodplain"):
            phase.restore(sim.stepper.state, saved | {name: value})


def test_lines_among_plugs_and_bars_do_not_cross_themselves():
    line = wr.generate.noisy_line(200.0 * WIDTH, 20.0, 20.0, 0)
    params = wr.MeanderParams(spacing=20.0, floodplain=wr.FloodplainParams(plug_factor=0.05, bar_factor=2.0))
    sim = wr.Simulation(wr.RiverNetwork.from_polylines([line], WIDTH), params, threads=1, device="cpu")
    history = sim.run(years=400, record_every=10**6)
    assert len(history.cutoffs) > 20
    assert not len(crossings(sim.network.polylines()[0]))
    assert not any(crosses_itself(cutoff.xy) for cutoff in history.cutoffs)
