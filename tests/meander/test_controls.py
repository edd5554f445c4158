"""Controls: their fields, gradients and factors, and the rasters that hold them."""

import math

import numpy as np
import pytest

from warpriver.io import read_raster, write_raster
from warpriver.meander.control_map import ControlMap
from warpriver.meander.controls import Attractor, ControlField, DampingRegion, ErodibilityField, Guide, Repeller
from warpriver.raster import Raster

RADIUS = 800.0


def radial(xy, center=(0.0, 0.0), radius=RADIUS, strength=1.0):
    """The field that attractors state."""
    p = np.hypot(*(np.asarray(xy) - center).T) / radius
    return strength * radius / (96.0 / (25.0 * math.sqrt(5.0))) * np.maximum(1.0 - p**2, 0.0) ** 3


def numeric_gradient(field, xy, step=1e-3):
    east, north = np.array([step, 0.0]), np.array([0.0, step])
    return np.stack([(field(xy + e) - field(xy - e)) / (2.0 * step) for e in (east, north)], axis=1)


def scattered(count=400, reach=900.0, seed=0):
    return np.random.default_rng(seed).uniform(-reach, reach, (count, 2))


def guide_field(line, radius, strength=1.0):
    shapely = pytest.importorskip("shapely")

    def field(xy):
        p = shapely.distance(shapely.LineString(line), shapely.points(xy)) / radius
        return strength * radius / (96.0 / (25.0 * math.sqrt(5.0))) * np.maximum(1.0 - p**2, 0.0) ** 3

    return field


LINE = np.array([[-500.0, -300.0], [0.0, 100.0], [600.0, 50.0]])
CASES = {
    "attractor": (Attractor((0.0, 0.0), RADIUS, 1.0), radial),
    "repeller": (Repeller((50.0, -20.0), 600.0, 0.7), lambda xy: -radial(xy, (50.0, -20.0), 600.0, 0.7)),
    "guide": (Guide(LINE, 300.0, 0.5), lambda xy: guide_field(LINE, 300.0, 0.5)(xy)),
}


@pytest.mark.parametrize("name", CASES)
def test_gradients_are_those_of_the_field_to_second_order(name, monkeypatch, device):
    """Halved cells leave a quarter of the error; where a guide bends, its distance has a kink: away from it."""
    control, field = CASES[name]
    xy = scattered()
    if name == "guide":
        # Within 20 cells' width of the bisector at its corner, and of the line itself, c is not smooth.
        expected = numeric_gradient(field, xy)
        kinks = np.hypot(*(xy - LINE[1]).T) < 330.0
        xy = xy[~kinks]
    expected = numeric_gradient(field, xy)
    errors = []
    for across in (8.0, 16.0, 32.0):
        monkeypatch.setattr("warpriver.meander.controls.CELLS_ACROSS", across)
        errors.append(np.sqrt(np.mean((ControlMap([control], device=device).gradient(xy) - expected) ** 2)))
    assert 3.4 < errors[0] / errors[1] < 4.6 and 3.4 < errors[1] / errors[2] < 4.6, errors
    assert errors[2] < 2e-3


def test_gradients_of_painted_fields_are_of_second_order(device):
    xy, errors = scattered(reach=700.0), []
    expected = numeric_gradient(radial, xy)
    for across in (8, 16, 32):
        size = RADIUS / across
        x = -1000.0 + size * (np.arange(round(2000.0 / size)) + 0.5)
        places = np.stack(np.meshgrid(x, -x), axis=-1).reshape(-1, 2)
        field = ControlField(radial(places).reshape(len(x), len(x)), size, (-1000.0, 1000.0))
        errors.append(np.sqrt(np.mean((ControlMap([field], device=device).gradient(xy) - expected) ** 2)))
    assert 3.4 < errors[0] / errors[1] < 4.6 and 3.4 < errors[1] / errors[2] < 4.6, errors


@pytest.mark.parametrize("strength", [0.3, 1.0, 2.5])
def test_the_greatest_gradient_is_the_strength(strength, device):
    line = np.column_stack([np.linspace(0.0, RADIUS, 400), np.zeros(400)])
    found = ControlMap([Attractor((0.0, 0.0), RADIUS, strength)], device=device).gradient(line)
    # Cells of a sixteenth of the radius: within 3 %.
    assert np.hypot(*found.T).max() == pytest.approx(strength, rel=0.03)
    assert (found[:, 0] <= 1e-12).all(), "towards the attractor"


def test_controls_add_up_and_factors_multiply(device):
    square = [(-400.0, -400.0), (400.0, -400.0), (400.0, 400.0), (-400.0, 400.0)]
    controls = [
        Attractor((0.0, 0.0), RADIUS),
        Repeller((100.0, 0.0), RADIUS, 0.5),
        DampingRegion(square, 0.5, blend=200.0),
        ErodibilityField(square, 3.0),
    ]
    made = ControlMap(controls, device=device)
    rows, columns = np.indices(made.raster.shape)
    size, (west, north) = made.raster.cell_size, made.raster.origin
    xy = np.stack([west + (columns + 0.5) * size, north - (rows + 0.5) * size], axis=-1).reshape(-1, 2)
    c = radial(xy) - radial(xy, (100.0, 0.0), strength=0.5)
    np.testing.assert_allclose(made.raster.numpy().ravel(), c, atol=1e-9)
    inside = np.maximum(400.0 - np.abs(xy).max(axis=1), 0.0)
    t = np.clip(inside / 200.0, 0.0, 1.0)
    factor = np.where(inside > 0.0, (1.0 - 0.5 * t * t * (3.0 - 2.0 * t)) * 3.0, 1.0)
    np.testing.assert_allclose(made.factor.numpy().ravel(), factor, atol=1e-9)
    # Around all that is stamped, the field and its gradient are 0.
    rim = made.raster.numpy()
    assert not rim[:2].any() and not rim[-2:].any() and not rim[:, :2].any() and not rim[:, -2:].any()


def test_painted_fields_are_read_bilinear_and_gaps_count_as_0(device):
    values = np.random.default_rng(2).normal(0.0, 5.0, (12, 15))
    values[4, 5] = np.nan
    field = ControlField(values, 40.0, (100.0, 900.0), device=device)
    made = ControlMap([field], device=device)
    inner = made.raster.sample(np.array([[100.0 + 40.0 * 3.5, 900.0 - 40.0 * 8.5]]))
    assert inner[0] == pytest.approx(values[8, 3])
    gap = np.array([[100.0 + 40.0 * 5.5, 900.0 - 40.0 * 4.5]])
    assert made.raster.sample(gap)[0] == 0.0 and np.isfinite(made.gradient(gap)).all()
    assert not made.gradient(np.array([[-5000.0, 0.0]])).any()


def test_brushes_paint_erase_and_smooth(device):
    field = ControlField.blank((0.0, 0.0, 1000.0, 600.0), 10.0, device=device)
    assert field.raster.shape == (60, 100) and not field.raster.numpy().any()
    field.paint((505.0, 305.0), 200.0, 80.0)
    assert field.raster.sample([(505.0, 305.0)])[0] == pytest.approx(80.0)
    field.paint((205.0, 305.0), 100.0, -30.0)
    assert field.raster.numpy().min() == pytest.approx(-30.0)
    before = field.raster.numpy().std()
    field.smooth((505.0, 305.0), 200.0)
    assert field.raster.numpy().std() < before
    field.erase((505.0, 305.0), 400.0, 1.0)
    assert field.raster.sample([(505.0, 305.0)])[0] == 0.0


def test_an_image_is_a_field():
    gray = np.array([[0, 128, 255], [255, 255, 255]], np.uint8)
    field = ControlField.from_gray(gray, (0.0, 0.0, 30.0, 20.0), 50.0)
    np.testing.assert_allclose(field.raster.numpy(), (2.0 * gray / 255.0 - 1.0) * 50.0)
    assert field.raster.cell_size == 10.0 and field.raster.origin == (0.0, 20.0)
    with pytest.raises(ValueError, match="pixels of 20 x 10 m"):
        ControlField.from_gray(gray, (0.0, 0.0, 60.0, 20.0), 50.0)
    with pytest.raises(ValueError, match="must lie from 0 to 1"):
        ControlField.from_gray(gray * 1.0, (0.0, 0.0, 30.0, 20.0), 50.0)


def test_an_image_file_and_a_raster_file_are_fields(tmp_path):
    imageio = pytest.importorskip("imageio.v3")
    gray = np.array([[0, 128, 255], [255, 40, 255]], np.uint8)
    bounds = (0.0, 0.0, 30.0, 20.0)
    for name, pixels in (("gray.png", gray), ("color.png", np.repeat(gray[..., None], 3, axis=2))):
        imageio.imwrite(tmp_path / name, pixels)
        field = ControlField.from_image(tmp_path / name, bounds, 50.0)
        np.testing.assert_allclose(field.raster.numpy(), (2.0 * gray / 255.0 - 1.0) * 50.0, rtol=1e-12, atol=1e-12)
    write_raster(field.raster, tmp_path / "c.npz")
    assert ControlField(read_raster(tmp_path / "c.npz")) == field
    (tmp_path / "text.png").write_text("no image")
    for name, message in (("none.png", "no image at"), ("text.png", "cannot be read as an image")):
        with pytest.raises(ValueError if name == "text.png" else FileNotFoundError, match=message):
            ControlField.from_image(tmp_path / name, bounds, 50.0)


def test_changed_controls_come_to_the_bits_of_new_ones(device):
    """Only cells that what has changed reaches are written, and they hold what a map made anew would."""
    rng = np.random.default_rng(5)
    corner = [Attractor((0.0, 0.0), 400.0), Attractor((9000.0, 9000.0), 400.0)]
    controls = corner + [
        (Attractor, Repeller)[k % 2](tuple(rng.uniform(500.0, 8500.0, 2)), rng.uniform(400.0, 900.0)) for k in range(30)
    ]
    controls.append(DampingRegion([(1000.0, 1000.0), (4000.0, 1500.0), (2000.0, 5000.0)], 0.2, blend=300.0))
    made = ControlMap(controls, device=device)
    for k in range(6):
        changed = list(controls)
        changed[2 + 3 * k] = Repeller(tuple(rng.uniform(500.0, 8500.0, 2)), 700.0)
        if k == 3:
            changed.pop()
        assert made.covers(changed)
        made.update(changed)
        fresh = ControlMap(changed, device=device)
        assert fresh.raster.matches(made.raster)
        np.testing.assert_array_equal(made.raster.numpy(), fresh.raster.numpy())
        np.testing.assert_array_equal(made.factor.numpy(), fresh.factor.numpy())
        controls = changed


def test_a_painted_stroke_is_stamped_where_it_was_painted(device):
    field = ControlField.blank((0.0, 0.0, 4000.0, 4000.0), 20.0, device=device)
    made = ControlMap([field, Attractor((2000.0, 2000.0), 900.0)], device=device)
    before = made.raster.numpy()
    field.paint((1000.0, 1000.0), 300.0, 40.0)
    made.update(made.controls, [(700.0, 700.0, 1300.0, 1300.0)])
    np.testing.assert_array_equal(made.raster.numpy(), ControlMap(made.controls, device=device).raster.numpy())
    rows, columns = np.nonzero(before != made.raster.numpy())
    assert len(rows) and np.ptp(rows) <= 31 and np.ptp(columns) <= 31


def test_what_lies_beyond_a_map_is_not_covered(device):
    made = ControlMap([Attractor((0.0, 0.0), 1000.0)], device=device)
    assert made.covers([Attractor((100.0, 0.0), 900.0)]) is False, "it asks for smaller cells"
    assert made.covers([Attractor((10.0, 0.0), 1000.0)]) is False and made.covers([])
    assert made.covers([Repeller((0.0, 0.0), 1000.0, 3.0)])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Attractor((0.0, math.nan)), "Attractor.center"),
        (lambda: Attractor((0.0, 0.0), -1.0), "Attractor.radius is -1"),
        (lambda: Repeller((0.0, 0.0), 10.0, math.inf), "Repeller.strength is inf"),
        (lambda: Guide([(0.0, 0.0)], 10.0), "Guide.xy has 1 points; give 2 to"),
        (lambda: ControlField(np.zeros((3, 3))), "cell_size is missing"),
        (lambda: ControlField(Raster(np.zeros((3, 3)), 1.0), 2.0), "cell_size is given beside a Raster"),
        (lambda: ControlField.blank((0.0, 0.0, -1.0, 5.0), 1.0), "give \\(west, south, east, north\\)"),
        (lambda: DampingRegion([(0, 0), (1, 1)]), "DampingRegion.area has 2 points; give 3 to"),
        (lambda: DampingRegion([(0, 0), (1, 1), (0, 1)], 1.5), "DampingRegion.factor is 1.5; the range is 0 to 1"),
        (lambda: DampingRegion(Raster(np.full((3, 3), 2.0), 1.0)), "has the factor 2 at row 0, column 0"),
        (lambda: DampingRegion(Raster(np.ones((3, 3)), 1.0), 0.5), "takes no factor and no blend beside a Raster"),
        (lambda: ErodibilityField([(0, 0), (1, 1), (0, 1)]), "ErodibilityField.factor is missing"),
        (
            lambda: ErodibilityField([(0, 0), (1, 1), (0, 1)], -1.0),
            "ErodibilityField.factor is -1; give a finite",
        ),
        (lambda: ControlMap([]), "controls is empty"),
        (lambda: ControlMap(["here"]), "controls holds a str; give Attractor"),
        (lambda: ControlMap([Attractor((0, 0), 10.0), Attractor((1e6, 1e6), 10.0)]), "leave out what lies far off"),
        (
            lambda: ControlMap([ControlField(np.zeros((3, 3)), 1.0, crs="EPSG:32619")], crs="EPSG:32618"),
            "has the CRS EPSG:32619, the network EPSG:32618",
        ),
    ],
)
def test_bad_controls_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()
