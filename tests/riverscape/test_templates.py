"""Sections of unit area and uniform flow: the hand-worked values, and what the tables integrate to."""

import numpy as np
import pytest

from warpriver.errors import InputError
from warpriver.hydraulic_geometry import discharge
from warpriver.riverscape import FlowParams, uniform_flow, unit_sections
from warpriver.riverscape.stations import TYPES
from warpriver.riverscape.templates import (
    BEND_TABLE,
    FORM_TABLE,
    FORMS,
    LANES,
    TEMPLATES,
    bend_shape,
    section_depth,
    section_fill,
    spread_factor,
    type_index,
)


@pytest.mark.parametrize(("area", "flow"), [(1e6, 0.42), (1e7, 2.057), (1e8, 10.08), (1e9, 49.35)])
def test_discharge_is_that_of_square_kilometres(area, flow):
    assert discharge(area) == pytest.approx(flow, rel=5e-4)


@pytest.mark.parametrize(
    ("kind", "slope", "flow", "area", "speed", "width"),
    [("C", 0.008, 10.08, 8.76, 1.15, 13.2), ("E", 0.003, 10.08, 7.85, 1.28, 7.9)],
)
def test_uniform_flow_has_the_values_worked_by_hand(kind, slope, flow, area, speed, width):
    found = uniform_flow(flow, slope, TEMPLATES[TYPES.index(kind)].width_to_depth)
    # The last digit that is given.
    assert found.area == pytest.approx(area, abs=0.005)
    assert found.speed == pytest.approx(speed, abs=0.005)
    assert found.width == pytest.approx(width, abs=0.05)


def test_uniform_flow_solves_its_equations():
    random = np.random.default_rng(3)
    flow, slope, k = 10 ** random.uniform(-3, 4, 500), 10 ** random.uniform(-4, -0.5, 500), random.uniform(5, 60, 500)
    found = uniform_flow(flow, slope, k)
    np.testing.assert_allclose(found.area * found.speed, flow, rtol=1e-12)
    np.testing.assert_allclose(found.width / found.mean_depth, k, rtol=1e-12)
    s = np.minimum(slope, 0.1)
    radius = found.area / (found.width + 2.0 * found.mean_depth)
    rough = np.maximum(0.03, 0.32 * s**0.38 * radius**-0.16)
    manning = radius ** (2 / 3) * np.sqrt(s) / rough
    limit = np.sqrt(9.81 * found.mean_depth)
    np.testing.assert_allclose(found.speed, np.minimum(manning, limit), rtol=1e-10)
    assert (found.froude <= 1.0 + 1e-10).all() and (found.froude > 1.0 - 1e-9).any() and (rough == 0.03).any()


def test_roughness_and_speed_are_held_above_a_slope():
    steep, held = (uniform_flow(2.0, s, 8.0) for s in (0.3, 0.1))
    assert steep.speed == held.speed
    assert uniform_flow(2.0, 0.3, 8.0, FlowParams(steepest=0.3)).speed > steep.speed


@pytest.mark.parametrize("name", FORMS)
def test_forms_reach_from_bank_to_bank(name):
    row = FORM_TABLE[FORMS.index(name)]
    assert row[0] == row[-1] == 0.0 and row.max() == 1.0 and (row[1:-1] > 0.0).all()
    np.testing.assert_allclose(row, row[::-1])


MEANS = {
    "parabola": 2 / 3,
    "polynomial": 0.8,
    "semicircle": np.pi / 4,
    "level_half": 0.75,
    "level_wide": 0.8,
    "level_narrow": 0.65,
}


@pytest.mark.parametrize(("name", "mean"), MEANS.items())
def test_mean_depths_are_those_of_the_forms(name, mean):
    form = np.array([[FORMS.index(name)] * 2])
    fill = section_fill(form, np.zeros(1), np.full(1, 0.5), np.zeros(1))
    # 64 steps across: a semicircle's steep sides lose the most.
    assert fill[0] == pytest.approx(mean, rel=2.5e-3)


def test_templates_have_unit_area():
    width, depth = unit_sections()
    area = width * (depth[:, 1:] + depth[:, :-1]).mean(axis=1) / 2.0
    np.testing.assert_allclose(area, 1.0, rtol=1e-12)
    k = dict(zip(TYPES, width**2, strict=True))  # W over mean depth, as W D = 1
    np.testing.assert_allclose(
        [k[t] for t in ("A+", "A", "B", "C", "D", "DA", "E", "F", "G")], [8, 10, 16, 20, 20, 8, 8, 25, 9]
    )


def test_bends_are_deepest_in_their_lane():
    for lane, row in zip(LANES, BEND_TABLE, strict=True):
        assert abs(np.linspace(0, 1, len(row))[row.argmax()] - lane) <= 1 / 64
        assert row.max() == pytest.approx(1.0, abs=0.03) and row[0] == 0.0 and abs(row[-1]) < 1e-12


def test_the_outer_bank_is_the_deep_one():
    lane, weight = bend_shape(np.array([0.1, 0.0, -0.1, 0.02]), np.full(4, 5.0), (0.1, 0.9))
    np.testing.assert_allclose(lane, [0.9, 0.5, 0.1, 0.6])  # a left turn deepens the right bank
    np.testing.assert_allclose(weight, [1.0, 0.0, 1.0, 0.25])


def test_speed_across_carries_the_discharge():
    """The integral of u d over the width, u ~ d^(2/3), by an independent fine sum."""
    random = np.random.default_rng(1)
    n = 40
    form, blend = random.integers(0, 6, (n, 2)), random.uniform(0, 1, n)
    lane, bend = random.uniform(0.1, 0.9, n), random.uniform(0, 1, n)
    fill, factor = section_fill(form, blend, lane, bend), spread_factor(form, blend, lane, bend)
    share = (np.arange(6400) + 0.5) / 6400
    for i in range(n):
        one = [np.repeat(v[i : i + 1], len(share), axis=0) for v in (form, blend, lane, bend)]
        depth = section_depth(share, *one)
        assert depth.mean() == pytest.approx(fill[i], rel=1e-4)
        # Unit mean speed: discharge over area is the mean depth.
        assert (factor[i] * depth ** (2 / 3) * depth).mean() == pytest.approx(fill[i], rel=2e-4)


def test_types_are_known_by_their_words():
    assert [TYPES[type_index(w)] for w in ("C", "C4", "A+", "Aa+3", "DA5")] == ["C", "C", "A+", "A+", "DA"]
    with pytest.raises(InputError, match="type is 'H'; use A"):
        type_index("H")


@pytest.mark.parametrize(("flow", "slope", "k"), [(0.0, 0.01, 8.0), (1.0, np.nan, 8.0), (1.0, 0.01, -1.0)])
def test_impossible_flows_are_refused(flow, slope, k):
    with pytest.raises(InputError, match=r"flow is|slope holds|width_to_depth is"):
        uniform_flow(flow, slope, k)
