"""A step dealt out to slabs and threads, and done in sub-steps of each channel's own: the results are the same bits."""

import numpy as np
import pytest
from devices import assert_bits, need_cpu
from insides import loops_of, on_launch, shortcuts_of, tighten
from models import MODELS, assert_same, many_channels, plain
from plain import plain_params
from trees import assert_forest

from warpriver import MeanderParams, PathMeander, RiverNetwork, Simulation, Terrain, generate
from warpriver.engine import state as buffers
from warpriver.engine.stages import Stage, run_stages
from warpriver.kernels.status import DONE, FAULT
from warpriver.shortest_path import shortcuts

# Points of a slab: few, so that small networks have many.
SMALL = 200
WHOLE = buffers.SLAB_POINTS
# What rounding grows to in some 40 steps of gentle bends, m: measured up to 1e-7.
ROUNDING = 1e-5


@pytest.fixture(scope="module")
def references():
    """Each model run as one slab, stage by stage, by one thread."""
    done = {}

    def run(name, device):
        if (name, device) not in done:
            model, steps = MODELS[name]
            with pytest.MonkeyPatch.context() as patch:  # the test that asks first may have made slabs small
                patch.setattr(buffers, "SLAB_POINTS", WHOLE)
                sim = model(threads=1, capture=False, device=device)
                assert len(sim.stepper.state.slabs) == 1
                sim.run(steps=steps, record_every=10_000)
            done[name, device] = sim
        return done[name, device]

    return run


@pytest.mark.parametrize("name", MODELS)
def test_the_models_do_what_is_looked_for(references, name, device):
    """Else the tests below would compare runs in which nothing happens."""
    sim = references(name, device)
    assert len(sim.history.cutoffs) > 0 or name in ("on hills", "tree in parts") or "rings in two" in name
    if "rings in two" in name:
        assert len(sim.history.splits) > 2 and sim.network.channel_id[-1] == sim.history.splits[-1].other
        assert sim.network.channel_count > 4
    if "tree" in name or name == "paths in parts":
        assert len(sim.history.collisions) > 2
    if name in ("varied", "on hills", "tree in parts", "paths in parts", "rings"):
        assert sim.substeps > 1
    if name in ("on hills", "tree in parts", "paths in parts"):
        parts = sim.stepper.state.channel_substeps.numpy()[: sim.network.channel_count]
        assert (parts < sim.substeps).any(), "some rest now and then"


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("name", MODELS)
def test_slabs_and_threads_change_no_bit(references, monkeypatch, name, threads, device):
    need_cpu(device, "a GPU has neither slabs nor threads")
    monkeypatch.setattr(buffers, "SLAB_POINTS", SMALL)
    model, steps = MODELS[name]
    sim = model(threads=threads, device=device)
    assert len(sim.stepper.state.slabs) > 3
    sim.run(steps=steps, record_every=10_000)
    assert_same(sim, references(name, device))


WAYS = ({"capture": False}, {"check": True}, {"threads": 2})
SLABS = (90, 140, 1000)
# Each model in each way, with slabs of every size, and each way with each size. Where nothing is replayed many slabs
# take long: the longest models have the smallest ones where threads replay them.
DEALT = [
    (name, way, SLABS[(first + k) % len(SLABS)])
    for name, first in {"on hills": 2, "tree": 1, "paths in parts": 1, "rings in two": 0}.items()
    for k, way in enumerate(WAYS)
]


@pytest.mark.parametrize(("name", "options", "points"), DEALT, ids=str)
def test_any_slabs_plain_checked_or_replayed_are_equal_to_the_bit(
    references, monkeypatch, name, options, points, device
):
    monkeypatch.setattr(buffers, "SLAB_POINTS", points)
    model, steps = MODELS[name]
    sim = model(**options, device=device)
    sim.run(steps=steps, record_every=10_000)
    assert_same(sim, references(name, device))


@pytest.mark.parametrize("name", ["plain", "tree in parts", "paths", "paths in parts", "rings in two"])
def test_growing_buffers_of_slabs_changes_nothing(references, monkeypatch, name, device):
    """Of points, cutoffs, oxbow points and shortcuts, in the middle of steps that several threads do."""
    monkeypatch.setattr(shortcuts, "SHORTCUTS_PER_POINT", 0.0)
    monkeypatch.setattr(shortcuts, "MINIMUM_SHORTCUTS", 1)
    monkeypatch.setattr(buffers, "SLAB_POINTS", SMALL)
    model, steps = MODELS[name]
    sim = model(threads=3, device=device)
    tighten(sim)
    points = sim.stepper.state.point_capacity
    sim.run(steps=steps, record_every=10_000)
    assert loops_of(sim).oxbow_capacity > 4
    assert sim.stepper.state.point_capacity > points or name not in ("plain", "paths")
    if "paths" in name:
        assert shortcuts_of(sim).capacity > 1
    assert_same(sim, references(name, device))


@pytest.mark.parametrize(("batch", "tight"), [(2, False), (8, True)], ids=["roomy", "tight"])
@pytest.mark.parametrize("name", [name for name in MODELS if "in two" not in name])
def test_sub_steps_in_batches_change_no_bit(references, monkeypatch, name, batch, tight, device):
    """As a GPU does them: the host looks after so many, and those behind an event or a fault change nothing."""
    monkeypatch.setattr(shortcuts, "MINIMUM_SHORTCUTS", 1)
    # Few, since batches of every length are recorded slab by slab, anew whenever buffers grow.
    monkeypatch.setattr(buffers, "SLAB_POINTS", 3 * SMALL)
    model, steps = MODELS[name]
    sim = model(threads=2, device=device)
    assert device != "cpu" or len(sim.stepper.state.slabs) > 2
    if tight:
        tighten(sim)
    asked, done = [], []

    def note(status, count):
        asked.append(count)
        done.append(status[DONE])

    sim.stepper.batch_limit = batch
    on_launch(sim, note)
    sim.run(steps=steps, record_every=10_000)
    assert set(asked) <= {1, 2, 4, 8} and max(asked) == max(done) == batch
    if "tree" in name or tight:
        assert (np.array(done) < asked).any(), "none was halted"
    assert_same(sim, references(name, device))


@pytest.mark.parametrize("name", MODELS)
def test_chunks_as_a_gpu_takes_them_come_to_the_same(monkeypatch, name, device):
    """All of a step in chunks of 32 points: in a batch, in buffers that grow, and one by one the same bits.

    Slabs give those to rounding: sums along channels are made of other parts. The lines of the trees are full of tight
    bends and lose 76 loops in the first step: there a difference grows ten to forty times a step, to 1e-6 m in three.
    """
    need_cpu(device, "a GPU has no slabs to compare with")
    model, steps = MODELS[name]
    slabs = model(threads=1, device=device)
    monkeypatch.setattr(buffers, "CPU_CHUNK", 32)
    alone, batch, tight = (model(device=device) for _ in range(3))
    tighten(tight)
    batch.stepper.batch_limit = 8 if "in two" not in name else 1
    state = alone.stepper.state
    assert state.whole.point_threads > alone.network.point_count // 32 and len(state.slabs) == 1
    slabs.run(steps=3, record_every=10_000)
    alone.run(steps=3, record_every=10_000)
    allowed = 1e-4 if slabs.network.dtype == "float64" else 1.0
    assert slabs.network.channel_count == alone.network.channel_count
    for a, b in zip(alone.network.polylines(), slabs.network.polylines(), strict=True):
        np.testing.assert_allclose(a, b, rtol=0.0, atol=allowed)
    for sim in (alone, batch, tight):
        sim.run(steps=steps - sim.step_count, record_every=10_000)
    assert_same(batch, alone)
    assert_same(tight, alone)


def test_slabs_hold_every_channel_once(monkeypatch, device):
    need_cpu(device, "a GPU deals out chunks")
    monkeypatch.setattr(buffers, "SLAB_POINTS", SMALL)
    sim = plain(device=device)
    slabs, start = sim.stepper.state.slabs, sim.network.starts()
    assert [slab.work.first for slab in slabs] == list(range(len(slabs)))
    bounds = sim.stepper.state.whole.work.slab_channel.numpy()
    assert len(bounds) == len(slabs) + 1
    assert bounds[0] == 0 and bounds[-1] == sim.network.channel_count and (np.diff(bounds) >= 0).all()
    used = np.flatnonzero(np.diff(bounds))
    assert len(used) > 3 and (used == np.arange(len(used))).all(), "slabs without channels lie behind the others"
    # A slab ends before the channel that begins in the next one's points.
    assert max(np.diff(start[bounds])) < SMALL + np.diff(start).max()


def test_a_thread_does_shared_stages_in_a_row_slab_by_slab():
    done = []
    stages = [
        Stage(name, lambda share, name=name: done.append((name, share)), shared)
        for name, shared in (("a", True), ("b", True), ("c", False), ("d", True))
    ]
    run_stages(stages, "whole", ["left", "right"])
    assert done == [
        ("a", "left"), ("b", "left"), ("a", "right"), ("b", "right"), ("c", "whole"), ("d", "left"), ("d", "right"),
    ]  # fmt: skip


@pytest.mark.parametrize("threads", [0, -1, 1.5])
def test_a_number_of_threads_that_is_none_is_refused(threads):
    with pytest.raises(ValueError, match=r"threads is .*; give a whole number"):
        plain(threads=threads)


# ---- sub-steps


class Watched(Simulation):
    """Notes the step of every channel in every sub-step, which it does one by one."""

    def __init__(self, *arguments, **options):
        super().__init__(*arguments, **options)
        self.watched = []
        self.stepper.batch_limit = 1
        on_launch(self, self.note)

    def note(self, status, count):
        if status[FAULT] == 0:  # else it is repeated
            step = self.stepper.state.step.numpy()[: self.network.channel_count].copy()
            self.watched.append((self.step_count, step))


def by_step(sim, steps):
    """What a watched simulation noted, by time step."""
    return [[step for k, step in sim.watched if k == number] for number in range(steps)]


def mixed(kind, *widths):
    """One river of each width side by side, each with points a width apart, about one origin."""
    lines = []
    for k, width in enumerate(widths):
        length = 60.0 * width
        lines.append(generate.noisy_line(length, width, width, k) + [-0.5 * length, 20_000.0 * k])
    alike = {"reference_width": 0.0} if kind is plain_params else {}  # each channel as if it were alone
    params = kind(spacing_in_widths=1.0, spacing=1000.0, time_step=1.0, collision_distance=0.0, **alike)
    return RiverNetwork.from_polylines(lines, width=list(widths)), params


def alone(network, c):
    """A network of one channel of another, about the same origin, so that its coordinates are the same numbers."""
    first, stop = network.starts()[c : c + 2]
    return RiverNetwork(
        network.point_xy.numpy()[first:stop],
        [0, stop - first],
        channel_width=network.channel_width[c : c + 1],
        channel_depth=network.channel_depth[c : c + 1],
        channel_discharge=network.channel_discharge[c : c + 1],
        origin=network.origin,
    )


@pytest.mark.parametrize("small", [False, True], ids=["one slab", "slabs"])
@pytest.mark.parametrize("widths", [(90.0, 12.0), (12.0, 90.0), (10.0, 60.0, 25.0, 14.0)], ids=str)
@pytest.mark.parametrize("kind", [plain_params, PathMeander])
def test_channels_take_their_own_sub_steps(monkeypatch, kind, widths, small, device):
    """A narrow river does not make a wide one work more: each is, to the bit, as it would be alone.

    On a GPU chunks begin elsewhere in a network of one channel, so that sums along it are rounded otherwise.
    """
    if small:
        monkeypatch.setattr(buffers, "SLAB_POINTS", 70)
    network, params = mixed(kind, *widths)
    sim = Watched(network, params, device=device)
    steps = 40
    sim.run(steps=steps, record_every=1000)
    taken, asked = by_step(sim, steps), []
    for c in range(len(widths)):
        own = Watched(alone(network, c), params, device=device)
        own.run(steps=steps, record_every=1000)
        asked.append([len(parts) for parts in by_step(own, steps)])
        line = own.network.point_xy.numpy()[: own.network.point_count]
        first, stop = sim.network.starts()[c : c + 2]
        assert_bits(sim.network.point_xy.numpy()[first:stop], line, device, ROUNDING)
        assert_bits(sim.stepper.state.spacing.numpy()[c], own.stepper.state.spacing.numpy()[0], device, ROUNDING)
        cut = [cutoff for cutoff in sim.history.cutoffs if cutoff.channel == c]
        for a, b in zip(cut, own.history.cutoffs, strict=True):
            assert_bits(a.xy, b.xy, device, ROUNDING)
    assert len({tuple(a) for a in asked}) > 1 and max(asked[int(np.argmin(widths))]) > 1
    for k, parts in enumerate(taken):
        parts = np.array(parts)
        assert ((parts > 0.0).sum(axis=0) == [a[k] for a in asked]).all() and len(parts) == max(a[k] for a in asked)
        assert (parts[0] > 0.0).all(), "all move in the first"
        np.testing.assert_allclose(parts.sum(axis=0), params.time_step, rtol=1e-12)


def test_a_step_of_one_part_is_every_channels_own(device):
    network, params = mixed(MeanderParams, 90.0, 60.0)
    sim = Watched(network, params.replace(time_step=0.1), device=device)
    sim.run(steps=5)
    assert sim.substeps == 1 and all((step == 0.1).all() for _, step in sim.watched)


@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("slope", [0.15, 0.5])
def test_on_ground_too_steep_no_bit_changes(dtype, slope, device):
    """Points are neither moved nor sampled anew, on a slope and where there is no ground at all."""
    network = many_channels(4, varied=True)
    west, _, _, north = network.bounds()
    height = 50.0 * slope * (1.0 + 1e-5) * np.arange(140) * np.ones((300, 1))
    height[60:80] = np.nan
    ground = Terrain(height, 50.0, origin=(west - 500.0, north + 500.0))
    sim = Simulation(network, plain_params(spacing=25.0), terrain=ground, dtype=dtype, device=device)
    before = sim.network.point_xy.numpy().copy()
    section, spacing = sim.network.point_section.numpy().copy(), sim.stepper.state.spacing.numpy().copy()
    for _ in range(5):
        sim.step()
        assert sim.substeps == 1 and not sim.stepper.state.step.numpy().any()
        np.testing.assert_array_equal(sim.network.point_xy.numpy(), before)
        np.testing.assert_array_equal(sim.network.point_section.numpy(), section)
        np.testing.assert_array_equal(sim.stepper.state.spacing.numpy(), spacing)


def test_a_held_channel_rests_beside_one_that_moves(device):
    """West of the middle the ground is too steep and east of it flat: as if each had its own ground."""
    lines = [generate.noisy_line(2000.0, 25.0, 30.0, k) + [4000.0 * k, 0.0] for k in range(2)]
    network = RiverNetwork.from_polylines(lines, width=30.0)
    height = np.zeros((100, 200))
    height[:, :70] = 0.3 * 50.0 * np.arange(70)
    ground = Terrain(height, 50.0, origin=(-1000.0, 2500.0))
    params = plain_params(spacing=25.0, time_step=1.0)
    sim, flat = Watched(network, params, terrain=ground, device=device), Watched(network, params, device=device)
    before = sim.network.polylines()[0]
    for _ in range(30):
        sim.step()
        flat.step()
    assert sim.substeps == flat.substeps > 1
    np.testing.assert_array_equal(sim.network.polylines()[0], before)
    steps = np.array([step for _, step in sim.watched])
    assert not steps[:, 0].any() and steps[:, 1].any()
    # Flat ground is as no ground, but the chunks of a GPU begin elsewhere.
    assert_bits(sim.network.polylines()[1][:40], flat.network.polylines()[1][:40], device, ROUNDING)


@pytest.mark.parametrize("name", ["on hills", "tree in parts", "paths in parts", "rings", "rings in two"])
@pytest.mark.parametrize("stop", [7, 30])
def test_a_run_resumed_is_equal_to_the_bit(references, monkeypatch, tmp_path, name, stop, device):
    """With ground and sub-steps, and dealt out otherwise after the stop than before."""
    model, steps = MODELS[name]
    whole = references(name, device)
    half = model(device=device)
    half.run(steps=stop, store=tmp_path / "run")
    monkeypatch.setattr(buffers, "SLAB_POINTS", SMALL)
    rest = Simulation.resume(tmp_path / "run", terrain=whole.terrain, threads=2, device=device)
    rest.run(steps=steps - stop, record_every=10_000)
    assert_same(rest, whole)
    if name != "on hills" and "rings" not in name:
        assert_forest(rest.network)


@pytest.mark.parametrize("chunk", [0, 32])
@pytest.mark.parametrize("name", ["plain", "varied", "rings", "single precision"])
def test_to_look_for_links_where_there_are_none_changes_no_bit(name, chunk, monkeypatch):
    """A river that was one in two channels, or had a locked point, is looked at as if it still were."""
    monkeypatch.setattr(buffers, "CPU_CHUNK", chunk)
    never, once = MODELS[name][0](), MODELS[name][0]()
    once.stepper.state.stems.joined = once.stepper.state.stems.locked = True
    once.stepper.state.changed()
    for sim in (never, once):
        sim.step(30)
    assert_same(never, once)
