"""Units of length as files spell them."""

from __future__ import annotations

import re

__all__ = ["is_degrees", "metres_in", "names_a_unit"]

US_FOOT = 1200.0 / 3937.0  # m

# Metres in a unit by its names: lower case, words parted by single spaces.
UNITS = {
    1.0: "m, metre, metres, meter, meters, mtr, masl, mamsl, metros",
    1e3: "km, kilometre, kilometres, kilometer, kilometers",
    0.1: "dm, decimetre, decimetres, decimeter, decimeters",
    0.01: "cm, centimetre, centimetres, centimeter, centimeters",
    0.001: "mm, millimetre, millimetres, millimeter, millimeters",
    0.3048: "ft, foot, feet, ift, intl foot, intl ft, international foot, international feet, foot international",
    US_FOOT: "us survey foot, us survey feet, survey foot, survey feet, us foot, us feet, us ft, usft, ftus, ft us, "
    "foot us, feet us, sft, us survey ft, foot us survey, u s foot, u s survey foot, u s ft, u s survey feet",
    0.9144: "yd, yard, yards",
    1.8288: "fathom, fathoms, fath, fm",
    1609.344: "mi, mile, miles",
    1852.0: "nmi, nautical mile, nautical miles",
}
METRES = {name: factor for factor, names in UNITS.items() for name in names.split(", ")}
# What stands for no unit at all.
NONE = {
    "",
    "1",
    "unknown",
    "none",
    "n / a",
    "n a",
    "na",
    "nan",
    "null",
    "undefined",
    "unitless",
    "dimensionless",
    "other",
    "-",
}


def _words(unit: str) -> str:
    """Return a unit in lower case, its words parted by single spaces; signs of rates and powers are words."""
    plain = re.sub(r"[_\-.,;:()\[\]]+", " ", unit.lower().replace("'", " "))
    return " ".join(re.sub(r"([/*^%])", r" \1 ", plain).split())


def names_a_unit(unit: str | None) -> bool:
    """Tell whether a text says of which unit something is."""
    return unit is not None and _words(unit) not in NONE


def is_degrees(unit: str) -> bool:
    """Tell whether a unit is that of longitude and latitude: degrees_east, degree, deg ..."""
    return re.match(r"deg(ree)?s?\b", _words(unit)) is not None


def metres_in(unit: str) -> float | None:
    """Return how many metres a unit of length is, None for one that is not known, a rate or an area.

    Words around the unit do not count, as those of "metres above mean sea level" or "Elevation [m]".
    """
    text = _words(unit)
    if text in METRES:
        return METRES[text]
    words = text.split()
    if any(re.search(r"[/*^%0-9]|^per$", word) and not re.match(r"(egm|navd|wgs|ngvd|nad)", word) for word in words):
        return None
    found: set[float] = set()
    first = 0
    while first < len(words):
        for count in (4, 3, 2, 1):
            phrase = " ".join(words[first : first + count])
            if phrase in METRES:
                found.add(METRES[phrase])
                first += count - 1
                break
        first += 1
    return found.pop() if len(found) == 1 else None
