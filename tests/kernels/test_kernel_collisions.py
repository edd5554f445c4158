import numpy as np
import pytest
import warp as wp
from kernel_arrays import SCALARS, chunk_count, forms, starts_of, to_device, unwritten, vec2_of

from warpriver.kernels import collisions

SPACING, WIDTH, REACH = 10.0, 12.0, 10.0


def random_lines(rng, count):
    """Smooth random walks that cross one another."""
    lines = []
    for _ in range(count):
        n = int(rng.integers(3, 70))
        heading = rng.uniform(0.0, 2.0 * np.pi) + np.cumsum(rng.normal(0.0, 0.25, n))
        xy = rng.uniform(-150.0, 150.0, 2) + SPACING * np.cumsum(np.stack([np.cos(heading), np.sin(heading)], 1), 0)
        lines.append(xy)
    return lines


def touching_pairs(lines, width, nodes):
    """All pairs (i, j) of points of different channels, i of the lower one, that touch away from shared nodes."""
    pairs, start = set(), starts_of(lines)
    for c in range(len(lines)):
        for d in range(c + 1, len(lines)):
            away = np.hypot(*(lines[c][:, None] - lines[d][None]).transpose(2, 0, 1))
            for i, j in np.argwhere(away < 0.5 * (width[c] + width[d])):
                arcs = [(i, len(lines[c]) - 1 - i), (j, len(lines[d]) - 1 - j)]
                reach = REACH * max(width[c], width[d])
                near = any(
                    nodes[c][a] == nodes[d][b] and SPACING * (arcs[0][a] + arcs[1][b]) < reach
                    for a in (0, 1)
                    for b in (0, 1)
                )
                if not near:
                    pairs.add((int(start[c] + i), int(start[d] + j)))
    return pairs


class Search:
    """Both kernels of the search, launched on some lines."""

    def __init__(self, lines, width, nodes, chunk, block, dtype, device):
        scalar = SCALARS[dtype]
        kernel, start = collisions.build(scalar), starts_of(lines)
        count, channels = int(start[-1]), len(lines)
        law = kernel.CollisionLaw()
        law.distance, law.node_reach, law.block = 1.0, REACH, block
        law.cell = 2.0 * (max(width) + block + 2.5 * SPACING)
        threads = chunk_count(count, chunk)
        xy = to_device(np.concatenate(lines), vec2_of(scalar), device)
        starts = to_device(start, wp.int32, device)
        spacing = to_device(np.full(channels, SPACING), scalar, device)
        links, owners = (unwritten(count, wp.int32, device) for _ in range(2))
        head, high = (wp.zeros(64, dtype=wp.int32, device=device) for _ in range(2))
        wp.launch(
            kernel.insert_blocks,
            dim=threads,
            inputs=[xy, starts, spacing, law, chunk],
            outputs=[links, owners, head, high],
            device=device,
        )
        form = forms(np.array(width), 1.0, np.array(width), SPACING, scalar, device)
        table = to_device(np.array(nodes, np.int32), wp.vec2i, device)
        by_chunk, total = unwritten(threads, wp.int32, device), wp.zeros(1, dtype=wp.int32, device=device)
        offset = wp.zeros(threads, dtype=wp.int32, device=device)
        inputs = [xy, None, starts, table, form, spacing, law, chunk, links, owners, head, high, offset]
        wp.launch(kernel.find_contacts, dim=threads, inputs=inputs, outputs=[None, by_chunk, total], device=device)
        self.count = int(total.numpy()[0])
        assert by_chunk.numpy().sum() == self.count
        wp.utils.array_scan(by_chunk, offset, inclusive=True)
        out = wp.zeros(max(self.count, 1), dtype=wp.vec2i, device=device)
        wp.launch(kernel.find_contacts, dim=threads, inputs=inputs, outputs=[out, by_chunk, total], device=device)
        self.contacts = [tuple(pair) for pair in out.numpy()[: self.count].tolist()]


@pytest.mark.parametrize("block", [1.0, 24.0, 200.0])
@pytest.mark.parametrize("chunk", [1, 7, 64, 4096])
def test_contacts_are_those_of_all_pairs(chunk, block, device):
    """Each block lists its first touching point, with the first partner of that point."""
    for seed in range(12):
        rng = np.random.default_rng(seed)
        lines = random_lines(rng, int(rng.integers(2, 9)))
        width = rng.uniform(5.0, 30.0, len(lines)).tolist()
        nodes = [(2 * c, 2 * c + 1) for c in range(len(lines))]
        pairs = touching_pairs(lines, width, nodes)
        start, step = starts_of(lines), max(1, int(block / SPACING))
        expected = {}
        for i, j in sorted(pairs):
            c = int(np.searchsorted(start, i, side="right")) - 1
            expected.setdefault((c, (i - int(start[c])) // step), (i, j))
        found = Search(lines, width, nodes, chunk, block, "float64", device)
        assert found.contacts == [expected[key] for key in sorted(expected)]


def test_points_near_a_shared_node_do_not_touch(device, dtype):
    """Two tributaries at 15 degrees and the channel below them: nothing within ten widths of their node counts."""
    angle = np.radians(7.5)
    away = SPACING * np.arange(40)[::-1, None]
    left, right = away * [-np.sin(angle), np.cos(angle)], away * [np.sin(angle), np.cos(angle)]
    below = SPACING * np.arange(40)[:, None] * [0.0, -1.0]
    nodes = [(0, 2), (1, 2), (2, 3)]
    lines, width = [left, right, below], [WIDTH] * 3
    assert Search(lines, width, nodes, 64, 24.0, dtype, device).contacts == []
    apart = [(0, 4), (1, 5), (2, 3)]
    assert Search(lines, width, apart, 64, 24.0, dtype, device).count > 0


def test_gather_points_takes_points_and_scales_sections(device, dtype):
    kernel, scalar = collisions.build(SCALARS[dtype]), SCALARS[dtype]
    vec2 = vec2_of(scalar)
    xy = np.arange(20.0).reshape(10, 2)
    section = 1.0 + np.arange(20.0).reshape(10, 2)
    source, scale = np.array([3, 3, 0, 9]), np.array([[1.0, 1.0], [2.0, 0.5], [1.0, 4.0], [0.5, 1.0]])
    for sections in (None, section):
        points, out = unwritten(4, vec2, device), unwritten(4, vec2, device)
        inputs = [to_device(xy, vec2, device), to_device(sections, vec2, device), to_device(source, wp.int32, device)]
        inputs.append(to_device(scale, vec2, device))
        wp.launch(kernel.gather_points, dim=4, inputs=inputs, outputs=[points, out], device=device)
        np.testing.assert_array_equal(points.numpy(), xy[source])
        if sections is not None:
            np.testing.assert_array_equal(out.numpy(), section[source] * scale)
