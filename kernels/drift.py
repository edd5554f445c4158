"""What water carries: foam on a grid [Peytavie2019], Sec. 7."""

from types import SimpleNamespace

import warp as wp

from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})


@once
def build(scalar):
    """Make the kernels of what drifts for one precision.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.drift_{scalar.__name__}"
    vec2 = wp.types.vector(2, scalar)
    ZERO, ONE = scalar(0.0), scalar(1.0)

    @wp.func(module=name)
    def foam_at(cell_foam: wp.array2d[scalar], row: scalar, column: scalar) -> scalar:
        """Foam between the centres of cells, bilinear; nothing comes in from beyond the edge."""
        rows, columns = cell_foam.shape[0], cell_foam.shape[1]
        i, j = int(wp.floor(row)), int(wp.floor(column))
        v, u = row - scalar(i), column - scalar(j)
        total = scalar(0.0)
        for di in range(2):
            for dj in range(2):
                a, b = i + di, j + dj
                if a >= 0 and a < rows and b >= 0 and b < columns:
                    share = wp.where(di == 0, ONE - v, v) * wp.where(dj == 0, ONE - u, u)
                    total += share * cell_foam[a, b]
        return total

    @wp.kernel(module=name, enable_backward=False)
    def carry_foam(
        # params
        cells_per_metre: scalar,
        time_step: scalar,
        kept: scalar,
        # in
        cell_velocity: wp.array2d[vec2],
        cell_source: wp.array2d[scalar],
        cell_foam: wp.array2d[scalar],
        # out
        cell_foam_out: wp.array2d[scalar],
    ):
        """Carry foam for a time step: c = c(p - u dt) exp(-dt/tau) + s dt, 1 at most; ``kept`` is the exponential."""
        row, column = wp.tid()
        velocity = cell_velocity[row, column]
        back = time_step * cells_per_metre
        # Half a step back first, for the velocity there: the middle of the way.
        i = wp.clamp(
            int(wp.floor(scalar(row) + back * velocity[1] / scalar(2.0) + scalar(0.5))), 0, cell_foam.shape[0] - 1
        )
        j = wp.clamp(
            int(wp.floor(scalar(column) - back * velocity[0] / scalar(2.0) + scalar(0.5))), 0, cell_foam.shape[1] - 1
        )
        middle = cell_velocity[i, j]
        foam = foam_at(cell_foam, scalar(row) + back * middle[1], scalar(column) - back * middle[0])
        cell_foam_out[row, column] = wp.clamp(foam * kept + cell_source[row, column] * time_step, ZERO, ONE)

    return SimpleNamespace(vec2=vec2, carry_foam=carry_foam)
