"""Long profiles and moving windows of a valley."""

import math

import numpy as np
import pytest

import warpriver as wr
from warpriver import valley as g

U = np.linspace(0.0, 1.0, 20001)
FORMS = [("exponential", 0.5), ("logarithmic", 0.5), ("power", 0.5), ("power", 1.0), ("power", 1.7)]


@pytest.mark.parametrize("ratio", [30.0, 3.0, 0.2])
@pytest.mark.parametrize(("form", "exponent"), FORMS)
def test_slopes_of_a_profile_are_those_of_its_form(form, exponent, ratio):
    """Against the slope that each form states, by differences of second order."""
    height = g.LongProfile(form, ratio, exponent).height(U)
    assert height[0] == pytest.approx(1.0) and height[-1] == pytest.approx(0.0, abs=1e-12)
    slope = -np.gradient(height, U, edge_order=2)
    c = ratio ** (1.0 / exponent) - 1.0
    stated = {
        "exponential": ratio**-U,
        "logarithmic": 1.0 / (1.0 + (ratio - 1.0) * U),
        "power": (1.0 + c * U) ** -exponent,
    }[form]
    # Close to a steep head a step of 1/20,000 tells the slope to 1e-3 only.
    np.testing.assert_allclose(slope, stated / np.trapezoid(stated, U), rtol=1e-3)
    np.testing.assert_allclose(slope[200:-1], (stated / np.trapezoid(stated, U))[200:-1], rtol=2e-5)


def test_a_ratio_of_1_is_a_straight_line():
    for form, exponent in FORMS:
        np.testing.assert_allclose(g.LongProfile(form, 1.0, exponent).height(U), 1.0 - U, atol=1e-12)


@pytest.mark.parametrize("fall", ["valley", "channel"])
def test_a_valley_follows_its_profile(fall, device):
    profile = g.LongProfile("exponential", 8.0)
    straight, bent = (
        wr.synthetic_valley("S3", profile=p, fall=fall, length=600.0, device=device) for p in (g.LongProfile(), profile)
    )
    x = np.array([5.0, 150.0, 300.0, 450.0, 595.0])
    fallen = 0.002 * 600.0
    # On the valley's side, where the slope along the axis alone counts: to the step of the table squared.
    side = straight.lines.table[:, 1].max() + 1.0
    places = np.column_stack([x, np.full(5, side)])
    rise = bent.height(places) - straight.height(places)
    np.testing.assert_allclose(rise, fallen * profile.bend(x / 600.0), atol=1e-5)
    # Top of bank and thalweg bend with it, along the channel or along the axis; widths and depths stay.
    for name in ("thalweg", "left_bank"):
        lines = bent.breaklines()[name], straight.breaklines()[name]
        reach = bent.stations.reach
        at = bent.stations.line.s[reach] / bent.stations.length
        if fall == "valley":
            at = np.clip(lines[0][:, 0] / 600.0, 0.0, 1.0)
        # Off the centreline the plane is that of another x, by at most half a width.
        off = 0.5 * bent.params.width / 600.0 * fallen * 8.0 if fall == "channel" else 2e-5
        np.testing.assert_allclose(lines[0][:, 2] - lines[1][:, 2], fallen * profile.bend(at), atol=off)
    np.testing.assert_array_equal(bent.stations.depth, straight.stations.depth)
    np.testing.assert_allclose(
        bent.breaklines()["thalweg"][:, 2], bent.height(bent.breaklines()["thalweg"][:, :2]), atol=2e-3
    )


def test_the_bed_of_a_concave_river_falls_all_along():
    made = wr.synthetic_valley("S3", profile=g.LongProfile("logarithmic", 20.0), controls={}, length=5000.0)
    assert (np.diff(made.breaklines()["thalweg"][:, 2]) < 0.0).all()
    first, last = made.breaklines()["left_bank"][[0, -1], 2]
    assert first - last == pytest.approx(0.002 * 5000.0, rel=1e-6)


def riffles(u):
    """Bedforms whose height grows downstream."""
    return (0.05 + 0.5 * u) * np.sin(2.0 * math.pi * 8.0 * u)


def test_top_of_bank_follows_the_riffle_crests_within_its_window():
    """Within one wave of the window the depth over the local crest is the bankfull depth."""
    wave = 420.0 / 8.0
    plain, windowed = (wr.synthetic_valley("S1", controls={"thalweg": riffles}, bank_window=w) for w in (None, wave))
    reach = plain.stations.reach
    for made in (plain, windowed):
        assert (made.stations.depth[reach] >= made.bankfull_depth * (1.0 - 1e-12)).all()
    crests = [np.argmin(windowed.stations.depth[reach][k : k + 98]) + k for k in range(0, 784, 98)]
    over = windowed.stations.depth[reach][crests] / windowed.bankfull_depth
    # A window of one wave holds the neighbouring crest as well, which is higher by 1/16 of the mean depth.
    assert over.max() < 1.0 + 0.08 and plain.stations.depth[reach][crests].max() / plain.bankfull_depth > 1.4
    np.testing.assert_allclose(
        (windowed.stations.thalweg - plain.stations.thalweg)[reach], 0.0, atol=1e-12, err_msg="the bed stays"
    )
    assert windowed.stations.bank_height == plain.stations.bank_height


def test_the_floor_follows_the_banks_within_its_window(device):
    """In a channel whose bends grow downstream the floor is narrow upstream; no bank lies beyond its edge."""
    controls = {"centerline": lambda u: 60.0 * u * np.sin(2.0 * math.pi * 4.0 * u)}
    plain, windowed = (
        wr.synthetic_valley("S3", controls=controls, length=1200.0, floor_window=w, device=device)
        for w in (None, 300.0)
    )
    for made in (plain, windowed):
        x = made.lines.start + made.lines.step * np.arange(len(made.lines.table))
        for bank in ("left_bank", "right_bank"):
            xyz = made.breaklines()[bank]
            assert (xyz[:, 1] <= np.interp(xyz[:, 0], x, made.lines.table[:, 0]) + 1e-9).all()
            assert (xyz[:, 1] >= np.interp(xyz[:, 0], x, made.lines.table[:, 2]) - 1e-9).all()
    wide = [made.lines.table[:, 0] - made.lines.table[:, 2] for made in (plain, windowed)]
    assert np.ptp(wide[0]) < 1e-9 and wide[1][:100].mean() < 0.7 * wide[1][-100:].mean()
    assert (wide[1] <= wide[0] + 1e-9).all()
    # Where the window is longer than the reach, both are one.
    whole = wr.synthetic_valley("S3", controls=controls, length=1200.0, floor_window=1e5, device=device)
    np.testing.assert_allclose(whole.lines.table, plain.lines.table, atol=1e-9)


def test_bad_profiles_and_windows_are_refused():
    for make, message in (
        (lambda: g.LongProfile("cubic"), "LongProfile.form is 'cubic'"),
        (lambda: g.LongProfile("power", 0.0), "LongProfile.slope_ratio is 0"),
        (lambda: wr.synthetic_valley("S1", bank_window=0.0), "bank_window is 0; give a finite number above 0"),
        (lambda: wr.synthetic_valley("S1", floor_window=math.nan), "floor_window is nan"),
    ):
        with pytest.raises(ValueError, match=message):
            make()
