"""Frames: what is written is read again, and nothing else is."""

import dataclasses

import numpy as np
import pytest

from warpriver.raster import Raster
from warpriver.studio.frames import (
    LOOPS,
    MAP,
    PATCH,
    State,
    decode_state,
    encode_loops,
    encode_map,
    encode_patch,
    encode_state,
)


def state():
    rng = np.random.default_rng(0)
    return State(
        3, 4, 5, 1.5, 0.25, True, np.array([0.0, 2.0**50, 7.0]), rng.random((3, 4), np.float32),
        np.array([0, 4, 4, 9], np.uint32), rng.random((9, 2), np.float32),
    )  # fmt: skip


def test_a_state_comes_back_and_lies_as_a_browser_needs_it():
    given = state()
    frame = encode_state(given)
    found = decode_state(frame)
    for name in ("sequence", "edits", "step", "time", "step_ms", "playing"):
        assert getattr(found, name) == getattr(given, name)
    for name in ("channel_id", "channel_size", "channel_start", "point_xy"):
        np.testing.assert_array_equal(getattr(found, name), getattr(given, name))
    # Doubles from a multiple of 8, and 8 bytes a point beyond the channels: 10,000 points are 80 kB.
    assert len(frame) == 48 + 3 * (8 + 16) + 4 * 4 + 9 * 8


def test_widths_that_vary_are_sent_in_fine_steps():
    given = state()
    width = np.linspace(3.0, 90.0, 9)
    frame = encode_state(dataclasses.replace(given, point_width=width))
    assert len(frame) == len(encode_state(given)) + 2 * 9
    # Half a step of 90 / 65535 m.
    np.testing.assert_allclose(decode_state(frame).point_width, width, atol=7e-4)
    assert decode_state(encode_state(given)).point_width is None


def test_a_map_comes_in_steps_with_its_place():
    raster = Raster(np.array([[0.0, 5.0], [10.0, np.nan]]), 20.0, (100.0, 40.0))
    frame = encode_map("age", raster, 0.0, 10.0, np.array([90.0, 10.0]))
    assert np.frombuffer(frame, "<u4", 3).tolist() == [MAP, 2, 2]
    assert np.frombuffer(frame, "<f8", 5, 16).tolist() == [10.0, 30.0, 20.0, 0.0, 10.0]
    assert frame[56:72].rstrip(b"\0") == b"age"
    assert list(frame[72:]) == [0, 127, 254, 255]


@pytest.mark.parametrize(
    "change", [lambda f: f[:-1], lambda f: f + b"\0", lambda f: f[:20], lambda f: b"\2" + f[1:], lambda f: b""]
)
def test_what_is_no_state_is_refused(change):
    with pytest.raises(ValueError, match=r"is no state|shorter than its header"):
        decode_state(change(encode_state(state())))


def test_patches_and_loops():
    frame = encode_patch("control", (2, 3, 2, 4), np.arange(8.0).reshape(2, 4))
    assert np.frombuffer(frame, "<u4", 6).tolist() == [PATCH, 1, 2, 3, 2, 4]
    np.testing.assert_array_equal(np.frombuffer(frame, "<f4", offset=32), np.arange(8.0))
    lines = [np.array([[10.0, 20.0], [11.0, 20.0]]), np.array([[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]])]
    frame = encode_loops(lines, [5.0, 6.0], [0.5, 7.0], 1, (10.0, 10.0))
    assert np.frombuffer(frame, "<u4", 4).tolist() == [LOOPS, 1, 2, 5]
    assert np.frombuffer(frame, "<f4", 2, 16).tolist() == [5.0, 6.0]
    assert np.frombuffer(frame, "<f4", 2, 24).tolist() == [0.5, 7.0]
    assert np.frombuffer(frame, "<u4", 3, 32).tolist() == [0, 2, 5]
    np.testing.assert_array_equal(
        np.frombuffer(frame, "<f4", 10, 44).reshape(5, 2), np.concatenate(lines) - [10.0, 10.0]
    )
