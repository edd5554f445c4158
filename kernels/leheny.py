"""Leheny's erosion: rain that walks downhill by chance, digs where it has been, and slides that follow it."""

from types import SimpleNamespace

import warp as wp

from warpriver.kernels import cells
from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})


@wp.struct
class Events:
    """The events first .. first + count - 1 of each grid, which draws its numbers by its ``seed``."""

    first: int
    count: int
    seed: wp.array[int]


@wp.struct
class Walks:
    """A batch of events: the first one, the seed of the places that rain falls on, and that of the ways it takes."""

    first: int
    seed: int
    turn_seed: int


@wp.struct
class Pairs:
    """Pairs of cells and their neighbours k, of one colour; ``chunk``, cells of a thread in a word, divides 64."""

    k: int
    color: int
    chunk: int


@once
def build(scalar):
    """Make the kernels of Leheny's model for one precision of the heights.

    Heights are multiples of ``quantum``, a power of two so small that none of their sums is ever rounded: what several
    threads take away adds up to the same in any order, and a cell that was lower stays lower.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.leheny_{scalar.__name__}"
    raster = cells.build(scalar)
    row_step, column_step = raster.row_step, raster.column_step
    vec8 = wp.types.vector(8, scalar)
    ZERO, QUARTER = scalar(0.0), scalar(0.25)
    OUTLET = wp.uint8(cells.OUTLET)
    NO, YES = wp.uint8(0), wp.uint8(1)
    # Number of no neighbour: none is lower.
    NONE = 8
    # Where water goes from a cell whose first visitor has yet to come.
    UNKNOWN = -1
    # Cells of a row are marked by the bits of words of 64.
    NO_BITS, BIT, BYTE = wp.uint64(0), wp.uint64(1), wp.uint64(255)

    @wp.struct
    class Constants:
        """Grid and constants: ``bias`` is E in 1/m; ``depth``, ``threshold`` (D and M) and ``quantum`` are in m.

        ``base`` is the height in m that no cell sinks below, a whole number of quanta, or minus infinity.
        """

        rows: int
        columns: int
        wraps_rows: int
        wraps_columns: int
        four: int
        bias: scalar
        depth: scalar
        threshold: scalar
        quantum: scalar
        base: scalar

    @wp.func(module=name)
    def neighbor(constants: Constants, cell: int, k: int) -> int:
        """Neighbour k of a cell, 0 to 7 clockwise from the north; -1 beyond a wall, and on the diagonal of four."""
        if constants.four == 1 and (k & 1) == 1:
            return -1
        row = cell // constants.columns + row_step(k)
        column = cell % constants.columns + column_step(k)
        if row < 0 or row >= constants.rows:
            if constants.wraps_rows == 0:
                return -1
            row = (row + constants.rows) % constants.rows
        if column < 0 or column >= constants.columns:
            if constants.wraps_columns == 0:
                return -1
            column = (column + constants.columns) % constants.columns
        return row * constants.columns + column

    @wp.func(module=name)
    def is_inner(constants: Constants, row: int, column: int) -> bool:
        """Whether all eight neighbours of a cell lie beside it in the raster."""
        return row > 0 and row < constants.rows - 1 and column > 0 and column < constants.columns - 1

    @wp.func(module=name)
    def lower_neighbor(constants: Constants, base: int, cell: int, part: scalar, cell_height: wp.array[scalar]) -> int:
        """Number k of the neighbour that water goes to, of those that are lower; ``NONE`` if none is [Leheny1995].

        p_k = exp(E (h - h_k)) / N, where N sums over the lower neighbours only. Falls are taken from the steepest one,
        so that no exponential exceeds 1. ``part``, in [0, 1), chooses along the cumulated probabilities.
        """
        height = cell_height[base + cell]
        row = cell // constants.columns
        inner = is_inner(constants, row, cell - row * constants.columns)
        fall = vec8()
        steepest = scalar(0.0)
        for k in range(8):
            n = cell + row_step(k) * constants.columns + column_step(k)
            if not inner or constants.four == 1:
                n = neighbor(constants, cell, k)
            if n >= 0:
                fall[k] = height - cell_height[base + n]
                # Beyond a wall within the terrain there is NaN, which is never lower.
                if fall[k] > steepest:
                    steepest = fall[k]
        if steepest == ZERO:
            return NONE
        total = scalar(0.0)
        for k in range(8):
            if fall[k] > ZERO:
                fall[k] = wp.exp(constants.bias * (fall[k] - steepest))
                total += fall[k]
            else:
                fall[k] = ZERO
        rest = part * total
        chosen = int(NONE)
        for k in range(8):
            # Rounding may leave a rest at the end: then it is the last that has a probability.
            if fall[k] > ZERO and rest >= ZERO:
                chosen = k
                rest -= fall[k]
        return chosen

    @wp.func(module=name)
    def slip(constants: Constants, difference: scalar) -> scalar:
        """A quarter of a difference in height, down to a whole number of quanta."""
        return wp.floor(QUARTER * difference / constants.quantum) * constants.quantum

    @wp.func(module=name)
    def pair_color(line: int, lines: int, wraps: int) -> int:
        """Colour of the pairs that begin in a row or column: its parity, or 2 for the last one of an odd ring."""
        if wraps == 1 and (lines & 1) == 1 and line == lines - 1:
            return 2
        return line & 1

    @wp.func(module=name)
    def settle_around(
        constants: Constants,
        base: int,
        size: int,
        cell_height_io: wp.array[scalar],
        stack_io: wp.array[int],
        cell_waiting_io: wp.array[wp.uint8],
    ) -> int:
        """Let slides come down to the cells on the stack, the last one first, until there is rest; counts the slides.

        Around a cell the neighbours are dealt with clockwise from the north: each is lowered by a quarter of the
        difference until that is no more than M, and then waits on the stack itself.
        """
        slides = int(0)
        while size > 0:
            size -= 1
            cell = stack_io[base + size]
            cell_waiting_io[base + cell] = NO
            height = cell_height_io[base + cell]
            row = cell // constants.columns
            inner = is_inner(constants, row, cell - row * constants.columns)
            for k in range(8):
                n = cell + row_step(k) * constants.columns + column_step(k)
                if not inner or constants.four == 1:
                    n = neighbor(constants, cell, k)
                if n >= 0:
                    difference = cell_height_io[base + n] - height
                    if difference > constants.threshold:
                        while difference > constants.threshold:
                            difference -= slip(constants, difference)
                            slides += 1
                        cell_height_io[base + n] = height + difference
                        if cell_waiting_io[base + n] == NO:
                            cell_waiting_io[base + n] = YES
                            stack_io[base + size] = n
                            size += 1
        return slides

    @wp.kernel(module=name, enable_backward=False)
    def erode_serially(
        # params
        constants: Constants,
        events: Events,
        # in
        ground: wp.array[int],
        cell_state: wp.array[wp.uint8],
        # out
        cell_height_io: wp.array[scalar],
        stack_io: wp.array[int],
        cell_waiting_out: wp.array[wp.uint8],
        grid_tally_io: wp.array[wp.int64],
    ):
        """Do events of one grid, one after another [Leheny1995].

        Rain falls on a random cell, walks down to an outlet, lowers each cell of its way by D, but none below the base
        level and none to the height of the next one or below it; then slides come to rest. The numbers of an event are
        those of a counter-based state made of the grid's seed and the event. The tally gains visited cells, slides, and
        walks that ended elsewhere than at an outlet: three numbers a grid. ``cell_waiting_out`` is 0 before and after.
        """
        grid = wp.tid()
        base = grid * cell_state.shape[0]
        visits = wp.int64(0)
        slides = wp.int64(0)
        stuck = wp.int64(0)
        for event in range(events.first, events.first + events.count):
            random = wp.rand_init(events.seed[grid], event)
            cell = ground[wp.randi(random, 0, ground.shape[0])]
            size = int(0)
            k = int(0)
            while k != NONE:
                stack_io[base + size] = cell
                size += 1
                k = NONE
                if cell_state[cell] != OUTLET:
                    k = lower_neighbor(constants, base, cell, scalar(wp.randf(random)), cell_height_io)
                    if k == NONE:
                        stuck += wp.int64(1)
                    else:
                        cell = neighbor(constants, cell, k)
            floor = scalar(constants.base)
            for i in range(size):
                visited = stack_io[base + size - 1 - i]
                height = cell_height_io[base + visited]
                # A cell above the next one by a quantum is never raised by this.
                height = wp.max(height - constants.depth, wp.min(height, floor))
                floor = height + constants.quantum
                cell_height_io[base + visited] = height
                cell_waiting_out[base + visited] = YES
            visits += wp.int64(size)
            slides += wp.int64(settle_around(constants, base, size, cell_height_io, stack_io, cell_waiting_out))
        grid_tally_io[3 * grid] += visits
        grid_tally_io[3 * grid + 1] += slides
        grid_tally_io[3 * grid + 2] += stuck

    @wp.kernel(module=name, enable_backward=False)
    def walk_together(
        # params
        constants: Constants,
        walks: Walks,
        # in
        ground: wp.array[int],
        cell_state: wp.array[wp.uint8],
        cell_height: wp.array[scalar],
        # out
        cell_next_io: wp.array[int],
        cell_visits_io: wp.array[int],
        tally_io: wp.array[wp.int64],
    ):
        """Walk of the event walks.first + tid over heights that stay as they are; counts the visits of each cell.

        All walks of a batch leave a cell by the same neighbour: its random number belongs to batch and cell. So no
        cell loses more than the one that its water goes to, and no pit can come up. What a cell's first visitor has
        worked out is kept for the others; any of them would write the same. ``cell_next_io`` is ``UNKNOWN`` before.
        """
        event = walks.first + wp.tid()
        random = wp.rand_init(walks.seed, event)
        cell = ground[wp.randi(random, 0, ground.shape[0])]
        size = int(0)
        while cell >= 0:
            wp.atomic_add(cell_visits_io, cell, 1)
            size += 1
            below = int(UNKNOWN)
            if cell_state[cell] != OUTLET:
                below = cell_next_io[cell]
                if below == UNKNOWN:
                    turn = wp.rand_init(walks.turn_seed, cell)
                    k = lower_neighbor(constants, 0, cell, scalar(wp.randf(turn)), cell_height)
                    if k == NONE:
                        wp.atomic_add(tally_io, 2, wp.int64(1))
                    else:
                        below = neighbor(constants, cell, k)
                        cell_next_io[cell] = below
            cell = below
        wp.atomic_add(tally_io, 0, wp.int64(size))

    @wp.kernel(module=name, enable_backward=False)
    def begin_grading(
        # params
        constants: Constants,
        # in
        cell_state: wp.array[wp.uint8],
        cell_height: wp.array[scalar],
        cell_visits: wp.array[int],
        cell_next: wp.array[int],
        # out
        cell_graded_out: wp.array[scalar],
        cell_ahead_out: wp.array[int],
    ):
        """Height of each cell after a batch if only outlets are held at the base level, and the next cell of its water.

        Cells without a next one, or that no rain has visited, are ahead of none: -1.
        """
        cell = wp.tid()
        visits = cell_visits[cell]
        height = cell_height[cell]
        lowered = height - scalar(visits) * constants.depth
        ahead = int(-1)
        if visits > 0:
            if cell_state[cell] == OUTLET:
                lowered = wp.max(lowered, wp.min(height, constants.base))
            else:
                ahead = cell_next[cell]
        cell_graded_out[cell] = lowered
        cell_ahead_out[cell] = ahead

    @wp.kernel(module=name, enable_backward=False)
    def double_grading(
        # params
        rise: scalar,
        # in
        cell_graded: wp.array[scalar],
        cell_ahead: wp.array[int],
        # out
        next_graded_out: wp.array[scalar],
        next_ahead_out: wp.array[int],
    ):
        """Raise each cell above the one that is 2^k cells ahead, by a quantum a cell, and look twice as far ahead.

        After n rounds a cell is as high as the next 2^n cells of its way require: max of h_i + i quantum.
        """
        cell = wp.tid()
        ahead = cell_ahead[cell]
        height = cell_graded[cell]
        farther = int(-1)
        if ahead >= 0:
            height = wp.max(height, cell_graded[ahead] + rise)
            farther = cell_ahead[ahead]
        next_graded_out[cell] = height
        next_ahead_out[cell] = farther

    @wp.kernel(module=name, enable_backward=False)
    def raise_graded(
        # in
        cell_graded: wp.array[scalar],
        # out
        cell_height_io: wp.array[scalar],
    ):
        """Raise cells that a batch has lowered to the height that their way to the base level requires."""
        cell = wp.tid()
        # Not by max: NaN stays.
        if cell_graded[cell] > cell_height_io[cell]:
            cell_height_io[cell] = cell_graded[cell]

    @wp.func(module=name)
    def words_of_row(constants: Constants) -> int:
        """Words that have the marks of a row's cells: column c is bit c % 64 of the word c / 64."""
        return (constants.columns + 63) >> 6

    @wp.func(module=name)
    def bit_of(column: int) -> wp.uint64:
        """Mark of a column in its word."""
        return BIT << wp.uint64(column & 63)

    @wp.func(module=name)
    def slide_pair(
        constants: Constants,
        row: int,
        column: int,
        k: int,
        cell_height_io: wp.array[scalar],
        word_marks_io: wp.array[wp.uint64],
    ) -> int:
        """Lower the higher one of a cell and its neighbour k, which exists, by quarters of the difference, and mark it.

        Returns the number of slides.
        """
        high = row * constants.columns + column
        low = high + row_step(k) * constants.columns + column_step(k)
        if not is_inner(constants, row, column):
            low = neighbor(constants, high, k)
        difference = cell_height_io[high] - cell_height_io[low]
        if not wp.abs(difference) > constants.threshold:
            return 0
        own = int(row)
        place = int(column)
        if difference < ZERO:
            n = high
            high = low
            low = n
            difference = -difference
            own = high // constants.columns
            place = high - own * constants.columns
        slides = int(0)
        while difference > constants.threshold:
            difference -= slip(constants, difference)
            slides += 1
        cell_height_io[high] = cell_height_io[low] + difference
        wp.atomic_or(word_marks_io, own * words_of_row(constants) + (place >> 6), bit_of(place))
        return slides

    @wp.kernel(module=name, enable_backward=False)
    def lower_visited(
        # params
        constants: Constants,
        chunk: int,
        # out
        cell_height_io: wp.array2d[scalar],
        cell_visits_io: wp.array2d[int],
        cell_next_out: wp.array2d[int],
        word_marks_io: wp.array[wp.uint64],
    ):
        """Lower the cells of a part of a row by D a visit, mark them, and make them ready for the next batch.

        ``chunk``, the length of a part, divides 64.
        """
        row, part = wp.tid()
        marks = wp.uint64(0)
        for column in range(part * chunk, wp.min((part + 1) * chunk, constants.columns)):
            visits = cell_visits_io[row, column]
            if visits > 0:
                cell_height_io[row, column] = cell_height_io[row, column] - scalar(visits) * constants.depth
                cell_visits_io[row, column] = 0
                cell_next_out[row, column] = UNKNOWN
                marks = marks | bit_of(column)
        if marks != NO_BITS:
            wp.atomic_or(word_marks_io, row * words_of_row(constants) + (part * chunk >> 6), marks)

    @wp.kernel(module=name, enable_backward=False)
    def mark_steep(
        # params
        constants: Constants,
        chunk: int,
        # in
        listed: wp.array[int],
        word_beside: wp.array[wp.uint64],
        cell_height: wp.array[scalar],
        # out
        word_steep_io: wp.array2d[wp.uint64],
    ):
        """Mark the pairs that differ by more than M: those of marked cells and their neighbours 2 + i in line i.

        Only listed words of marks are looked at. ``chunk``, the length of a thread's part of a word, divides 64.
        """
        place, part = wp.tid()
        word = listed[place]
        row = word // words_of_row(constants)
        column = (word - row * words_of_row(constants)) * 64 + part * chunk
        end = column + chunk
        rest = word_beside[word] >> wp.uint64(part * chunk)
        while rest != NO_BITS and column < end:
            if (rest & BIT) != NO_BITS:
                cell = row * constants.columns + column
                height = cell_height[cell]
                inner = is_inner(constants, row, column)
                for k in range(2, 6):
                    n = cell + row_step(k) * constants.columns + column_step(k)
                    if not inner or constants.four == 1:
                        n = neighbor(constants, cell, k)
                    if n >= 0:
                        if wp.abs(height - cell_height[n]) > constants.threshold:
                            wp.atomic_or(word_steep_io, k - 2, word, bit_of(column))
            step = wp.where((rest & BYTE) == NO_BITS, 8, 1)
            rest = rest >> wp.uint64(step)
            column += step

    @wp.kernel(module=name, enable_backward=False)
    def slide_pairs(
        # params
        constants: Constants,
        pairs: Pairs,
        # in
        listed: wp.array[int],
        word_steep: wp.array2d[wp.uint64],
        # out
        cell_height_io: wp.array[scalar],
        word_marks_io: wp.array[wp.uint64],
        tally_io: wp.array[wp.int64],
    ):
        """Bring those of the marked pairs to rest that have one colour, of cells and one of their neighbours k, 2 to 5.

        Pairs are coloured by the parity of the column (k = 2) or row that they begin in; where that wraps around and is
        odd in number, the last one has colour 2. No cell is in two pairs of a k and colour: the order does not matter.
        Only listed words are looked at; cells that were lowered are marked.
        """
        place, part = wp.tid()
        k, color, chunk = pairs.k, pairs.color, pairs.chunk
        word = listed[place]
        rest = word_steep[k - 2, word] >> wp.uint64(part * chunk)
        if rest == NO_BITS:
            return
        row = word // words_of_row(constants)
        column = (word - row * words_of_row(constants)) * 64 + part * chunk
        end = column + chunk
        own = pair_color(row, constants.rows, constants.wraps_rows)
        if k != 2 and own != color:
            end = 0
        slides = int(0)
        while rest != NO_BITS and column < end:
            if (rest & BIT) != NO_BITS:
                if k == 2:
                    own = pair_color(column, constants.columns, constants.wraps_columns)
                if own == color:
                    slides += slide_pair(constants, row, column, k, cell_height_io, word_marks_io)
            step = wp.where((rest & BYTE) == NO_BITS, 8, 1)
            rest = rest >> wp.uint64(step)
            column += step
        if slides > 0:
            wp.atomic_add(tally_io, 1, wp.int64(slides))

    @wp.kernel(module=name, enable_backward=False)
    def raise_courses(
        # params
        constants: Constants,
        min_fall: scalar,
        # in
        cell_below: wp.array[int],
        order: wp.array[int],
        # out
        cell_height_io: wp.array[scalar],
    ):
        """Raise cells until each lies ``min_fall`` or more above the one below it on its course; on one thread.

        ``order`` has each cell after the one below it, which is -1 at outlets.
        """
        for i in range(order.shape[0]):
            cell = order[i]
            below = cell_below[cell]
            if below >= 0:
                floor = cell_height_io[below] + min_fall
                if cell_height_io[cell] < floor:
                    cell_height_io[cell] = floor

    return SimpleNamespace(
        Constants=Constants,
        Events=Events,
        Walks=Walks,
        Pairs=Pairs,
        erode_serially=erode_serially,
        begin_grading=begin_grading,
        double_grading=double_grading,
        raise_graded=raise_graded,
        walk_together=walk_together,
        lower_visited=lower_visited,
        mark_steep=mark_steep,
        slide_pairs=slide_pairs,
        raise_courses=raise_courses,
    )
