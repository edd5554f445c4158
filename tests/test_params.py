import dataclasses
import math

import numpy as np
import pytest

from warpriver.parameter import describe
from warpriver.params import DAYS_PER_YEAR, MeanderParams, PathMeander


def test_paper_values_are_table_1():
    p = MeanderParams.paper()
    assert p.time_step * DAYS_PER_YEAR == pytest.approx(106.0, rel=1e-15)
    assert p.migration_rate / DAYS_PER_YEAR == pytest.approx(0.164, rel=1e-15)
    assert (p.spacing, p.friction, p.local_weight, p.upstream_weight) == (50.0, 0.011, -1.0, 2.5)
    # The default, 60 m/yr, is the same number rounded.
    assert MeanderParams().migration_rate == pytest.approx(p.migration_rate, rel=2e-3)


def test_every_field_states_unit_source_and_meaning():
    for name, default, unit, source, doc in describe(MeanderParams):
        # What follows from the network has no number, nor has what is left out.
        assert (
            (
                default is not None
                or name
                in ("reference_width", "avulsions", "friction", "memory_length", "floodplain", "chutes", "widths")
            )
            and unit
            and source
            and doc
        ), name


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"time_step": 0.0}, "time_step"),
        ({"spacing": -1.0}, "spacing"),
        ({"friction": math.nan}, "friction"),
        ({"migration_rate": math.inf}, "migration_rate"),
        ({"local_weight": 0.5}, "local_weight"),
        ({"sinuosity_scaling": "half"}, "'upstream', 'whole', 'none'"),
        ({"cutoff_min_arc": 1.0}, "cutoff_min_arc"),
        ({"spacing": "50"}, "spacing"),
        ({"end_damping": True}, "end_damping"),
    ],
)
def test_a_value_out_of_range_is_named(change, word):
    with pytest.raises(ValueError, match=word):
        MeanderParams(**change)


def test_the_reference_width_is_that_of_the_widest_channel_where_widths_differ():
    alike, mixed = np.array([40.0, 40.0]), np.array([12.0, 90.0, 30.0])
    assert MeanderParams().for_widths(alike) == MeanderParams()
    assert MeanderParams().for_widths(mixed) == MeanderParams(reference_width=90.0)
    for own in (MeanderParams(reference_width=0.0), MeanderParams(reference_width=30.0), MeanderParams.paper()):
        assert own.for_widths(mixed) == own
    assert PathMeander().for_widths(mixed) == PathMeander()


def test_params_are_frozen_and_replaceable():
    p = MeanderParams()
    with pytest.raises(dataclasses.FrozenInstanceError):
        p.spacing = 10.0
    assert p.replace(spacing=10.0).spacing == 10.0
    with pytest.raises(ValueError, match="spacing"):
        p.replace(spacing=0.0)


def test_a_friction_that_is_given_tells_the_memory():
    """The default is a length in widths; neither of the two is passed over without a word."""
    assert (MeanderParams().friction, MeanderParams().memory_length) == (0.011, 2.2)
    assert (MeanderParams(friction=0.011).friction, MeanderParams(friction=0.011).memory_length) == (0.011, 0.0)
    assert MeanderParams(friction=0.02).memory_length == 0.0
    assert MeanderParams(memory_length=3.0).memory_length == 3.0
    assert MeanderParams(friction=0.02).replace(migration_rate=9.0).friction == 0.02
    assert MeanderParams().replace(friction=0.02, memory_length=0.0).friction == 0.02
    assert (MeanderParams.paper().friction, MeanderParams.paper().memory_length) == (0.011, 0.0)
    with pytest.raises(ValueError, match="two ways to tell how far upstream"):
        MeanderParams(friction=0.02, memory_length=3.0)
    with pytest.raises(ValueError, match="leave one out, or set memory_length to 0"):
        MeanderParams().replace(friction=0.02)
