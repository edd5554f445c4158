"""Pictures of beds and water without a graphics library: rays upon two height fields, refracted and reflected."""

from types import SimpleNamespace

import warp as wp

from warpriver.kernels import noise, steps
from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})


@once
def build(scalar):
    """Make the kernels that shade, for one precision.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.shading_{scalar.__name__}"
    wp.set_module_options({"max_unroll": 1}, module=name)
    smooth_steps = steps.build(scalar)
    field = noise.build(scalar)
    vec2, vec3 = field.vec2, field.vec3
    ZERO, HALF, ONE, TWO = (scalar(v) for v in (0.0, 0.5, 1.0, 2.0))
    # Rays: steps at most, steepness that they allow for, halvings at the end; below this a place is dry, and below that
    # water fades towards its edge, m.
    STEPS, STEEP, HALVINGS = 400, scalar(1.3), 6
    DRY, EDGE_DEPTH = scalar(0.0003), scalar(0.015625)
    # Refraction from air into water, and the share that is reflected straight up [Schlick1994].
    AIR_OVER_WATER, STRAIGHT = scalar(1.0 / 1.333), scalar(0.02)
    # Absorption of red, green, blue in clear brook water with fine silt, 1/m, and what the water itself scatters.
    ABSORBED, MURK = vec3(1.7, 0.9, 1.15), vec3(0.085, 0.12, 0.085)
    MURKY = scalar(0.9)
    SUN, AMBIENT = vec3(1.16, 1.08, 0.94), vec3(0.34, 0.4, 0.48)
    ZENITH, HORIZON, TREES = vec3(0.2, 0.4, 0.72), vec3(0.74, 0.82, 0.88), vec3(0.05, 0.075, 0.045)
    GRASS, DRY_GRASS, GRAVEL = vec3(0.16, 0.24, 0.075), vec3(0.34, 0.31, 0.14), vec3(0.42, 0.38, 0.31)
    PEBBLE, STONE, WOOD = vec3(0.25, 0.23, 0.2), vec3(0.4, 0.39, 0.37), vec3(0.27, 0.19, 0.12)
    FOAM = vec3(0.93, 0.95, 0.96)
    TREE_LINE, TREE_EDGE = scalar(0.28), scalar(0.12)
    FIFTH, TENTH, QUARTER, THREE_FIFTHS = (scalar(v) for v in (0.2, 0.1, 0.25, 0.6))
    GLINT, GLOW, GLINT_SIZE, GLOW_SIZE = scalar(6.0), scalar(0.25), scalar(900.0), scalar(40.0)
    FOCUS, MOST_FOCUS = scalar(0.33), scalar(0.35)
    WET = scalar(0.62)
    FOAM_LOW, FOAM_HIGH, FOAM_EDGE, CRESTED = scalar(0.2), scalar(0.95), scalar(0.35), scalar(0.06)
    SHADE_STEPS, SHADE_FIRST = 14, scalar(0.06)

    @wp.struct
    class Scene:
        """Height fields from a datum, m: ``bed``, and ``water``, below the bed where it is dry.

        ``rock``: 1 on rocks, -1 on logs. ``white``: foam, on a grid of ``white_scale`` times as many cells a metre.
        ``shore``: depth of the bed below the water of the nearest course, below 0 on a bank, m. Row 0 is in the north;
        the first cell's centre is at (0, 0), x east, y north. ``top``: the greatest height.
        """

        bed: wp.array2d[scalar]
        water: wp.array2d[scalar]
        rock: wp.array2d[scalar]
        white: wp.array2d[scalar]
        white_scale: scalar
        shore: wp.array2d[scalar]
        cell_size: scalar
        top: scalar

    @wp.struct
    class View:
        """A camera: eye, direction of the middle of the picture, half extents right and up at a distance of 1 m.

        ``parallel``: 1 for rays that are parallel, which begin beside the eye; 0 for a perspective.
        """

        eye: vec3
        forward: vec3
        right: vec3
        up: vec3
        sun: vec3
        parallel: int
        width: int
        height: int

    @wp.struct
    class Meeting:
        """A ray that meets water, as seen from its surface.

        ``bed``: where the refracted ray ends on it. ``path``: of light down to the bed and back up, m. ``facing``:
        cosine of the angle between ray and normal. ``bent``: Laplacian of the surface, 1/m.
        """

        normal: vec3
        bed: vec2
        depth: scalar
        path: scalar
        facing: scalar
        bent: scalar

    @wp.func(module=name)
    def between(values: wp.array2d[scalar], column: scalar, row: scalar) -> scalar:
        """Bilinear between the centres of cells; beyond the edge that of the edge."""
        u = wp.clamp(column, ZERO, scalar(values.shape[1] - 1))
        v = wp.clamp(row, ZERO, scalar(values.shape[0] - 1))
        j, i = wp.min(int(u), values.shape[1] - 2), wp.min(int(v), values.shape[0] - 2)
        u, v = u - scalar(j), v - scalar(i)
        low = values[i, j] + u * (values[i, j + 1] - values[i, j])
        high = values[i + 1, j] + u * (values[i + 1, j + 1] - values[i + 1, j])
        return low + v * (high - low)

    @wp.func(module=name)
    def normal_of(values: wp.array2d[scalar], column: scalar, row: scalar, cell_size: scalar) -> vec3:
        """Normal of a height field, by differences over a cell."""
        east = between(values, column + HALF, row) - between(values, column - HALF, row)
        north = between(values, column, row - HALF) - between(values, column, row + HALF)
        return wp.normalize(vec3(-east, -north, cell_size))

    @wp.func(module=name)
    def surface_height(scene: Scene, x: scalar, y: scalar) -> scalar:
        """The higher of bed and water."""
        column, row = x / scene.cell_size, -y / scene.cell_size
        return wp.max(between(scene.bed, column, row), between(scene.water, column, row))

    @wp.func(module=name)
    def smooth(low: scalar, high: scalar, x: scalar) -> scalar:
        """Step from 0 to 1 between two values."""
        return smooth_steps.cubic_step((x - low) / (high - low))

    @wp.func(module=name)
    def octaves(seed: int, xy: vec2, count: int) -> scalar:
        """Octaves of gradient noise, each half as high as the one before."""
        total, size = scalar(0.0), scalar(1.0)
        at = xy
        for k in range(count):
            value = field.gradient_noise(seed + k, at)
            total += size * value[0]
            size = size * HALF
            at = at * TWO
        return total

    @wp.func(module=name)
    def sky(direction: vec3, sun: vec3) -> vec3:
        """Light from a direction: trees near the horizon, sky, and the sun with the glow around it."""
        up = wp.max(direction[2], ZERO)
        color = HORIZON + wp.sqrt(up) * (ZENITH - HORIZON)
        ragged = TREE_LINE + TREE_EDGE * octaves(77, vec2(direction[0], direction[1]) * scalar(6.0), 3)
        color = TREES + smooth(ragged - TREE_EDGE * HALF, ragged + TREE_EDGE, up) * (color - TREES)
        toward = wp.max(wp.dot(direction, sun), ZERO)
        return color + (GLINT * wp.pow(toward, GLINT_SIZE) + GLOW * wp.pow(toward, GLOW_SIZE)) * SUN

    @wp.func(module=name)
    def lit(scene: Scene, x: scalar, y: scalar, z: scalar, normal: vec3, sun: vec3) -> vec3:
        """Light on the ground: sun where nothing stands before it, and sky."""
        direct = wp.max(wp.dot(normal, sun), ZERO)
        far, step = scalar(SHADE_FIRST), scalar(SHADE_FIRST)
        for _k in range(SHADE_STEPS):
            if direct > ZERO:
                column, row = (x + far * sun[0]) / scene.cell_size, -(y + far * sun[1]) / scene.cell_size
                above = between(scene.bed, column, row) - (z + far * sun[2])
                if above > ZERO:
                    direct = direct * wp.clamp(ONE - above / (TENTH * far + SHADE_FIRST * HALF), ZERO, ONE)
            step = step * scalar(1.25)
            far += step
        return direct * SUN + (HALF + HALF * normal[2]) * AMBIENT

    @wp.func(module=name)
    def ground_color(scene: Scene, x: scalar, y: scalar, column: scalar, row: scalar, normal: vec3) -> vec3:
        """Colour of bed or bank: grass, gravel along the water, pebbles in it, rock, wood."""
        shore = between(scene.shore, column, row)
        rock = between(scene.rock, column, row)
        place = vec2(x, y)
        coarse, fine = octaves(3, place * HALF, 3), octaves(9, place * scalar(7.0), 3)
        grain = octaves(21, place * scalar(28.0), 2)
        grass = GRASS + wp.clamp(HALF + HALF * coarse, ZERO, ONE) * (DRY_GRASS - GRASS)
        grass = grass * (ONE + scalar(0.4375) * fine + FIFTH * grain)
        gravel = PEBBLE + wp.clamp(HALF + THREE_FIFTHS * fine + scalar(0.5) * grain, ZERO, ONE) * (GRAVEL - PEBBLE)
        bare = smooth(-scalar(0.21875), -scalar(0.015625), shore + scalar(0.078125) * coarse + scalar(0.046875) * fine)
        bare = wp.max(bare, smooth(scalar(0.75), scalar(0.5625), normal[2]))
        color = grass + bare * (gravel - grass)
        laid = STONE
        if rock < ZERO:
            laid = WOOD
        laid = laid * (scalar(0.875) + scalar(0.3125) * fine + scalar(0.1875) * grain)
        return color + wp.abs(rock) * (laid - color)

    @wp.func(module=name)
    def bed_light(scene: Scene, x: scalar, y: scalar, sun: vec3, wet: scalar) -> vec3:
        """Light that the bed sends back, darker where it is wet."""
        column, row = x / scene.cell_size, -y / scene.cell_size
        normal = normal_of(scene.bed, column, row, scene.cell_size)
        # Pebbles that the cells do not show.
        bump = field.gradient_noise(40, vec2(x, y) * scalar(11.0))
        rough = scalar(0.125) * smooth(-scalar(0.3125), ZERO, between(scene.shore, column, row))
        rough = wp.max(rough, FIFTH * between(scene.rock, column, row))
        normal = wp.normalize(normal - rough * vec3(bump[1], bump[2], ZERO))
        color = ground_color(scene, x, y, column, row, normal)
        light = lit(scene, x, y, between(scene.bed, column, row), normal, sun)
        return (ONE + wet * (WET - ONE)) * wp.cw_mul(color, light)

    @wp.func(module=name)
    def meet_water(scene: Scene, x: scalar, y: scalar, toward: vec3) -> Meeting:
        """What a ray finds where it meets the water: it is refracted by Snell's law."""
        size = scene.cell_size
        column, row = x / size, -y / size
        level = between(scene.water, column, row)
        normal = normal_of(scene.water, column, row, size)
        facing = wp.clamp(-wp.dot(normal, toward), scalar(0.015625), ONE)
        ratio = AIR_OVER_WATER
        inner = wp.sqrt(ONE - ratio * ratio * (ONE - facing * facing))
        below = ratio * toward + (ratio * facing - inner) * normal
        down = wp.max(-below[2], FIFTH)
        depth = wp.max(level - between(scene.bed, column, row), ZERO)
        p, q = x + depth * below[0] / down, y + depth * below[1] / down
        # Where the ray ends in a rock it has come a part of the way.
        deep = wp.max(level - between(scene.bed, p / size, -q / size), depth * QUARTER)
        bent = between(scene.water, column + ONE, row) + between(scene.water, column - ONE, row)
        bent += between(scene.water, column, row + ONE) + between(scene.water, column, row - ONE)
        bent = (bent - scalar(4.0) * level) / (size * size)
        return Meeting(normal, vec2(p, q), depth, deep * (ONE + ONE / down), facing, bent)

    @wp.func(module=name)
    def water_light(scene: Scene, meeting: Meeting, place: vec2, toward: vec3, sun: vec3, bed_below: vec3) -> vec3:
        """Light from the water: that of the bed absorbed, the sky reflected [Schlick1994], and foam."""
        away = ONE - meeting.facing
        reflected = STRAIGHT + (ONE - STRAIGHT) * away * away * away * away * away
        mirror = toward + TWO * meeting.facing * meeting.normal
        mirror = vec3(mirror[0], mirror[1], wp.abs(mirror[2]))
        # Waves gather the sun's light on the bed, or spread it.
        gathered = ONE + wp.clamp(-FOCUS * meeting.bent * meeting.depth, -MOST_FOCUS, MOST_FOCUS)
        path = meeting.path
        through = vec3(wp.exp(-ABSORBED[0] * path), wp.exp(-ABSORBED[1] * path), wp.exp(-ABSORBED[2] * path))
        bed = wp.cw_mul(bed_below * gathered, through)
        light = wp.max(sun[2], ZERO) * SUN + AMBIENT
        murk = (ONE - wp.exp(-MURKY * path)) * wp.cw_mul(MURK, light)
        color = (ONE - reflected) * (bed + murk) + reflected * sky(mirror, sun)
        finer = scene.white_scale
        column, row = place[0] / scene.cell_size, -place[1] / scene.cell_size
        white = between(scene.white, (column + HALF) * finer - HALF, (row + HALF) * finer - HALF)
        # Foam lies on the crests and leaves the troughs: its edges are ragged and move with the water.
        ragged = white + FOAM_EDGE * wp.clamp(-meeting.bent * CRESTED, -ONE, ONE)
        white = smooth(FOAM_LOW, FOAM_HIGH, ragged) * smooth(ZERO, TENTH, white)
        shade = wp.max(wp.dot(meeting.normal, sun), ZERO) * SUN + AMBIENT
        foam = scalar(0.71875) * wp.cw_mul(FOAM, shade)
        return color + white * (foam - color)

    @wp.func(module=name)
    def surface_light(scene: Scene, place: vec2, toward: vec3, sun: vec3) -> vec3:
        """Light from the higher of bed and water; thin water at the edge shows the bed."""
        column, row = place[0] / scene.cell_size, -place[1] / scene.cell_size
        covered = between(scene.water, column, row) - between(scene.bed, column, row) > DRY
        # Wet just above the water.
        wet = smooth(-scalar(0.0625), ZERO, between(scene.shore, column, row))
        meeting = Meeting()
        edge = scalar(0.0)
        if covered:
            wet = scalar(1.0)
            meeting = meet_water(scene, place[0], place[1], toward)
            edge = smooth(ZERO, EDGE_DEPTH, meeting.depth)
        # The bed here, and where the refracted ray ends on it.
        color = vec3()
        at = place
        share = ONE - edge
        for k in range(2):
            if share > ZERO:
                light = bed_light(scene, at[0], at[1], sun, wet)
                if k == 1:
                    light = water_light(scene, meeting, place, toward, sun, light)
                color += share * light
            at = meeting.bed
            share = edge
        return color

    @wp.func(module=name)
    def first_hit(scene: Scene, start: vec3, toward: vec3) -> scalar:
        """Distance along a ray to the higher of bed and water; below 0 where it meets neither."""
        along = ZERO
        if start[2] > scene.top:
            if toward[2] >= ZERO:
                return -ONE
            along = (scene.top - start[2]) / toward[2]
        wide = scene.cell_size * scalar(scene.bed.shape[1] - 1)
        high = scene.cell_size * scalar(scene.bed.shape[0] - 1)
        fall = wp.sqrt(toward[0] * toward[0] + toward[1] * toward[1]) * STEEP - toward[2]
        before = along
        for _k in range(STEPS):
            place = start + along * toward
            if place[2] > scene.top and toward[2] >= ZERO:
                return -ONE
            above = place[2] - surface_height(scene, place[0], place[1])
            if above <= ZERO:
                for _h in range(HALVINGS):
                    middle = HALF * (before + along)
                    place = start + middle * toward
                    if place[2] > surface_height(scene, place[0], place[1]):
                        before = middle
                    else:
                        along = middle
                place = start + along * toward
                if place[0] < ZERO or place[0] > wide or place[1] > ZERO or place[1] < -high:
                    return -ONE
                return along
            before = along
            along += wp.max(above / fall, QUARTER * scene.cell_size)
        return -ONE

    @wp.kernel(module=name, enable_backward=False)
    def shade_pixels(
        # params
        scene: Scene,
        view: View,
        # out
        pixel_color_out: wp.array2d[vec3],
        pixel_far_out: wp.array2d[scalar],
    ):
        """Colour of each pixel, linear, and the distance of what it shows, below 0 for the sky."""
        i, j = wp.tid()
        u = (TWO * (scalar(j) + HALF) / scalar(view.width)) - ONE
        v = ONE - (TWO * (scalar(i) + HALF) / scalar(view.height))
        aside = u * view.right + v * view.up
        beside = scalar(view.parallel)
        start = view.eye + beside * aside
        toward = wp.normalize(view.forward + (ONE - beside) * aside)
        far = first_hit(scene, start, toward)
        pixel_far_out[i, j] = far
        if far < ZERO:
            pixel_color_out[i, j] = HORIZON + wp.sqrt(wp.max(toward[2], ZERO)) * (ZENITH - HORIZON)
            return
        place = start + far * toward
        pixel_color_out[i, j] = surface_light(scene, vec2(place[0], place[1]), toward, view.sun)

    return SimpleNamespace(vec2=vec2, vec3=vec3, Scene=Scene, View=View, shade_pixels=shade_pixels)
