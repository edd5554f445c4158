"""Animated water: a blend-flow tree of moving primitives, evaluated at points and on grids [Peytavie2019]."""

import math
from types import SimpleNamespace

import warp as wp

from warpriver.kernels import noise, steps
from warpriver.kernels.flow_tree import (
    CASCADE,
    CREST,
    DRIFT,
    ECHO,
    EDGE,
    LIVELY,
    MERGE,
    OCTAVES,
    OPEN,
    OWN,
    PERIOD,
    PERSISTENCE,
    RIDGE_MEAN,
    RIDGE_SHARE,
    RIDGED,
    RIDGED_OCTAVES,
    SMOOTH,
    STACK,
    TEXELS,
    TURBULENT,
    UPSTREAM,
    VORTEX,
    WAVE,
    WAVE_SHARE,
)
from warpriver.kernels.variants import named, once

wp.set_module_options({"enable_backward": False})


@once
def build(scalar):
    """Make the kernels of the water surface for one precision; elevations are float64 in both.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.water_{scalar.__name__}"
    smooth_steps = steps.build(scalar)
    field = noise.build(scalar)
    vec2, vec3, vec4 = (wp.types.vector(n, scalar) for n in (2, 3, 4))
    # Weight, its square; weighted: still level, offset of the waves, velocity east and north, foam.
    sums = wp.types.vector(7, scalar)
    stack = wp.types.matrix((STACK, 7), scalar)
    ZERO, HALF, ONE, TWO = (scalar(v) for v in (0.0, 0.5, 1.0, 2.0))
    THREE_QUARTERS = scalar(0.75)
    EDGE_, UPSTREAM_, CREST_, RIDGE_ = scalar(EDGE), scalar(UPSTREAM), scalar(CREST), scalar(RIDGE_MEAN)
    RIDGE_SHARE_, WAVE_SHARE_ = scalar(RIDGE_SHARE), scalar(WAVE_SHARE)
    TURN, STILL = scalar(2.0 * math.pi), scalar(1.0e-12)
    TEXELS_PER_UNIT = scalar(TEXELS / PERIOD)
    ROW = TEXELS + 2
    TABLE = ROW * ROW
    SMOOTH_OCTAVES, LIVELY_OCTAVES, ROUGH_OCTAVES = OCTAVES
    SMOOTH_SHARE, LIVELY_SHARE, RIDGED_SHARE = (scalar(v) for v in PERSISTENCE)
    FEW = wp.float64(1.0e-30)
    ZERO64, ONE64, PERIOD64 = wp.float64(0.0), wp.float64(1.0), wp.float64(PERIOD)
    TURN64, OFFSET64 = wp.float64(2.0 * math.pi), wp.float64(PERIOD / 65536.0)
    DRIFT_X, DRIFT_Y = wp.float64(DRIFT[0]), wp.float64(DRIFT[1])
    NOWHERE = wp.float64(math.nan)

    @wp.struct
    class Primitives:
        """Leaves of the tree, one a row.

        ``place``: centre from the corner of its tile, radius, level above the tile's datum, m. ``flow``: gradient of
        the level, velocity in m/s. ``look``: amplitude in m, frequency in 1/m, foam. ``shape``: by kind, see
        ``shaped``. ``phase``: offset in the noise at a time, and the frequency times cosine and sine of its turn.
        ``offset``: two numbers of 16 bits that say where in the noise it begins.
        """

        place: wp.array[vec4]
        flow: wp.array[vec4]
        look: wp.array[vec3]
        shape: wp.array[vec3]
        phase: wp.array[vec4]
        kind: wp.array[int]
        tile: wp.array[int]
        offset: wp.array[int]

    @wp.struct
    class Noise:
        """Tables of noise as coefficients of quadratic B-splines, with a border of one texel; or the exact noise."""

        coefficient: wp.array[scalar]
        exact: int

    @wp.struct
    class Cells:
        """Square cells in square tiles: of a tile its datum in m and its first cell, -1 where dry; programs by cell.

        ``tile_west`` and ``tile_south``: the first tile, counted from the corner that places are relative to.
        """

        tile_size: scalar
        tile_west: int
        tile_south: int
        tile_columns: int
        tile_rows: int
        cell_size: scalar
        cells_across: int
        tile_first: wp.array[int]
        tile_datum: wp.array[scalar]
        cell_start: wp.array[int]
        code: wp.array[int]
        contrast: int

    @wp.struct
    class Surface:
        """What a query yields: elevation and its part without waves in m, velocity in m/s, foam, weight."""

        elevation: wp.array[wp.float64]
        still: wp.array[wp.float64]
        velocity: wp.array[vec2]
        foam: wp.array[scalar]
        weight: wp.array[scalar]

    @wp.struct
    class Grid:
        """Cells of a raster: the centre of its first one east and north of the first tile's corner, its cell size in m.

        No columns: there is no raster, but points.
        """

        west: wp.float64
        north: wp.float64
        cell_size: wp.float64
        columns: int

    @wp.func(module=name)
    def exact_noise(table: int, xy: vec2) -> scalar:
        """Octaves of periodic gradient noise [Perlin2002]; ridged: with (1 - |n|)^2 less its mean [Musgrave1989]."""
        total, size = scalar(0.0), scalar(1.0)
        octaves, persistence = SMOOTH_OCTAVES, SMOOTH_SHARE
        if table == LIVELY:
            octaves, persistence = LIVELY_OCTAVES, LIVELY_SHARE
        if table == RIDGED:
            octaves, persistence = ROUGH_OCTAVES, RIDGED_SHARE
        at, period = xy, int(PERIOD)
        for octave in range(octaves):
            value = field.periodic_noise(table * 16 + octave, at, period)
            if table == RIDGED:
                ridge = ONE - wp.abs(value)
                value = WAVE_SHARE_ * value
                if octave < RIDGED_OCTAVES:
                    value += RIDGE_SHARE_ * (ridge * ridge - RIDGE_)
            total += size * value
            size = size * persistence
            at = TWO * at
            period = 2 * period
        return total

    @wp.func(module=name)
    def noise_at(tables: Noise, table: int, xy: vec2) -> scalar:
        """Noise of a table at a place in wavelengths; once continuously differentiable where it is baked."""
        if tables.exact != 0:
            return exact_noise(table, xy)
        x, y = xy[0] * TEXELS_PER_UNIT + HALF, xy[1] * TEXELS_PER_UNIT + HALF
        # Rounded down without a call: on a texel's edge either of two texels is right.
        j, i = int(x) - int(x < ZERO), int(y) - int(y < ZERO)
        x, y = x - scalar(j) - HALF, y - scalar(i) - HALF
        at = table * TABLE + (i & (TEXELS - 1)) * ROW + (j & (TEXELS - 1))
        a, b, c = HALF * (HALF - x) * (HALF - x), THREE_QUARTERS - x * x, HALF * (HALF + x) * (HALF + x)
        low = a * tables.coefficient[at] + b * tables.coefficient[at + 1] + c * tables.coefficient[at + 2]
        at += ROW
        mid = a * tables.coefficient[at] + b * tables.coefficient[at + 1] + c * tables.coefficient[at + 2]
        at += ROW
        high = a * tables.coefficient[at] + b * tables.coefficient[at + 1] + c * tables.coefficient[at + 2]
        return (
            HALF * (HALF - y) * (HALF - y) * low
            + (THREE_QUARTERS - y * y) * mid
            + HALF * (HALF + y) * (HALF + y) * high
        )

    @wp.func(module=name)
    def turned(phase: vec4, off: vec2) -> vec2:
        """Place in the noise: an offset from a primitive's centre turned, in wavelengths, and carried by the water."""
        return vec2(phase[2] * off[0] - phase[3] * off[1] + phase[0], phase[3] * off[0] + phase[2] * off[1] + phase[1])

    @wp.func(module=name)
    def upstream_share(along: scalar, width: scalar) -> scalar:
        """Lambda of a cascade: 1 above the lip, 0 below it, by a quintic step over twice ``width``."""
        return ONE - smooth_steps.quintic_step((along + width) / (TWO * width))

    @wp.func(module=name)
    def replaced(under: sums, over: sums, contrast: int) -> sums:
        """Sums of a surface that another one replaces: (1 - m) A + m B, m = min(1, alpha_B), with A's weight."""
        if under[0] <= ZERO or over[0] <= ZERO:
            return under
        m = wp.min(ONE, over[0])
        kept = under[0] * (ONE - m)
        taken = under[0] * m / over[0]
        found = kept / under[0] * under + taken * over
        if contrast != 0:
            # Offsets over the root of the sum of squares, so that the waves between two surfaces are as high as theirs.
            size = wp.sqrt(under[1]) / wp.sqrt((ONE - m) * (ONE - m) + m * m)
            found[3] = size * ((ONE - m) * under[3] / wp.sqrt(under[1]) + m * over[3] / wp.sqrt(over[1]))
        found[0] = under[0]
        found[1] = under[1]
        return found

    @wp.func(module=name)
    def no_leaf(kind: int, off: vec2, weight: scalar, shape: vec3, phase: vec4) -> vec4:
        """Stands for a user's primitive where there is none: still water."""
        return vec4(ZERO, ZERO, ZERO, ZERO)

    def evaluator(own, name):
        """Make the kernel that evaluates a tree, some of whose leaves are a user's.

        Args:
            own: ``wp.func`` of kind, offset from the centre in m, weight, shape and phase; returns the height above the
                level in m, velocity to add in m/s, and foam to add.
            name: Name of the Warp module.
        """

        @wp.func(module=name)
        def shaped(
            tables: Noise, kind: int, off: vec2, weight: scalar, flow: vec4, look: vec3, shape: vec3, phase: vec4
        ) -> sums:
            """Still level above the primitive's plane, waves, velocity and foam of the kinds that are not mere noise.

            ``shape``: of a wave its height, the blend from calm to turbulent (both ways), its length; of a cascade its
            drop, that blend, and how far down the stream its lip is; of a vortex its shear a metre, spin and depth; of
            an echo the angle of the bank's normal and the distance of the bank along it. In m, rad, rad/s.
            """
            if kind == ECHO:
                normal = vec2(wp.cos(shape[0]), wp.sin(shape[0]))
                mirrored = off - TWO * (wp.dot(off, normal) - shape[1]) * normal
                both = noise_at(tables, SMOOTH, turned(phase, off)) + noise_at(tables, SMOOTH, turned(phase, mirrored))
                return sums(ONE, ONE, ZERO, HALF * both * look[0], flow[2], flow[3], look[2])
            if kind == VORTEX:
                angle = shape[0] * wp.length(off)
                c, s = wp.cos(angle), wp.sin(angle)
                at = turned(phase, vec2(c * off[0] + s * off[1], c * off[1] - s * off[0]))
                value = noise_at(tables, RIDGED, at)
                spin = shape[1]
                foam = wp.clamp(look[2] * (ONE + CREST_ * value), ZERO, ONE)
                u, v = flow[2] - spin * off[1], flow[3] + spin * off[0]
                return sums(ONE, ONE, -shape[2] * weight, value * look[0], u, v, foam)
            if kind >= OWN:
                found = own(kind, off, weight, shape, phase)
                foam = wp.clamp(look[2] + found[3], ZERO, ONE)
                return sums(ONE, ONE, found[0], ZERO, flow[2] + found[1], flow[3] + found[2], foam)
            speed = wp.max(wp.sqrt(flow[2] * flow[2] + flow[3] * flow[3]), STILL)
            along = (off[0] * flow[2] + off[1] * flow[3]) / speed
            at = turned(phase, off)
            if kind == CASCADE:
                along = along - shape[2]
            share = upstream_share(along, shape[1])
            value = (ONE - share) * noise_at(tables, RIDGED, at)
            waves = look[0] * (share * UPSTREAM_ * noise_at(tables, SMOOTH, at) + value)
            height = shape[0] * (share - HALF)
            if kind == WAVE:
                height = HALF * shape[0] * wp.cos(TURN * along / shape[2])
            foam = wp.clamp((ONE - share) * look[2] * (ONE + CREST_ * value), ZERO, ONE)
            return sums(ONE, ONE, height, waves, flow[2], flow[3], foam)

        @wp.func(module=name)
        def leaf_sums(water: Primitives, tables: Noise, cells: Cells, i: int, at: vec2, tile: int) -> sums:
            """Weighted values of a primitive at a place: alpha = (1 - r^2)^3, f = e + grad e (p - c) + a dh."""
            place = water.place[i]
            off = vec2(at[0] - place[0], at[1] - place[1])
            level = place[3]
            home = water.tile[i]
            if home != tile:
                columns = cells.tile_columns
                off += cells.tile_size * vec2(
                    scalar(tile % columns - home % columns), scalar(tile / columns - home / columns)
                )
                level += cells.tile_datum[home] - cells.tile_datum[tile]
            inside = ONE - (off[0] * off[0] + off[1] * off[1]) / (place[2] * place[2])
            if inside <= EDGE_:
                return sums()
            weight = inside * inside * inside
            kind = water.kind[i]
            flow, look = water.flow[i], water.look[i]
            level += flow[0] * off[0] + flow[1] * off[1]
            if kind > TURBULENT:
                found = shaped(tables, kind, off, weight, flow, look, water.shape[i], water.phase[i])
                found[2] = found[2] + level
                found = weight * found
                found[1] = weight * weight
                return found
            value = noise_at(tables, kind, turned(water.phase[i], off))
            foam = wp.clamp(look[2] * (ONE + CREST_ * value), ZERO, ONE)
            return weight * sums(ONE, weight, level, look[0] * value, flow[2], flow[3], foam)

        @wp.func(module=name)
        def program_sums(water: Primitives, tables: Noise, cells: Cells, at: vec2, tile: int, cell: int) -> sums:
            """Run a cell's program. Layers that replace each other one by one need one set of sums aside, no stack."""
            under, top = sums(), sums()
            kept = stack()
            depth = int(0)
            for k in range(cells.cell_start[cell], cells.cell_start[cell + 1]):
                code = cells.code[k]
                if code >= 0:
                    top += leaf_sums(water, tables, cells, code, at, tile)
                elif code == OPEN:
                    # The stack holds what has been set aside before the last.
                    if depth > 0:
                        kept[depth - 1] = under
                    depth += 1
                    under = top
                    top = sums()
                else:
                    depth -= 1
                    if code == MERGE:
                        top += under
                    else:
                        top = replaced(under, top, cells.contrast)
                    if depth > 0:
                        under = kept[depth - 1]
            return top

        @wp.func(module=name)
        def write_surface(
            water: Primitives, tables: Noise, cells: Cells, x: wp.float64, y: wp.float64, i: int, surface_out: Surface
        ):
            """Evaluate the tree at a place, m from the corner of all tiles; NaN where there is no water."""
            size = wp.float64(cells.tile_size)
            column, row = int(wp.floor(x / size)), int(wp.floor(y / size))
            i_tile, j_tile = row - cells.tile_south, column - cells.tile_west
            first, tile = int(-1), int(0)
            if j_tile >= 0 and j_tile < cells.tile_columns and i_tile >= 0 and i_tile < cells.tile_rows:
                tile = i_tile * cells.tile_columns + j_tile
                first = cells.tile_first[tile]
            found = sums()
            if first >= 0:
                at = vec2(scalar(x - wp.float64(column) * size), scalar(y - wp.float64(row) * size))
                across = cells.cells_across
                j = wp.min(int(at[0] / cells.cell_size), across - 1)
                cell = first + wp.min(int(at[1] / cells.cell_size), across - 1) * across + j
                found = program_sums(water, tables, cells, at, tile, cell)
            weight = found[0]
            if weight <= ZERO:
                surface_out.elevation[i] = NOWHERE
                surface_out.still[i] = NOWHERE
                surface_out.velocity[i] = vec2(ZERO, ZERO)
                surface_out.foam[i] = ZERO
                surface_out.weight[i] = ZERO
                return
            per = ONE / weight
            waves = found[3] * per
            if cells.contrast != 0:
                waves = found[3] / wp.sqrt(found[1])
            datum = wp.float64(cells.tile_datum[tile])
            surface_out.still[i] = datum + wp.float64(found[2] * per)
            surface_out.elevation[i] = datum + wp.float64(found[2] * per + waves)
            surface_out.velocity[i] = vec2(found[4] * per, found[5] * per)
            surface_out.foam[i] = found[6] * per
            surface_out.weight[i] = weight

        @wp.kernel(module=name, enable_backward=False)
        @named("evaluate_water")
        def evaluate_water(
            # params
            water: Primitives,
            tables: Noise,
            cells: Cells,
            # in
            grid: Grid,
            point_xy: wp.array[wp.vec2d],
            # out
            surface_out: Surface,
        ):
            """Evaluate the water at points, or at the centres of a raster's cells row by row [Peytavie2019], Sec. 6."""
            i = wp.tid()
            x, y = ZERO64, ZERO64
            if grid.columns > 0:
                row = i / grid.columns
                x = grid.west + grid.cell_size * wp.float64(i - row * grid.columns)
                y = grid.north - grid.cell_size * wp.float64(row)
            else:
                x, y = point_xy[i][0], point_xy[i][1]
            write_surface(water, tables, cells, x, y, i, surface_out)

        return evaluate_water

    @wp.kernel(module=name, enable_backward=False)
    def set_phases(
        # params
        water: Primitives,
        time: wp.float64,
        # out
        phase_out: wp.array[vec4],
    ):
        """Say where in the noise each primitive is at a time: w^-1 = p - t u, wrapped in float64 [Peytavie2019].

        The water drifts along one direction of the table, mirrored and swapped by the primitive's offset. A vortex is
        turned by its spin times the time instead, about its centre.
        """
        i = wp.tid()
        bits = water.offset[i]
        x, y = OFFSET64 * wp.float64(bits & 65535), OFFSET64 * wp.float64((bits >> 16) & 65535)
        across, up = DRIFT_X, DRIFT_Y
        if (bits & 1) != 0:
            across, up = DRIFT_Y, DRIFT_X
        if (bits & 2) != 0:
            across = -across
        if (bits & 65536) != 0:
            up = -up
        u, v = wp.float64(water.flow[i][2]), wp.float64(water.flow[i][3])
        speed = wp.sqrt(u * u + v * v)
        if speed < FEW:
            u, v = ONE64, ZERO64
        else:
            u, v = u / speed, v / speed
        frequency = wp.float64(water.look[i][1])
        c, s = u * across + v * up, u * up - v * across
        if water.kind[i] == VORTEX:
            turns = wp.float64(water.shape[i][1]) * time / TURN64
            angle = TURN64 * (turns - wp.floor(turns))
            cosine, sine = wp.cos(angle), wp.sin(angle)
            c, s = c * cosine + s * sine, s * cosine - c * sine
        else:
            drift = speed * frequency * time
            x = x - drift * across
            y = y - drift * up
            x = x - PERIOD64 * wp.floor(x / PERIOD64)
            y = y - PERIOD64 * wp.floor(y / PERIOD64)
        phase_out[i] = vec4(scalar(x), scalar(y), scalar(frequency * c), scalar(frequency * s))

    @wp.kernel(module=name, enable_backward=False)
    def fade_surfaces(
        # params
        share: scalar,
        # in
        early: Surface,
        # out
        late_io: Surface,
    ):
        """Join two times of one surface whose waves were scaled to fade: offsets add, foam is mixed by ``share``."""
        i = wp.tid()
        late_io.elevation[i] = late_io.elevation[i] + (early.elevation[i] - early.still[i])
        late_io.foam[i] = share * late_io.foam[i] + (ONE - share) * early.foam[i]

    @wp.kernel(module=name, enable_backward=False)
    def bake_noise(
        # out
        value_out: wp.array3d[wp.float64],
    ):
        """Exact noise at the texels of all tables, from which the coefficients of splines are found."""
        table, i, j = wp.tid()
        at = vec2(scalar(j) / TEXELS_PER_UNIT, scalar(i) / TEXELS_PER_UNIT)
        value_out[table, i, j] = wp.float64(exact_noise(table, at))

    return SimpleNamespace(
        vec2=vec2,
        vec3=vec3,
        vec4=vec4,
        Primitives=Primitives,
        Noise=Noise,
        Cells=Cells,
        Surface=Surface,
        Grid=Grid,
        evaluator=evaluator,
        evaluate_water=evaluator(no_leaf, name),
        set_phases=set_phases,
        fade_surfaces=fade_surfaces,
        bake_noise=bake_noise,
    )
