"""A blend-flow tree as a small program for each cell of a grid: only what reaches a cell, in a fixed order."""

from __future__ import annotations

import dataclasses
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from warpriver.arrays import FlagArray, FloatArray, IndexArray
from warpriver.errors import InputError
from warpriver.extras import IMPORTING
from warpriver.kernels import flow_tree as kernels
from warpriver.riverscape.primitives import Merge, Node, Primitives, Replace
from warpriver.riverscape.sorting import boxes, grouped, stable_order

__all__ = ["CELLS_ACROSS", "Programs", "TileFrame", "write_programs"]

Codes: TypeAlias = NDArray[np.int32]
# Cells along the side of a tile, places in which are relative to its corner.
CELLS_ACROSS = 64
# Leaves whose cells are found at once.
ROWS_AT_ONCE = 2**14
# Cells of all wet tiles at most.
MOST_CELLS = 2**27


@dataclasses.dataclass(frozen=True)
class TileFrame:
    """What the numbers of a water's tiles are relative to: waters of one frame give the same bits where they are alike.

    Attributes:
        cell_size: m.
        origin: (x, y) of the corner that tiles are counted from, in tiles.
        tile: (n, 2) column and row of tiles whose datum is known; none: those of the water that the frame is given to.
        datum: (n,) m, whole numbers.
    """

    cell_size: float
    origin: tuple[int, int]
    tile: IndexArray
    datum: FloatArray

    def datum_of(self, tile: IndexArray) -> FloatArray:
        """Return the datum of tiles, (n, 2): that of the nearest known one."""
        with IMPORTING:
            from scipy.spatial import cKDTree
        return np.asarray(self.datum[cKDTree(self.tile).query(tile)[1]])


@dataclasses.dataclass(frozen=True)
class Programs:
    """Programs of all wet cells, and the tiles that the cells lie in.

    Attributes:
        rows: All leaves, in the order of the tree.
        frame: What numbers are relative to.
        origin: West and south corner of the frame, m.
        cell_size: m.
        tile_corner: Column and row of the first tile, counted from there.
        tile_shape: Rows and columns of tiles.
        tile_first: (tiles,) first cell of a tile, -1 where it is dry.
        tile_datum: (tiles,) m, whole numbers.
        row_tile: (n,) tile of each leaf's centre.
        cell_start: (cells + 1,) first code of each cell.
        code: Programs, one after the other.
    """

    rows: Primitives
    frame: TileFrame
    origin: tuple[float, float]
    cell_size: float
    tile_corner: tuple[int, int]
    tile_shape: tuple[int, int]
    tile_first: IndexArray
    tile_datum: FloatArray
    row_tile: IndexArray
    cell_start: Codes
    code: Codes


@dataclasses.dataclass
class _Tree:
    """Inner nodes and blocks of leaves as a table; the root is node 0, parents come before their children."""

    parent: IndexArray
    depth: IndexArray
    # Which child of its parent: of a replacement 0 is what is replaced.
    place: IndexArray
    # "b"lock, "m"erge or "r"eplace.
    sort: NDArray[np.str_]
    fresh: FlagArray
    block_rows: list[Primitives]
    block_node: IndexArray


@dataclasses.dataclass
class _Entries:
    """Nodes at one depth of the tree in the cells that they reach, sorted by cell and node."""

    cell: IndexArray
    node: IndexArray
    length: IndexArray
    start: IndexArray


def write_programs(tree: Node, cell_size: float | None = None, frame: TileFrame | None = None) -> Programs:
    """Compile a tree.

    A node that does not reach a cell is left out there: merge(0, B) = B, replace(A, 0) = A, replace(0, B) = 0.

    Args:
        tree: Primitives, merged and replaced.
        cell_size: m; by default such that most primitives reach a few cells.
        frame: That of another water, to give the same bits where both are alike; it has a cell size.

    Raises:
        ValueError: A tree without leaves, or deeper than the stack.
        MemoryError: More cells than can be held.
    """
    table = _tabulate(tree)
    rows = Primitives.concatenate(table.block_rows)
    if frame is not None:
        cell_size = frame.cell_size
    size = float(np.quantile(rows.radius, 0.1, method="lower")) if cell_size is None else cell_size
    counts = [len(block) for block in table.block_rows]
    row_node = np.repeat(table.block_node, counts)
    pair_row, column, line = _reached_cells(rows, size)
    # Tiles are counted from a corner that does not depend on where the leaves lie.
    tile_x, tile_y = column // CELLS_ACROSS, line // CELLS_ACROSS
    west, south = int(tile_x.min()), int(tile_y.min())
    columns, lines = int(tile_x.max()) - west + 1, int(tile_y.max()) - south + 1
    tile = (tile_y - south) * columns + tile_x - west
    wet = np.zeros(columns * lines, bool)
    wet[tile] = True
    slots = int(wet.sum())
    if slots * CELLS_ACROSS**2 > MOST_CELLS:
        raise InputError(
            f"the water would need {slots * CELLS_ACROSS**2:.3g} cells of {size:g} m, {MOST_CELLS:.3g} at most; "
            "use a coarser detail or a part of it"
        )
    tile_first = np.where(wet, (np.cumsum(wet) - 1) * CELLS_ACROSS**2, -1)
    cell = tile_first[tile] + line % CELLS_ACROSS * CELLS_ACROSS + column % CELLS_ACROSS
    known = np.column_stack([np.flatnonzero(wet) % columns + west, np.flatnonzero(wet) // columns + south])
    datum = np.zeros(len(wet))
    if frame is None or not len(frame.tile):
        weight = np.bincount(tile, minlength=len(wet))
        total = np.bincount(tile, rows.level[pair_row], len(wet))
        datum[wet] = np.round(total[wet] / weight[wet])
        frame = TileFrame(size, (west, south) if frame is None else frame.origin, known, datum[wet])
    else:
        datum[wet] = frame.datum_of(known)
    corner = (west - frame.origin[0], south - frame.origin[1])
    home = np.floor(rows.center / size).astype(np.int64) // CELLS_ACROSS - (west, south)
    side = CELLS_ACROSS * size
    cell_start, code = _emit(table, cell, row_node[pair_row], pair_row, slots * CELLS_ACROSS**2)
    return Programs(
        rows=rows,
        frame=frame,
        origin=(frame.origin[0] * side, frame.origin[1] * side),
        cell_size=size,
        tile_corner=corner,
        tile_shape=(lines, columns),
        tile_first=tile_first,
        tile_datum=datum,
        row_tile=home[:, 1] * columns + home[:, 0],
        cell_start=cell_start,
        code=code,
    )


def _tabulate(tree: Node) -> _Tree:
    """List the nodes of a tree, parents first."""
    found: list[tuple[int, int, int, str, bool]] = []
    blocks: list[Primitives] = []
    block_node: list[int] = []
    waiting: list[tuple[Node, int, int, int, bool]] = [(tree, -1, 0, 0, True)]
    while waiting:
        node, parent, depth, place, fresh = waiting.pop()
        number = len(found)
        if isinstance(node, Primitives):
            found.append((parent, depth, place, "b", fresh))
            blocks.append(node)
            block_node.append(number)
        elif isinstance(node, Merge):
            found.append((parent, depth, place, "m", fresh))
            inner = [(child, number, depth + 1, k, fresh and k == 0) for k, child in enumerate(node.children)]
            waiting += inner[::-1]
        elif isinstance(node, Replace):
            found.append((parent, depth, place, "r", fresh))
            waiting += [(node.over, number, depth + 1, 1, True), (node.under, number, depth + 1, 0, True)]
        else:
            raise InputError(f"a water's tree has a {type(node).__name__}; use Primitives, Merge and Replace")
    if not sum(len(block) for block in blocks):
        raise InputError("the tree has no primitives; give at least one")
    parents, depths, places, sorts, freshes = zip(*found, strict=True)
    return _Tree(
        np.array(parents), np.array(depths), np.array(places), np.array(sorts), np.array(freshes), blocks,
        np.array(block_node),
    )  # fmt: skip


def _reached_cells(rows: Primitives, size: float) -> tuple[IndexArray, IndexArray, IndexArray]:
    """Pairs of a leaf and a cell that its disc reaches: row, column and line of the cell, row by row."""
    low = np.floor((rows.center - rows.radius[:, None]) / size).astype(np.int64)
    high = np.floor((rows.center + rows.radius[:, None]) / size).astype(np.int64)
    count = int((high - low + 1).prod(axis=1).sum())
    if count > 2**30:
        raise InputError(f"the water's primitives reach {count:.3g} cells of {size:g} m; use larger cells")
    # A part at a time, which stays in the cache.
    parts = [_reached(rows, low, high, size, k, k + ROWS_AT_ONCE) for k in range(0, len(rows), ROWS_AT_ONCE)]
    row, column, line = (np.concatenate(part) for part in zip(*parts, strict=True))
    return row, column, line


def _reached(
    rows: Primitives, low: IndexArray, high: IndexArray, size: float, first: int, stop: int
) -> tuple[IndexArray, IndexArray, IndexArray]:
    """As ``_reached_cells``, of the rows from ``first`` to ``stop``."""
    low, radius = low[first:stop], rows.radius[first:stop]
    row, column, line = boxes(low, high[first:stop])
    # Distance from the centre to the nearest place of the cell, by the distance from the corner of its box.
    inside = rows.center[first:stop] - low * size
    square = np.zeros(len(row))
    for k, cell in enumerate((column, line)):
        away = inside[:, k].copy()[row] - (cell - low[:, k].copy()[row]) * size
        away -= np.clip(away, 0.0, size)
        square += away * away
    near = np.flatnonzero(square < (radius**2)[row])
    return row[near] + first, column[near], line[near]


def _emit(tree: _Tree, cell: IndexArray, node: IndexArray, row: IndexArray, cells: int) -> tuple[Codes, Codes]:
    """Write the programs: lengths from the leaves up, places from the root down, each depth of the tree at once.

    Returns:
        First code of each cell, and all codes.
    """
    nodes = len(tree.parent)
    key = cell * nodes + node
    order = stable_order(key)
    key, row = key[order], row[order]
    first = np.flatnonzero(np.diff(key, prepend=-1))
    count = np.diff(first, append=len(key))
    blocks = _Entries(key[first] // nodes, key[first] % nodes, count, np.zeros(len(first), np.int64))
    depth_of = tree.depth[blocks.node]
    deepest = int(tree.depth.max())
    levels: list[_Entries] = [_Entries(*(np.empty(0, np.int64) for _ in range(4)))] * (deepest + 2)
    for depth in range(deepest, -1, -1):
        here = depth_of == depth
        own = (blocks.cell[here], blocks.node[here], blocks.length[here])
        inner = _parents(tree, levels[depth + 1], nodes)
        joined = [np.concatenate(pair) for pair in zip(own, inner, strict=True)]
        by = stable_order(joined[0] * nodes + joined[1])
        levels[depth] = _Entries(joined[0][by], joined[1][by], joined[2][by], np.full(len(by), -1))
    top = levels[0]
    total = int(top.length.sum())
    if total >= 2**31:
        raise InputError(f"the programs of the water's cells are {total:.3g} numbers long, 2.1e9 at most; use a part")
    cell_start = np.zeros(cells + 1, np.int32)
    cell_start[1:][top.cell] = top.length
    np.cumsum(cell_start, out=cell_start)
    code = np.zeros(total, np.int32)
    top.start[:] = cell_start[top.cell]
    for depth in range(deepest):
        _place_children(tree, levels[depth], levels[depth + 1], nodes, code)
    _write_leaves(levels, blocks, depth_of, row, count, code, nodes)
    _check_depth(code)
    return cell_start, code


def _parents(tree: _Tree, children: _Entries, nodes: int) -> tuple[IndexArray, IndexArray, IndexArray]:
    """Cell, node and length of the inner nodes whose children reach cells; replace(0, B) = 0 drops B."""
    if not len(children.cell):
        return children.cell, children.node, children.length
    key = children.cell * nodes + tree.parent[children.node]
    keys, group = grouped(key)
    cell, node = keys // nodes, keys % nodes
    replacing = tree.sort[node] == "r"
    under = np.zeros(len(keys), bool)
    over = np.zeros(len(keys), bool)
    place = tree.place[children.node]
    under[group[place == 0]] = True
    over[group[place > 0]] = True
    length = np.bincount(group, children.length, len(keys)).astype(np.int64)
    # A B: A OPEN B REPLACE; where sums have begun already the whole is OPEN ... MERGE.
    length += np.where(replacing, 2 * over + 2 * ~tree.fresh[node], 0)
    kept = under | ~replacing
    return cell[kept], node[kept], length[kept]


def _place_children(tree: _Tree, above: _Entries, below: _Entries, nodes: int, code: Codes) -> None:
    """Say where the programs of nodes begin, from where their parents' begin, and write the parents' codes."""
    parent_key = below.cell * nodes + tree.parent[below.node]
    above_key = above.cell * nodes + above.node
    at = np.searchsorted(above_key, parent_key)
    at = np.minimum(at, len(above_key) - 1)
    alive = (above_key[at] == parent_key) & (above.start[at] >= 0)
    child = np.flatnonzero(alive)
    places = int(tree.place.max()) + 1
    child = child[stable_order(at[child] * places + tree.place[below.node[child]])]
    owner = at[child]
    length = below.length[child]
    before = np.cumsum(length) - length
    first = np.flatnonzero(np.diff(owner, prepend=-1))
    before -= np.repeat(before[first], np.diff(first, append=len(owner)))
    replacing = tree.sort[above.node[owner]] == "r"
    opened = replacing & ~tree.fresh[above.node[owner]]
    second = replacing & (tree.place[below.node[child]] == 1)
    below.start[child] = above.start[owner] + before + opened + second
    code[below.start[child[second]] - 1] = kernels.OPEN
    code[below.start[child[second]] + length[second]] = kernels.REPLACE
    wrapped = (tree.sort[above.node] == "r") & ~tree.fresh[above.node] & (above.start >= 0)
    code[above.start[wrapped]] = kernels.OPEN
    code[above.start[wrapped] + above.length[wrapped] - 1] = kernels.MERGE


def _write_leaves(
    levels: list[_Entries],
    blocks: _Entries,
    depth_of: IndexArray,
    row: IndexArray,
    count: IndexArray,
    code: Codes,
    nodes: int,
) -> None:
    """Write the numbers of the leaves of each block, in the order of the rows."""
    start = np.full(len(blocks.cell), -1)
    for depth, entries in enumerate(levels[:-1]):
        here = np.flatnonzero(depth_of == depth)
        key = blocks.cell[here] * nodes + blocks.node[here]
        start[here] = entries.start[np.searchsorted(entries.cell * nodes + entries.node, key)]
    into = np.repeat(start - (np.cumsum(count) - count), count) + np.arange(len(row))
    alive = np.repeat(start >= 0, count)
    code[into[alive]] = row[alive]


def _check_depth(code: Codes) -> None:
    """No program may set more aside than the stack holds."""
    step = np.where(code == kernels.OPEN, 1, np.where((code == kernels.MERGE) | (code == kernels.REPLACE), -1, 0))
    # A program ends at the depth that it began at, so that one running sum serves all.
    deepest = int(np.cumsum(step).max(initial=0))
    if deepest > kernels.STACK:
        raise InputError(
            f"the tree nests {deepest} replacements in one place, {kernels.STACK} at most; merge some of its nodes"
        )
