"""The law of migration alone, as it was printed, for closed forms, twins and figures that were measured with it."""

from warpriver import MeanderParams

# What the defaults add to the law, at the values that leave it out.
PLAIN = {
    "memory_length": 0.0,
    "curvature_saturation": 0.0,
    "inlet": "none",
    "sinuosity_scaling": "upstream",
    "cutoff_distance": 1.0,
    "bank_spread": 0.0,
}


def plain_params(**options):
    """The default constants without memory in widths, saturation, inlets and random banks, or with what is given."""
    return MeanderParams(**(PLAIN | options))
