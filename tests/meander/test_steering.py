"""Channels under controls: the law, what symmetry and distance ask for, and what authors expect of a control."""

import copy
import math

import models
import numpy as np
import pytest
from models import MODELS, assert_same, some_controls
from plain import plain_params

from warpriver import PathMeander, RiverNetwork, Simulation, Terrain, edits, generate
from warpriver.history import ControlChange, ControlStroke, History
from warpriver.meander import SetControls, control_map, migration_rate
from warpriver.meander.control_record import controls_after
from warpriver.meander.controls import Attractor, ControlField, DampingRegion, ErodibilityField, Guide, Repeller

WIDTH, SPACING = 60.0, 30.0
# Nothing of the move is smoothed in so short a time, and no point is held but the two ends.
SHORT = {"time_step": 1e-3, "spacing": SPACING, "end_damping": 0.0}


def bends(count=220):
    """A sine of bends to both sides that begins and ends straight."""
    x = SPACING * np.arange(count)
    y = 150.0 * np.sin(2.0 * math.pi * x / 1200.0) * np.clip((x - 1200.0) / 600.0, 0.0, 1.0)
    return np.column_stack([x, y * np.clip((5400.0 - x) / 600.0, 0.0, 1.0)])


def river(xy=None):
    return RiverNetwork.from_polylines([bends() if xy is None else xy], width=WIDTH)


CONTROLS = [Attractor((2400.0, 300.0), 1000.0), Repeller((3900.0, -200.0), 900.0, 0.6), Guide([(500, 99), (900, 99)])]


def shifts(sim):
    """Starts of all points and how far one step moves them before they are sampled anew, m."""
    state = sim.stepper.state
    start = sim.network.points().copy()
    sim.step()
    moved = state.point_moved.numpy()[: len(start)] + sim.network.origin
    return start, moved - start


def right_normals(xy):
    """Unit normals to the right of the flow at the inner points of a line, by central differences."""
    t = xy[2:] - xy[:-2]
    return np.column_stack([t[:, 1], -t[:, 0]]) / np.hypot(*t.T)[:, None]


@pytest.mark.parametrize("mode", ["normal", "vector", "printed"])
def test_points_move_by_the_law(mode, device):
    """v = f [mu n + (|mu| + floor) (n . grad c) n], with the rate mu of the network as it stands."""
    params = plain_params(control_steering=mode, control_floor=0.05, **SHORT)
    area = np.array([(1500.0, -600.0), (4500.0, -600.0), (4500.0, 700.0), (1500.0, 700.0)])
    controls = [*CONTROLS, ErodibilityField(area, 1.7, blend=400.0)]
    sim = Simulation(river(), params, controls=controls, device=device)
    mu = migration_rate(sim.network, params)[0][1:-1]
    start, shift = shifts(sim)
    xy, n = start[1:-1], right_normals(start)
    made = sim.stepper.state.controls
    slope, factor = made.gradient(xy), np.nan_to_num(made.factor.sample(xy), nan=1.0)
    floor = 0.05 * params.migration_rate
    along = (n * slope).sum(axis=1)[:, None] * n
    added = {
        "normal": (np.abs(mu) + floor)[:, None] * along,
        "vector": (np.abs(mu) + floor)[:, None] * slope,
        "printed": mu[:, None] * slope,
    }[mode]
    expected = params.time_step * factor[:, None] * (mu[:, None] * n + added)
    assert np.ptp(factor) > 0.6 and np.hypot(*slope.T).max() > 0.5 and np.ptp(mu) > 10.0
    # The normals of the kernel are those of circles, to a higher order than these.
    np.testing.assert_allclose(shift[1:-1], expected, atol=3e-3 * np.abs(expected).max())
    assert not shift[[0, -1]].any()


def test_shortest_paths_are_steered_by_their_push(device):
    """What is added under "printed" is mu grad c; from that mu follows, and what the default adds."""

    def added(mode):
        params = PathMeander(control_steering=mode, control_floor=0.05, **SHORT)
        pulled = shifts(Simulation(river(), params, controls=CONTROLS, device=device))
        free = shifts(Simulation(river(), params, device=device))
        return pulled[0], (pulled[1] - free[1])[1:-1] / params.time_step

    line, printed = added("printed")
    _, found = added("normal")
    xy = line[1:-1]
    slope = Simulation(river(), plain_params(), controls=CONTROLS, device=device).stepper.state.controls.gradient(xy)
    steep = np.hypot(*slope.T) > 0.05
    xy, slope, printed, found = xy[steep], slope[steep], printed[steep], found[steep]
    mu = (printed * slope).sum(axis=1) / (slope * slope).sum(axis=1)
    n = right_normals(line)[steep]
    expected = ((np.abs(mu) + 0.05 * 60.0) * (n * slope).sum(axis=1))[:, None] * n
    assert len(xy) > 60 and np.ptp(mu) > 5.0
    # Of shifts of some 1e-2 m, the difference of two.
    np.testing.assert_allclose(found, expected, atol=5e-3 * np.abs(expected).max())


@pytest.mark.parametrize("kind", [plain_params, PathMeander])
def test_bends_to_both_sides_and_straight_reaches_are_drawn(kind, device):
    """As printed, an attractor drives off every other bend and leaves a straight reach alone."""
    line = bends()
    # North of everything and wide, so that it pulls all points the same way.
    control = Attractor((3000.0, 4000.0), 8000.0)

    def towards(mode):
        params = kind(control_steering=mode, **SHORT)
        start, pulled = shifts(Simulation(river(line), params, controls=[control], device=device))
        free = shifts(Simulation(river(line), params, device=device))[1]
        way = np.array(control.center) - start
        return ((pulled - free) * way).sum(axis=1)[1:-1] / np.hypot(*way.T)[1:-1] / params.time_step

    drawn, printed = towards("normal"), towards("printed")
    # Within 8 km the gradient is .4 and more; a straight reach has the floor, .02 k, of it.
    assert drawn.min() > 0.1
    # The push of shortest paths is blurred, so that a little of it comes to the straight reach.
    assert printed[20:].min() < -1.0 and np.abs(printed[5:25]).max() < 0.05
    driven = np.flatnonzero(printed < -1.0)
    assert (drawn[driven] > 0.5).all()


def mirrored(control):
    if isinstance(control, Guide):
        return Guide(np.asarray(control.xy) * [1.0, -1.0], control.radius, control.strength)
    return type(control)((control.center[0], -control.center[1]), control.radius, control.strength)


def test_mirrored_input_gives_mirrored_output(device):
    params = plain_params(spacing=SPACING)
    plain = Simulation(river(), params, controls=CONTROLS, device=device)
    other = Simulation(river(bends() * [1.0, -1.0]), params, controls=[mirrored(c) for c in CONTROLS], device=device)
    for _ in range(10):
        plain.step()
        other.step()
    # Rounding of places on the raster, at 6 km; the shortest waves grow by less than twice in these steps.
    np.testing.assert_allclose(plain.network.points(), other.network.points() * [1.0, -1.0], atol=1e-9)


@pytest.mark.parametrize("name", ["varied", "on hills", "tree in parts", "single precision", "paths", "rings"])
def test_a_control_far_away_changes_nothing(name, monkeypatch, device):
    """To the bit, with the network on the raster or off it, whose factors are 1 and whose field is 0 there."""
    make, count = MODELS[name][0], 12
    free = make(threads=1)
    west, _, east, north = free.network.bounds()
    away = [Attractor((east + 4000.0, north + 2000.0), 1500.0, 3.0)]
    away.append(DampingRegion([(east + 2600.0, 0.0), (east + 4600.0, 0.0), (east + 4000.0, 1500.0)], 0.0, blend=400.0))
    parts = (free.network, free.params)
    for cells in (control_map.ROOMY_CELLS, 0):
        monkeypatch.setattr(control_map, "ROOMY_CELLS", cells)
        options = {"terrain": free.terrain, "threads": 1}
        plain, steered = Simulation(*parts, **options), Simulation(*parts, controls=away, **options)
        bounds = steered.stepper.state.controls.raster.bounds
        assert (bounds[0] <= west) == (cells > 0)
        for sim in (plain, steered):
            sim.step(count)
        assert_same(plain, steered)


# ---- controls that change


def wandering(**options):
    network = models.many_channels(6)
    params = plain_params(spacing=25.0, time_step=1.0)
    return Simulation(network, params, terrain=models.hills(network), **options)


def act(sim, field):
    """Change controls and paint between steps, in all ways; some need another raster, most do not."""
    network = sim.network
    sim.step(4)
    sim.controls = some_controls(network)
    sim.step(3)
    sim.controls = [*sim.controls[2:], Repeller((1500.0, 200.0), 700.0, 1.5)]
    sim.run(steps=3, record_every=1)
    sim.controls = [*sim.controls, field, Attractor((2000.0, 9000.0), 90.0)]
    field.paint((700.0, 2600.0), 300.0, 150.0)
    sim.step(2)
    field.paint((900.0, 2500.0), 200.0, -90.0)
    field.smooth((700.0, 2600.0), 250.0)
    sim.step(2)
    sim.controls = sim.controls[3:-1]
    field.erase((700.0, 2600.0), 99.0)
    sim.run(steps=2, record_every=1)


def painted_field():
    return ControlField.blank((-500.0, 1500.0, 3500.0, 4000.0), 30.0)


def test_a_run_goes_on_under_its_controls_to_the_same_bits(tmp_path):
    sim = wandering()
    act(sim, painted_field())
    sim.history.save(tmp_path / "run.npz")
    changes = sim.history.events.of(ControlChange)
    assert len(changes) == 4 and len(sim.history.events.of(ControlStroke)) >= 3
    # What stays is not told again: of the second change, one repeller is new.
    assert len(changes[1].numbers) == 4
    copies = [
        Simulation.resume(History.load(tmp_path / "run.npz"), terrain=sim.terrain, device="cpu"),
        copy.deepcopy(sim),
    ]
    for other in copies:
        assert other.controls == sim.controls
        assert other.stepper.state.controls.layout == sim.stepper.state.controls.layout
    for each in (sim, *copies):
        each.step(6)
    for other in copies:
        assert_same(sim, other)
    assert controls_after(sim.history.events) == sim.controls


def test_changes_of_controls_are_the_same_on_any_number_of_threads():
    sims = [wandering(threads=threads) for threads in (1, 2, 4)]
    for sim in sims:
        act(sim, painted_field())
    assert_same(sims[0], sims[1])
    assert_same(sims[0], sims[2])


def test_steps_are_recorded_anew_only_where_the_raster_has_to_change():
    sim = wandering(controls=[Attractor((1000.0, 1000.0), 800.0)])
    sim.step()
    state = sim.stepper.state
    edition = state.edition
    sim.controls = [Attractor((1600.0, 1200.0), 900.0, 2.0), Repeller((900.0, 5000.0), 1200.0)]
    sim.step(2)
    assert state.edition == edition
    sim.controls = sim.controls
    assert len(sim.history.events.of(ControlChange)) == 2
    # Finer cells, the first factor, and none at all.
    for after in ([Attractor((1000.0, 1000.0), 90.0)], [DampingRegion([(0, 0), (900, 0), (0, 900)])], []):
        sim.controls = after
        sim.step()
        assert state.edition > edition
        edition = state.edition
    assert sim.controls == () and state.controls is None


def test_bad_controls_are_refused_and_nothing_changes():
    sim = wandering(controls=CONTROLS[:2])
    before, events = sim.controls, len(sim.history.events)
    far = Attractor((1e7, 1e7), 50.0)
    for wrong, message in (("here", "controls holds a str"), ([*CONTROLS, far], "leave out what lies far off")):
        with pytest.raises(ValueError, match=message):
            sim.controls = wrong
        assert sim.controls is before and len(sim.history.events) == events
    with pytest.raises(ValueError, match="controls holds a int"):
        wandering(controls=[3])


def test_a_stroke_costs_what_it_touches(monkeypatch):
    """Cells that are launched over for a stroke, on fields of 16 times as many cells: the same."""
    counts = []
    for size in (2000.0, 8000.0):
        field = ControlField.blank((0.0, 0.0, size, size), 20.0)
        sim = Simulation(river(), plain_params(spacing=SPACING), controls=[field, *CONTROLS], device="cpu")
        sim.step()
        field.paint((1000.0, 1000.0), 200.0, 50.0)
        launched, launch = [], control_map.launch_kernel
        monkeypatch.setattr(
            control_map,
            "launch_kernel",
            lambda k, dim, *a, _l=launch, _n=launched, **o: (_n.append(np.prod(dim)), _l(k, dim, *a, **o)),
        )
        sim.step()
        monkeypatch.undo()
        counts.append(sum(launched))
        (stroke,) = sim.history.events.of(ControlStroke)
        assert stroke.rows <= 20 and stroke.columns <= 20
        assert field.raster.sample([(1000.0, 1000.0)])[0] > 49.0
    # Windows of 24 x 24 cells for both rasters and the field, and the blocks there, which may be one more or less each
    # way.
    assert abs(counts[0] - counts[1]) <= 6 and max(counts) < 6 * 24**2


# ---- what authors expect


def test_rivers_keep_off_repellers_and_near_attractors():
    """In the manner of [Paris2023], Fig. 14: 400 steps of spin-up, then 160 with a control before a growing bend."""
    params, reach = plain_params(), 1500.0
    mean, least = [], []
    for seed in (0, 2, 4):
        line = generate.noisy_line(10_000.0, 50.0, 200.0, seed)
        sim = Simulation(RiverNetwork.from_polylines([line], width=200.0), params, device="cpu")
        sim.step(400)
        start, begun = copy.deepcopy(sim.network), sim.network.points()
        sim.step(160)
        # 300 m beyond where the river comes to lie farthest from where it was.
        grown = sim.network.points()[len(begun) // 4 : -len(begun) // 4]
        away = np.array([np.hypot(*(begun - p).T).min() for p in grown])
        tip = grown[away.argmax()]
        foot = begun[np.hypot(*(begun - tip).T).argmin()]
        center = tuple(tip + 300.0 * (tip - foot) / away.max())
        found = []
        for controls in ([], [Repeller(center, reach)], [Attractor(center, reach)]):
            other = Simulation(start, params, controls=controls, device="cpu")
            other.step(160)
            found.append(np.hypot(*(other.network.points() - center).T))
        mean.append([d[d < 2.0 * reach].mean() for d in found])
        least.append([d.min() for d in found])
    mean, least = np.mean(mean, axis=0), np.array(least)
    # Measured: 1.14 and 0.95 times the mean without, and 0.57 to 0.60 of the radius away from the repeller; without it
    # 0.18 to 0.20.
    assert mean[1] > 1.08 * mean[0] and mean[2] < 0.99 * mean[0]
    assert (least[:, 1] > 0.3 * reach).all() and (least[:, 0] < 0.3 * reach).all()
    assert (least[:, 2] < least[:, 0]).all()


def test_damped_reaches_stay_straight_while_others_meander():
    """In the manner of [Paris2023], Fig. 27: held between mountains, free in the plain."""
    line = generate.noisy_line(24_000.0, 50.0, 100.0, 3)
    front = [(12_000.0, -9000.0), (30_000.0, -9000.0), (30_000.0, 9000.0), (12_000.0, 9000.0)]
    sim = Simulation(
        RiverNetwork.from_polylines([line], width=100.0),
        plain_params(),
        controls=[DampingRegion(front, 0.02, blend=1000.0)],
        device="cpu",
    )
    sim.step(900)
    xy = sim.network.points()
    parts = [xy[(xy[:, 0] > west) & (xy[:, 0] < east)] for west, east in ((1000.0, 11_000.0), (13_500.0, 23_000.0))]
    plain, held = (np.hypot(*np.diff(p, axis=0).T).sum() / np.hypot(*(p[-1] - p[0])) for p in parts)
    assert plain > 1.8 and held < 1.1


def test_a_river_follows_a_guide_that_lies_beside_it():
    """A straight reach is drawn by the floor alone, to where the field is highest."""
    x = np.arange(0.0, 6000.0, SPACING)
    straight = np.column_stack([x, np.zeros_like(x)])
    guide = Guide([(-999.0, 200.0), (7000.0, 200.0)], 600.0, 1.0)
    params = plain_params(spacing=SPACING, control_floor=0.1, end_damping=0.0)
    ground = Terrain(np.zeros((40, 80)), 100.0, (-500.0, 2000.0))
    sim = Simulation(river(straight), params, terrain=ground, controls=guide, device="cpu")
    sim.step(200)
    middle = sim.network.points()
    middle = middle[(middle[:, 0] > 2500.0) & (middle[:, 0] < 4000.0)]
    # In 58 yr, at 6 m/yr and less: the nearer the slower, as exp(-t / 29 yr) in the end; small bends have grown.
    assert 140.0 < middle[:, 1].mean() < 200.0 and np.abs(middle[:, 1] - 200.0).max() < 120.0


# ---- as edits


def bits_of(sim):
    fields = [control.raster.numpy() for control in sim.controls if isinstance(control, ControlField)]
    made = sim.stepper.state.controls
    stamped = [] if made is None else [made.raster.numpy(), made.factor.numpy()]
    return [sim.network.points(), sim.stepper.state.max_speed.numpy().copy(), *fields, *stamped]


def assert_bits(sim, expected):
    for a, b in zip(bits_of(sim), expected, strict=True):
        np.testing.assert_array_equal(a, b)


def test_controls_are_taken_back_and_set_again():
    """Whether they fit the raster, need another one, or are painted: to the bit, with the plan of the next step."""
    sim = wandering(controls=[*CONTROLS, painted_field()])
    sim.step(2)
    point = tuple(sim.network.polylines()[0][30].tolist())
    kinds = [
        lambda: setattr(sim, "controls", [*sim.controls[1:], Attractor((900.0, 2400.0), 700.0)]),
        lambda: sim.apply(edits.MovePoint(0, point, to=(point[0], point[1] + 60.0), radius=400.0)),
        lambda: sim.apply(SetControls([Attractor((900.0, 2400.0), 30.0), *sim.controls])),
        lambda: sim.apply(edits.PaintControl(3, (20, 30, 2, 3), np.arange(6.0))),
        lambda: sim.apply(SetControls(())),
    ]
    seen, events = [bits_of(sim)], [len(sim.history.events)]
    for do in kinds:
        do()
        seen.append(bits_of(sim))
        events.append(len(sim.history.events))
    last = copy.deepcopy(sim)
    for k in reversed(range(len(kinds))):
        sim.undo()
        assert_bits(sim, seen[k])
        assert len(sim.history.events) == events[k]
    for expected in seen[1:]:
        sim.redo()
        assert_bits(sim, expected)
    for each in (sim, last):
        each.step(4)
    assert_same(sim, last)


def test_what_was_painted_stays_when_another_edit_is_taken_back():
    field = painted_field()
    sim = wandering(controls=[field])
    point = tuple(sim.network.polylines()[0][30].tolist())
    sim.apply(edits.MovePoint(0, point, to=(point[0], point[1] + 60.0), radius=400.0))
    field.paint((700.0, 2600.0), 300.0, 150.0)
    sim.controls = [field, *CONTROLS]
    sim.undo()
    sim.undo()
    assert len(sim.history.events.of(ControlStroke)) == 1
    (found,) = controls_after(sim.history.events)
    assert found == field and field.raster.numpy().max() > 140.0


def test_a_session_with_controls_is_done_again_to_the_bit(tmp_path):
    """Of its history, of its file, and over a run that is resumed between an edit and the next step."""
    sim = wandering()
    start = copy.deepcopy(sim)
    act(sim, painted_field())
    edits.write_edits(tmp_path / "session.json", sim)
    for source in (sim.history, tmp_path / "session.json"):
        again = Simulation.replay(copy.deepcopy(start), source)
        assert_same(sim, again)
        assert again.controls == sim.controls and list(again.history.edits) == list(sim.history.edits)
    # Set after the last record, before the next step.
    sim.controls = [*sim.controls, Repeller((700.0, 2600.0), 500.0, 2.0)]
    resumed = Simulation.resume(copy.deepcopy(sim.history), terrain=sim.terrain, device="cpu")
    assert resumed.controls == sim.controls
    for each in (sim, resumed):
        each.step(5)
    assert_same(sim, resumed)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: SetControls("x"), "controls holds a str"),
        (lambda: SetControls([{"kind": "Magnet"}]), "is no control; it needs a kind"),
        (lambda: SetControls([{"kept": 7}]), "control 7 is to stay, and there are 4"),
        (lambda: SetControls([{"kind": "Attractor", "numbers": [1.0, 2.0]}]), "of the kind Attractor is damaged"),
        (lambda: edits.PaintControl(9, (0, 0, 1, 1), (1.0,)), "control 9 is no field"),
        (lambda: edits.PaintControl(0, (0, 0, 1, 1), (1.0,)), "control 0 is no field"),
        (lambda: edits.PaintControl(3, (0, 0, 1000, 1), np.zeros(1000)), "lies beyond the field"),
        (lambda: edits.PaintControl(3, (0, 0, 2, 2), (1.0,)), "give one for each of 2 x 2 cells"),
    ],
)
def test_edits_of_controls_that_cannot_be_are_refused(make, message):
    sim = wandering(controls=[*CONTROLS, painted_field()])
    before, events = bits_of(sim), len(sim.history.events)
    with pytest.raises(ValueError, match=message):
        sim.apply(make())
    assert_bits(sim, before)
    assert len(sim.history.events) == events
