"""Terrains from nothing: sums of noise, and the steady form of land that rivers drain."""

import math
from types import SimpleNamespace

import warp as wp

from warpriver.kernels import noise
from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})


@once
def build(scalar):
    """Make the kernels of synthetic terrains for one precision of the noise; heights are float64 in both.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.terrains_{scalar.__name__}"
    field = noise.build(scalar)
    vec2 = field.vec2
    HALF, TWO = scalar(0.5), scalar(2.0)
    DIAGONAL = wp.float64(math.sqrt(2.0))
    # Octaves are turned against each other by the golden angle, so that the lattice does not show.
    COS, SIN = (scalar(f(math.pi * (3.0 - math.sqrt(5.0)))) for f in (math.cos, math.sin))

    @wp.struct
    class Octaves:
        """Scalars of a sum of noise: ``longest`` wavelength and ``cell_size`` in m."""

        seed: int
        count: int
        longest: scalar
        cell_size: scalar
        roughness: scalar

    @wp.struct
    class Drainage:
        """Scalars of drained land: slope = steepness / area^concavity, area >= ``hillslope``; m and m2."""

        cell_size: wp.float64
        steepness: wp.float64
        concavity: wp.float64
        hillslope: wp.float64

    @wp.kernel(module=name, enable_backward=False)
    def sum_octaves(
        # params
        octaves: Octaves,
        # out
        cell_noise_out: wp.array2d[wp.float64],
    ):
        """Fractal noise at the cells' centres: sum over k of roughness^k n(2^k x) [Musgrave1989].

        Places are measured in m from the south-west corner, so that finer cells show the same land.
        """
        row, column = wp.tid()
        x = (scalar(column) + HALF) * octaves.cell_size / octaves.longest
        y = (scalar(cell_noise_out.shape[0] - row) - HALF) * octaves.cell_size / octaves.longest
        total = scalar(0.0)
        amplitude = scalar(1.0)
        for k in range(octaves.count):
            turned_x = COS * x - SIN * y
            y = SIN * x + COS * y
            x = turned_x
            total += amplitude * field.gradient_noise(octaves.seed + k, vec2(x, y))[0]
            amplitude *= octaves.roughness
            x = TWO * x
            y = TWO * y
        cell_noise_out[row, column] = wp.float64(total)

    @wp.kernel(module=name, enable_backward=False)
    def find_receivers(
        # in
        cell_height: wp.array2d[wp.float64],
        cell_is_base: wp.array2d[int],
        # out
        cell_receiver_out: wp.array[int],
    ):
        """The neighbour that each cell drains to, the steepest descent of eight; base cells and pits keep their own."""
        row, column = wp.tid()
        columns = cell_height.shape[1]
        cell = row * columns + column
        best = cell
        steepest = wp.float64(0.0)
        if cell_is_base[row, column] == 0:
            for k in range(9):
                i, j = row + k // 3 - 1, column + k % 3 - 1
                if i >= 0 and j >= 0 and i < cell_height.shape[0] and j < columns:
                    fall = cell_height[row, column] - cell_height[i, j]
                    if i != row and j != column:
                        fall = fall / DIAGONAL
                    if fall > steepest:
                        steepest = fall
                        best = i * columns + j
        cell_receiver_out[cell] = best

    @wp.kernel(module=name, enable_backward=False)
    def drain_cells(
        # params
        drainage: Drainage,
        # in
        cell_order: wp.array[int],
        cell_receiver: wp.array[int],
        cell_resistance: wp.array[wp.float64],
        cell_floor: wp.array[wp.float64],
        columns: int,
        # out
        cell_area_io: wp.array[wp.float64],
        cell_height_io: wp.array[wp.float64],
    ):
        """Heights in the steady state of the stream power law, by one thread [Whipple1999].

        ``cell_order`` runs up the land: receivers before their donors. Down it the areas A add up; then up it, over a
        distance L, h = h_receiver + max(L * resistance * steepness / max(A, hillslope)^concavity,
        floor - floor_receiver). Base cells keep their heights; nothing lies lower over the floor than the base cell
        that it drains to.
        """
        count = cell_order.shape[0]
        for k in range(count):
            cell = cell_order[count - 1 - k]
            if cell_receiver[cell] != cell:
                cell_area_io[cell_receiver[cell]] += cell_area_io[cell]
        for k in range(count):
            cell = cell_order[k]
            receiver = cell_receiver[cell]
            if receiver != cell:
                length = drainage.cell_size
                if cell // columns != receiver // columns and cell % columns != receiver % columns:
                    length = length * DIAGONAL
                area = wp.max(cell_area_io[cell], drainage.hillslope)
                slope = cell_resistance[cell] * drainage.steepness / wp.pow(area, drainage.concavity)
                rise = wp.max(length * slope, cell_floor[cell] - cell_floor[receiver])
                cell_height_io[cell] = cell_height_io[receiver] + rise

    return SimpleNamespace(
        Octaves=Octaves,
        Drainage=Drainage,
        sum_octaves=sum_octaves,
        find_receivers=find_receivers,
        drain_cells=drain_cells,
    )
