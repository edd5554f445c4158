"""Sets of constants to choose from, and the symbols under which papers write them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

from warpriver.params import AvulsionParams, MeanderParams

__all__ = ["PRESETS", "SHOWN", "Preset", "constants_shown"]


@dataclasses.dataclass(frozen=True)
class Preset:
    """A set of constants.

    Attributes:
        title: Its name on the page.
        doc: What it is for.
        params: Makes the constants.
    """

    title: str
    doc: str
    params: Callable[[], MeanderParams]


PRESETS = {
    "default": Preset(
        "Measured rivers", "The defaults: planforms have the statistics of measured rivers.", MeanderParams
    ),
    "paper": Preset(
        "Paris et al. (2023), Table 1",
        "k = 0.164 m/day, f = 0.011, Ω = -1, Γ = 2.5, steps of 106 days; the same rate for all channels.",
        MeanderParams.paper,
    ),
    "paper_events": Preset(
        "Paris et al. (2023) with events",
        "Table 1 with crevasses and avulsions as printed: t_c = 0.1, and 0.05 for both probabilities.",
        lambda: MeanderParams.paper(events=True),
    ),
    "avulsions": Preset(
        "Measured rivers that avulse",
        "The defaults with crevasses and avulsions, ten times as often as by default.",
        lambda: MeanderParams(avulsions=AvulsionParams(crevasse_rate=0.02)),
    ),
    "lowland": Preset(
        "Lowland",
        "Weak banks, and bends that feel the flow far upstream: fast, long bends and many oxbow lakes.",
        lambda: MeanderParams(migration_rate=110.0, memory_length=3.0, bank_spread=0.4),
    ),
    "torrents": Preset(
        "Mountain torrents",
        "Strong, uneven banks, and rivers that still move on slopes up to 0.3: slow, short bends.",
        lambda: MeanderParams(migration_rate=20.0, memory_length=1.5, bank_spread=0.9, slope_threshold=0.3),
    ),
}
# As [Paris2023] and those that it follows write them.
SYMBOLS = {
    "time_step": "Δt", "migration_rate": "k", "friction": "f", "local_weight": "Ω", "upstream_weight": "Γ",
    "memory_length": "L", "curvature_saturation": "c₀", "slope_threshold": "s₀", "bank_spread": "s",
    "cutoff_distance": "d_c",
}  # fmt: skip
# Constants that pages show and set.
SHOWN = (
    "migration_rate", "memory_length", "friction", "curvature_saturation", "bank_spread", "local_weight",
    "upstream_weight", "sinuosity_scaling", "cutoff_distance", "collision_distance", "slope_threshold", "end_damping",
    "spacing_in_widths", "time_step",
)  # fmt: skip


def constants_shown() -> list[dict[str, Any]]:
    """What the shown constants are: name, unit, default, meaning."""
    fields = {field.name: field for field in dataclasses.fields(MeanderParams)}
    return [
        {
            "name": name, "symbol": SYMBOLS.get(name, ""), "unit": fields[name].metadata.get("unit", ""),
            "doc": fields[name].metadata.get("doc", ""),
            "default": fields[name].default, "choices": list(fields[name].metadata.get("choices") or []),
        }
        for name in SHOWN if name in fields
    ]  # fmt: skip
