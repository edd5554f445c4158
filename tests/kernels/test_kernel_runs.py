"""Runs of points put into a new order, by ``gather_runs``, against taking point by point."""

import numpy as np
import pytest
import warp as wp
from kernel_arrays import SCALARS, chunk_count, points_of, to_device, unwritten, vec2_of

from warpriver.kernels import runs


@pytest.mark.parametrize("chunk", [1, 2, 7, 64, 4096])
def test_gather_runs_takes_points_and_scales_sections(device, dtype, chunk):
    """Runs of one point and of many, backwards, twice, and all the way; held against taking point by point."""
    scalar, rng = SCALARS[dtype], np.random.default_rng(0)
    kernel, vec2 = runs.build(scalar), vec2_of(scalar)
    xy = np.arange(400.0).reshape(200, 2)
    section = 1.0 + np.arange(400.0).reshape(200, 2)
    begin = np.array([90, 0, 199, 3, 3, 90, 100, 0])
    count = np.array([60, 1, 1, 40, 1, 2, 100, 200])
    start = np.concatenate([[0], np.cumsum(count)])
    scale = rng.integers(1, 9, (len(begin), 2)) / 4.0
    source = np.concatenate([np.arange(b, b + n) for b, n in zip(begin, count, strict=True)])
    for sections in (None, section):
        points, out = (unwritten(int(start[-1]) + 3, vec2, device) for _ in range(2))
        inputs = [points_of(scalar, to_device(xy, vec2, device), to_device(sections, vec2, device)), chunk]
        inputs += [to_device(a.astype(np.int32), wp.int32, device) for a in (begin, start)]
        inputs.append(None if sections is None else to_device(scale, vec2, device))
        threads = chunk_count(int(start[-1]) + 3, chunk)
        moved = points_of(scalar, points, out)
        wp.launch(kernel.gather_runs, dim=threads, inputs=inputs, outputs=[moved], device=device)
        np.testing.assert_array_equal(points.numpy()[:-3], xy[source])
        assert np.isnan(points.numpy()[-3:]).all() and np.isnan(out.numpy()[-3:]).all()
        if sections is None:
            assert np.isnan(out.numpy()).all()
        else:
            np.testing.assert_array_equal(out.numpy()[:-3], section[source] * np.repeat(scale, count, axis=0))
