"""Whole numbers in order, against NumPy's own functions."""

import numpy as np
import pytest

from warpriver.riverscape.sorting import boxes, distinct, grouped, stable_order

KEYS = [np.random.default_rng(0).integers(0, 50, 1000), np.zeros(1, np.int64), np.zeros(0, np.int64)]
# No room beside it for the place.
KEYS.append(np.array([2**62, 5, 2**62, 0, 5]))


@pytest.mark.parametrize("key", KEYS, ids=["many", "one", "none", "large"])
def test_order_and_groups_are_those_of_numpy(key):
    np.testing.assert_array_equal(stable_order(key), np.argsort(key, kind="stable"))
    np.testing.assert_array_equal(distinct(-key), np.unique(-key))
    for found, expected in zip(grouped(key), np.unique(key, return_inverse=True), strict=True):
        np.testing.assert_array_equal(found, expected)


def test_boxes_are_listed_row_by_row():
    low, high = np.array([[3, -2], [0, 0], [7, 7]]), np.array([[5, -1], [0, 2], [6, 7]])
    expected = [
        (k, column, row)
        for k in range(3)
        for row in range(low[k, 1], high[k, 1] + 1)
        for column in range(low[k, 0], high[k, 0] + 1)
    ]
    np.testing.assert_array_equal(np.column_stack(boxes(low, high)), expected)
