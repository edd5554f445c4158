import math

import numpy as np
import pytest

from warpriver.validate import not_negative, one_of, positive, positive_numbers, whole


@pytest.mark.parametrize("value", [3, 3.0, np.int64(3), np.float32(3.0)])
def test_a_whole_number_is_returned_as_an_int(value):
    assert whole(value, "count", 3) == 3 and type(whole(value, "count", 3)) is int


@pytest.mark.parametrize("value", [2, 3.5, True, np.True_, "3", None, math.nan, math.inf, [3]])
def test_what_is_no_whole_number_is_named(value):
    with pytest.raises(ValueError, match=r"^count is .*; give a whole number of steps, 3 or more( and 2\d+ or less)?$"):
        whole(value, "count", 3, "steps")


@pytest.mark.parametrize("value", [0.0, -1, True, "1", None, math.nan, math.inf])
def test_what_is_not_positive_is_named(value):
    with pytest.raises(ValueError, match=r"^width is .*; give a positive number of m, such as 30$"):
        positive(value, "width", "m", ", such as 30")


@pytest.mark.parametrize("value", [-1e-9, False, "0", math.nan, math.inf])
def test_what_is_negative_is_named(value):
    with pytest.raises(ValueError, match=r"^years is .*; give a finite number, 0 or more$"):
        not_negative(value, "years")
    assert not_negative(0, "years") == 0.0


def test_words_and_columns_are_checked():
    assert one_of("d8", "method", ("d8", "mfd")) == "d8"
    with pytest.raises(ValueError, match=r"^method is 'd9'; use 'd8' or 'mfd'$"):
        one_of("d9", "method", ("d8", "mfd"))
    with pytest.raises(ValueError, match=r"^area of channel 1 is nan; it must be positive and finite$"):
        positive_numbers([1.0, math.nan], "area")
