"""Every default of every parameter class, written out: whoever changes one has to change it here as well, on purpose.

A changed default changes what runs without that parameter compute. Say so in CHANGELOG.md.
"""

import dataclasses
import importlib
import inspect
import pkgutil

import pytest

import warpriver

# Class -> field -> (default, unit); no unit where the field is not one constant. In the order of the constructor.
DEFAULTS = {
    "MeanderParams": {
        "time_step": (0.29021218343600275, "yr"),
        "spacing": (50.0, "m"),
        "spacing_in_widths": (1.0, "widths"),
        "migration_rate": (60.0, "m/yr"),
        "reference_width": (None, "m"),
        "friction": (None, "-"),
        "memory_length": (None, "widths"),
        "curvature_saturation": (0.4, "-"),
        "local_weight": (-1.0, "-"),
        "upstream_weight": (2.5, "-"),
        "upstream_memory": ("stem", "-"),
        "inlet": ("edge", "-"),
        "inlet_wavelength": (15.0, "widths"),
        "inlet_curvature": (0.1, "-"),
        "sinuosity_scaling": ("whole", "-"),
        "cutoff_distance": (2.0, "widths"),
        "cutoff_min_arc": (5.0, "widths"),
        "ring_policy": ("longer", "-"),
        "max_rings": (1000, "-"),
        "end_damping": (5.0, "widths"),
        "taubin_passes": (0, "-"),
        "slope_threshold": (0.15, "m/m"),
        "collision_distance": (1.0, "mean widths"),
        "junction_reach": (10.0, "widths"),
        "junction_drift": (0.2, "-"),
        "bank_spread": (0.7, "-"),
        "bank_correlation": (4.0, "widths"),
        "control_steering": ("normal", "-"),
        "control_floor": (0.02, "-"),
        "junctions": ("JunctionParams()", "-"),
        "avulsions": (None, "-"),
        "floodplain": (None, "-"),
        "chutes": (None, "-"),
        "widths": (None, "-"),
    },
    "WidthParams": {"lag": (0.3, "-"), "time": (10.0, "yr"), "widest": (2.0, "-")},
    "ChuteParams": {"rate": (0.002, "1/yr"), "winding": (1.5, "-"), "longest": (8.0, "widths")},
    "FloodplainParams": {
        "plug_factor": (0.3, "-"),
        "plug_time": (1000.0, "yr"),
        "bar_factor": (1.5, "-"),
        "bar_time": (20.0, "yr"),
        "unrest": (1.0, "-"),
        "unrest_time": (5.0, "yr"),
        "unrest_reach": (10.0, "widths"),
    },
    "AvulsionParams": {
        "crevasse_rule": ("bend", "-"),
        "crevasse_curvature": (0.1, "-"),
        "crevasse_rate": (0.002, "1/(km yr)"),
        "crevasse_probability": (0.05, "-"),
        "avulsion_probability": (0.05, "-"),
        "first_angle": (45.0, "deg"),
        "jitter": (5.0, "deg"),
        "steepest_rise": (0.05, "m/m"),
        "fall": (0.0001, "m/m"),
        "deepest_cut": (2.0, "depths"),
        "nearest": (10.0, "widths"),
        "farthest": (100.0, "widths"),
        "meeting": ("refuse", "-"),
        "regional": (0.0, "-"),
    },
    "Attractor": {"center": (None, None), "radius": (1000.0, "m"), "strength": (1.0, "-")},
    "Repeller": {"center": (None, None), "radius": (1000.0, "m"), "strength": (1.0, "-")},
    "Guide": {"xy": (None, None), "radius": (1000.0, "m"), "strength": (1.0, "-")},
    "PathMeander": {
        "time_step": (0.29021218343600275, "yr"),
        "spacing": (50.0, "m"),
        "spacing_in_widths": (1.0, "widths"),
        "displacement_rate": (60.0, "m/yr"),
        "downstream_share": (0.9, "-"),
        "blur_length": (1.5, "widths"),
        "smoothing": (0.35, "-"),
        "search_radius": (1.5, "widths"),
        "cone_angle": (45.0, "deg"),
        "cutoff_min_arc": (5.0, "widths"),
        "ring_policy": ("longer", "-"),
        "max_rings": (1000, "-"),
        "end_damping": (5.0, "widths"),
        "taubin_passes": (0, "-"),
        "slope_threshold": (0.15, "m/m"),
        "collision_distance": (1.0, "mean widths"),
        "junction_reach": (10.0, "widths"),
        "junction_drift": (0.0, "-"),
        "control_steering": ("normal", "-"),
        "control_floor": (0.02, "-"),
        "junctions": ("JunctionParams()", "-"),
        "avulsions": (None, "-"),
    },
    "CarveParams": {
        "section": ("parabola", "-"),
        "side_fraction": (0.2, "-"),
        "bank_reach": (1.0, "widths"),
        "repose_angle": (35.0, "deg"),
        "max_cut": (60.0, "m"),
        "fill_fraction": (0.0, "-"),
        "smoothing": (6.0, "widths"),
        "junctions": (True, None),
        "lake_time": (50.0, "yr"),
        "plug_length": (2.0, "widths"),
    },
    "JunctionParams": {
        "narrow_angle": (28.0, "deg"),
        "wide_angle": (95.0, "deg"),
        "exponent": (1.5, "-"),
        "reach": (6.0, "mean widths"),
        "ease": (1.0, "-"),
        "deferred": (0.0, "-"),
    },
    "SeedingParams": {
        "calm_froude": (0.2, "-"),
        "ripple_froude": (0.45, "-"),
        "liveliness": (1.0, "-"),
        "wind": (0.003, "m"),
        "foam_reach": (8.0, "falls"),
        "rough_reach": (6.0, "falls"),
    },
    "LehenyParams": {
        "flow_bias": (0.05, "1/m"),
        "depth": (10.0, "m"),
        "slide_threshold": (2000.0, "m"),
        "neighbors": (8, "-"),
    },
    "LandscapeParams": {
        "moisture_rate": (0.02, "1/yr"),
        "sediment_rate": (0.05, "m/yr"),
        "lake_time": (50.0, "yr"),
        "plug_length": (2.0, "widths"),
        "cover_time": (20.0, "yr"),
        "dry_cover": (0.12, "-"),
        "bar_time": (15.0, "yr"),
        "bar_depth": (0.4, "depths"),
        "scroll_period": (8.0, "yr"),
        "scroll_height": (0.12, "depths"),
        "lobe_length": (6.0, "widths"),
        "lobe_height": (0.25, "depths"),
    },
    "ValleyParams": {
        "name": ("valley", None),
        "length": (420.0, "m"),
        "slope": (0.002, "m/m"),
        "valley_slope": (None, None),
        "width": (30.0, "m"),
        "depth": (None, None),
        "grain_size": (0.064, "m"),
        "shields": (0.04, "-"),
        "submerged_gravity": (1.65, "-"),
        "floor_width": (25.0, "m"),
        "top_width": (25.0, "m"),
        "floor_height": (0.0, "m"),
        "top_height": (0.0, "m"),
        "terraces": (0, "-"),
        "datum": (1000.0, "m"),
        "increments": (784, "-"),
        "bank_window": (None, None),
        "floor_window": (None, None),
        "stationing": ("channel", "-"),
        "fall": ("valley", "-"),
        "curvature_limit": (1.2, "-"),
        "sharp_bends": ("error", "-"),
        "controls": ({}, None),
        "section": ("CrossSection()", None),
        "line": (None, None),
        "covariance": (None, None),
        "profile": ("LongProfile()", None),
        "threads": ((), None),
        "objects": ((), None),
        "patches": ((), None),
        "stamps": ((), None),
    },
    "RosgenParams": {
        "ratio_tolerance": (0.2, "-"),
        "width_tolerance": (2.0, "-"),
        "slope_tolerance": (0.1, "-"),
        "greatest_depth": (1.5, "-"),
        "braiding_coefficient": (0.0125, "-"),
        "braiding_exponent": (0.44, "-"),
        "braiding_flow": (2.0, "m3/s"),
        "anastomosing_order": (4, "-"),
        "shortest": (10.0, "widths"),
    },
    "FlowParams": {
        "roughness_floor": (0.03, "-"),
        "steepest": (0.1, "m/m"),
        "gentlest": (0.0001, "m/m"),
        "froude": (1.0, "-"),
    },
    "TrajectoryParams": {
        "wavelength": (11.0, "widths"),
        "variation": (0.25, "-"),
        "shown_cells": (8.0, "cells"),
        "braid_belt": (2.2, "-"),
        "anastomosing_belt": (4.0, "-"),
        "most_threads": (7, "-"),
        "least_threads": (3, "-"),
    },
    "ProfileParams": {
        "mix": (1.0, "-"),
        "freeboard": (0.25, "mean depths"),
        "smoothing": (10.0, "widths"),
        "grade": (3.0, "-"),
        "steepening": (0.3, "m/m"),
        "step_coefficient": (8.25, "widths"),
        "step_exponent": (0.98, "-"),
        "closest": (1.0, "widths"),
        "widest": (7.0, "widths"),
        "jitter": (0.3, "-"),
        "face": (0.6, "m/m"),
        "cascade_slope": (0.15, "m/m"),
        "waterfall": (1.5, "m"),
    },
    "BedParams": {
        "farthest": (4.0, "widths"),
        "bars": (0.5, "mean depths"),
        "basin_depth": (0.6, "mean depths"),
        "unevenness": (0.1, "-"),
        "pool_width": (0.16, "-"),
        "change": (3.0, "widths"),
    },
    "LongProfile": {"form": ("linear", "-"), "slope_ratio": (10.0, "-"), "exponent": (0.5, "-")},
    "RoughnessPatch": {
        "polygon": (None, None),
        "deviation": (0.1, "m"),
        "wavelength": (5.0, "m"),
        "octaves": (4, "-"),
        "roughness": (0.5, "-"),
        "blend": (1.0, "m"),
        "seed": (0, "-"),
    },
    "MeshStamp": {
        "vertices": (None, None),
        "triangles": (None, None),
        "place": ((0.0, 0.0), None),
        "name": ("mesh", None),
        "base": ("ground", "-"),
        "angle": (0.0, "deg"),
        "scale": (1.0, "m"),
        "mode": ("raise", "-"),
    },
    "Variogram": {
        "amplitude": (1.0, "-"),
        "correlation": (0.1, "reach"),
        "model": ("exponential", "-"),
        "nugget": (0.0, "-"),
        "positions": ((), None),
        "values": ((), None),
        "random": (True, None),
        "samples": (784, "-"),
        "seed": (0, "-"),
    },
    "CrossSection": {
        "form": ("asymmetric", "-"),
        "flat": (0.5, "-"),
        "exponent": (2.0, "-"),
        "threads": (((0.0, 0.25, 2.0, 1.0), (0.5, 0.25, 2.0, 0.7)), None),
    },
    "Thread": {
        "start": (0.2, "reach"),
        "end": (0.8, "reach"),
        "offset": (50.0, "m"),
        "width": (0.6, "-"),
        "depth": (0.8, "-"),
    },
    "ObjectField": {
        "kind": ("boulder", "-"),
        "where": ("channel", "-"),
        "density": (0.01, "1/m2"),
        "smallest": (0.3, "m"),
        "largest": (1.5, "m"),
        "height": (1.0, "radii"),
        "length": (8.0, "m"),
        "seed": (0, "-"),
    },
    "CovarianceTarget": {
        "partner": ("width", "-"),
        "mean": (None, None),
        "frequencies": ((1.0,), None),
        "by_frequency": (None, None),
        "amplitude": (0.25, "depths"),
    },
    "Autoregressive": {
        "amplitude": (1.0, "-"),
        "frequency": (1.0, "cycles a reach"),
        "damping": (0.3, "-"),
        "samples": (784, "-"),
        "seed": (0, "-"),
    },
    "Cnoidal": {
        "amplitude": (1.0, "-"),
        "frequency": (1.0, "cycles a reach"),
        "phase": (0.0, "rad"),
        "modulus": (0.9, "-"),
    },
    "GradientNoise": {
        "amplitude": (1.0, "-"),
        "frequency": (4.0, "steps a reach"),
        "octaves": (1, "-"),
        "roughness": (0.5, "-"),
        "seed": (0, "-"),
    },
    "Harmonic": {
        "amplitude": (1.0, "-"),
        "frequency": (1.0, "cycles a reach"),
        "phase": (0.0, "rad"),
        "wave": ("sin", "-"),
    },
    "Kinoshita": {
        "amplitude": (1.0, "-"),
        "frequency": (1.0, "cycles a reach"),
        "phase": (0.0, "rad"),
        "angle": (1.9, "rad"),
        "skewness": (0.03125, "-"),
        "flatness": (0.005208333333333333, "-"),
    },
    "Series": {
        "values": ((0.0, 0.0), None),
        "positions": (None, None),
        "amplitude": (1.0, "-"),
        "relative": (False, None),
        "harmonics": (0, "-"),
    },
    "SineGenerated": {
        "amplitude": (1.0, "-"),
        "frequency": (1.0, "cycles a reach"),
        "phase": (0.0, "rad"),
        "angle": (1.9, "rad"),
    },
    "Spectral": {
        "amplitude": (1.0, "-"),
        "exponent": (1.0, "-"),
        "lowest": (1, "cycles a reach"),
        "highest": (64, "cycles a reach"),
        "seed": (0, "-"),
    },
    "Spline": {
        "positions": ((0.0, 1.0), None),
        "values": ((0.0, 0.0), None),
        "interpolation": ("cubic", "-"),
    },
    "Steps": {
        "positions": ((0.5,), None),
        "levels": ((0.0, -1.0), None),
        "riser": (0.01, "reach"),
    },
}


def parameter_classes():
    """Every dataclass that declares a constant with a unit, by its name, from all modules of the package."""
    found = {}
    for module in pkgutil.walk_packages(warpriver.__path__, "warpriver."):
        if module.name.endswith("__main__"):
            continue
        for name, kind in inspect.getmembers(importlib.import_module(module.name), inspect.isclass):
            if kind.__module__ != module.name or not dataclasses.is_dataclass(kind):
                continue
            if any({"unit", "source"} <= field.metadata.keys() for field in dataclasses.fields(kind)):
                assert name not in found, f"{module.name} and {found[name].__module__} both have a {name}"
                found[name] = kind
    return found


def default_of(field):
    """The default of a field; of one that is a parameter class itself, its name and brackets; None without one."""
    if field.default is field.default_factory:
        return None  # both missing: it must be given
    value = field.default if field.default is not dataclasses.MISSING else field.default_factory()
    if dataclasses.is_dataclass(value):
        assert value == type(value)(), f"{field.name} is not the default {type(value).__name__}"
        return f"{type(value).__name__}()"
    return value


def test_every_parameter_class_is_listed():
    assert set(parameter_classes()) == set(DEFAULTS)


@pytest.mark.parametrize("name", DEFAULTS)
def test_defaults_and_units_are_these(name):
    fields = dataclasses.fields(parameter_classes()[name])
    found = {field.name: (default_of(field), field.metadata.get("unit")) for field in fields}
    # By their texts: a default of 0 and one of 0.0 are different, since the first takes whole numbers only.
    assert {key: repr(value) for key, value in found.items()} == {
        key: repr(value) for key, value in DEFAULTS[name].items()
    }
    assert list(found) == list(DEFAULTS[name]), "positional arguments changed their places"
