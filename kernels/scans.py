"""Running sums along arrays: whole numbers only, so that no order of additions can be seen in them."""

from types import SimpleNamespace

import warp as wp

from warpriver.kernels.variants import named, once

wp.set_module_options({"enable_backward": False})


@once
def build(scalar):
    """Make the kernels of running sums; they are the same in both precisions, in a module for each.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.scans_{scalar.__name__}"

    @wp.func(module=name)
    def no_count() -> int:
        """Zero."""
        return 0

    @wp.func(module=name)
    def no_length() -> wp.int64:
        """Zero."""
        return wp.int64(0)

    @wp.func(module=name)
    def no_pair() -> wp.vec2i:
        """Zero and zero."""
        return wp.vec2i(0, 0)

    @wp.func(module=name)
    def count_of(a: int, b: int) -> int:
        """Sum of two counts."""
        return a + b

    @wp.func(module=name)
    def length_of(a: wp.int64, b: wp.int64) -> wp.int64:
        """Sum of two lengths."""
        return a + b

    @wp.func(module=name)
    def pair_of(a: wp.vec2i, b: wp.vec2i) -> wp.vec2i:
        """Sums of two pairs of counts."""
        return a + b

    @wp.func(module=name)
    def mark_of(a: wp.vec2i, b: wp.vec2i) -> wp.vec2i:
        """Sum of the first and maximum of the second numbers, which are 0 or more."""
        return wp.vec2i(a[0] + b[0], wp.max(a[1], b[1]))

    def kernels_for(word, kind, none, combine):
        """Make the two kernels of a scan for one type and one associative operation, with its identity."""

        @wp.kernel(module=name, enable_backward=False)
        @named(f"sum_{word}")
        def sum_groups(
            # params
            group: int,
            # in
            value: wp.array[kind],
            # out
            total_out: wp.array[kind],
        ):
            """Total of each group of consecutive values, a thread a group."""
            g = wp.tid()
            total = none()
            for i in range(g * group, wp.min((g + 1) * group, value.shape[0])):
                total = combine(total, value[i])
            total_out[g] = total

        @wp.kernel(module=name, enable_backward=False)
        @named(f"scan_{word}")
        def scan_groups(
            # params
            group: int,
            upper_group: int,
            # in
            value: wp.array[kind],
            group_total: wp.array[kind],
            upper_total: wp.array[kind],
            # out
            sum_out: wp.array[kind],
        ):
            """Running sum, a thread a group: from the totals of the groups of groups before, then of the groups before.

            Without ``upper_total`` there are no groups of groups; without ``group_total`` there is one group.
            """
            g = wp.tid()
            total = none()
            first = int(0)
            if upper_total:
                for u in range(g // upper_group):
                    total = combine(total, upper_total[u])
                first = g // upper_group * upper_group
            if group_total:
                for k in range(first, g):
                    total = combine(total, group_total[k])
            for i in range(g * group, wp.min((g + 1) * group, value.shape[0])):
                total = combine(total, value[i])
                sum_out[i] = total

        return sum_groups, scan_groups

    made = {}
    for word, kind, none, combine in (
        ("counts", wp.int32, no_count, count_of),
        ("lengths", wp.int64, no_length, length_of),
        ("pairs", wp.vec2i, no_pair, pair_of),
        ("marks", wp.vec2i, no_pair, mark_of),
    ):
        made[f"sum_{word}"], made[f"scan_{word}"] = kernels_for(word, kind, none, combine)
    return SimpleNamespace(**made)
