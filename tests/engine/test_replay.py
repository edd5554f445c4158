"""Stages that are noted and replayed."""

import re
from pathlib import Path

import numpy as np
import pytest
import warp as wp
from devices import need_cpu

import warpriver
from warpriver.engine import replay
from warpriver.engine.replay import NATIVE_VERSIONS, LaunchList
from warpriver.engine.stages import Share, Stage, clear, launch, noted_launches, run_stages
from warpriver.errors import InternalError, WarpriverError
from warpriver.kernels.channels import Work

SHARE = Share(Work(), 1, 1)


@wp.kernel(enable_backward=False)
def add_one(value_io: wp.array[int]):
    """One more."""
    i = wp.tid()
    value_io[i] += 1


def test_the_installed_warp_is_one_that_replays_are_known_for():
    """Else launches are done one by one: see whether kernels are called as before, and add the version."""
    assert wp.__version__.rpartition(".")[0] in NATIVE_VERSIONS


@pytest.mark.parametrize("versions", [NATIVE_VERSIONS, ()])
def test_what_is_cleared_and_launched_is_replayed_in_order(monkeypatch, device, versions):
    """Also with a Warp that is not known: then each launch is done by itself."""
    need_cpu(device, "launches are noted on the CPU alone")
    monkeypatch.setattr(replay, "NATIVE_VERSIONS", versions)
    value = wp.full(5, 7, dtype=int, device="cpu")
    with noted_launches() as launches:
        launch(add_one, 5, [], [value], value.device)
        clear(value)
        launch(add_one, 3, [], [value], value.device)
    assert value.numpy().tolist() == [7] * 5
    LaunchList(launches).run()
    assert value.numpy().tolist() == [1, 1, 1, 0, 0]
    clear(value)
    assert not value.numpy().any()


def test_noting_ends_with_its_block_also_by_an_error(device):
    value = wp.zeros(3, dtype=int, device=device)
    with pytest.raises(ZeroDivisionError), noted_launches():
        raise ZeroDivisionError
    launch(add_one, 3, [], [value], value.device)
    assert value.numpy().tolist() == [1] * 3


@pytest.mark.parametrize("wrong", ["launch", "clear"])
def test_a_stage_that_cannot_be_recorded_is_refused(wrong, device):
    """What it does by Warp alone would be done once, while it is recorded, and never again."""
    need_cpu(device, "a GPU records whatever is launched")
    value = wp.zeros(3, dtype=int, device="cpu")
    runs = {
        "launch": lambda _: wp.launch(add_one, 3, [], [value], device="cpu"),
        "clear": lambda _: value.zero_(),
    }
    stage = Stage("drift", runs[wrong])
    run_stages([stage], SHARE, [SHARE])
    with pytest.raises(InternalError, match="stage of 'drift' cannot be recorded") as told, noted_launches():
        run_stages([stage], SHARE, [SHARE])
    assert isinstance(told.value, WarpriverError)


def test_steps_clear_and_launch_by_what_can_be_recorded():
    """In a stage that launches as well, what Warp does by itself could not be told from what is done once."""
    root = Path(warpriver.__file__).parent
    for room in ("engine", "meander", "shortest_path"):
        for path in sorted((root / room).glob("*.py")):
            loose = re.findall(r"\.(?:zero_|fill_)\(|wp\.launch\(|wp\.utils\.", path.read_text())
            assert not loose or path.name in ("stages.py", "replay.py"), f"{path}: {loose}; use clear and launch"


def test_an_empty_list_of_launches_does_nothing():
    LaunchList([]).run()


def test_launches_keep_what_they_use():
    """The arrays of a launch live as long as it does."""
    with noted_launches() as launches:
        value = wp.zeros(1000, dtype=int, device="cpu")
        other = wp.full(1000, 3, dtype=int, device="cpu")
        launch(add_one, 1000, [], [value], value.device)
        clear(other)
    places = value.ptr, other.ptr
    del value, other
    later = [wp.ones(1000, dtype=int, device="cpu") for _ in range(50)]
    assert not {array.ptr for array in later} & set(places)
    LaunchList(launches).run()
    assert np.array_equal(launches[0].fwd_args[0].numpy(), np.ones(1000, np.int32))
    assert all(array.numpy().all() for array in later)
