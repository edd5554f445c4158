"""Styles in which QGIS shows the layers of a GeoPackage: its QML, of symbols whose width is that of the water.

Widths are data-defined, in metres on the map, and never less than what can be seen on the screen.
"""

from __future__ import annotations

from collections.abc import Mapping
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

__all__ = ["STYLES"]

# Colours as QGIS has them: red, green, blue, opacity.
WATER, LAKE, DRY, NODE = "61,126,166,255", "134,174,174,255", "185,138,102,255", "29,69,96,255"
# Minimum width of a line or point that stands for water, mm on the screen.
MINIMUM = 0.25


def _symbol(kind: str, properties: Mapping[str, str], defined: Mapping[str, str]) -> str:
    """Return the QML of a layer with one symbol.

    Args:
        kind: "line", "fill" or "marker".
        properties: Its properties, by the names of QGIS.
        defined: Expressions for properties that vary from feature to feature.
    """
    names = {"line": "SimpleLine", "fill": "SimpleFill", "marker": "SimpleMarker"}
    top = Element("qgis", version="3.22.0", styleCategories="Symbology")
    renderer = SubElement(top, "renderer-v2", type="singleSymbol", symbollevels="0", enableorderby="0")
    symbol = SubElement(
        SubElement(renderer, "symbols"), "symbol", type=kind, name="0", alpha="1", clip_to_extent="1", force_rhr="0"
    )
    layer = SubElement(symbol, "layer", {"class": names[kind], "enabled": "1", "locked": "0", "pass": "0"})
    for key, value in properties.items():
        SubElement(layer, "prop", k=key, v=value)
    if defined:
        held = SubElement(SubElement(layer, "data_defined_properties"), "Option", type="Map")
        SubElement(held, "Option", name="name", value="", type="QString")
        named = SubElement(held, "Option", name="properties", type="Map")
        for key, expression in defined.items():
            entry = SubElement(named, "Option", name=key, type="Map")
            SubElement(entry, "Option", name="active", value="true", type="bool")
            SubElement(entry, "Option", name="expression", value=expression, type="QString")
            SubElement(entry, "Option", name="type", value="3", type="int")
        SubElement(held, "Option", name="type", value="collection", type="QString")
    return "<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>\n" + ElementTree.tostring(top, "unicode")


def _line(color: str, style: str = "solid", defined: Mapping[str, str] | None = None) -> str:
    """Return a line as wide on the map as its attribute ``width_m`` says."""
    properties = {
        "line_color": color, "line_style": style, "line_width": "0.4", "line_width_unit": "MapUnit",
        "width_map_unit_scale": f"3x:0,0,1,{MINIMUM},0,0", "capstyle": "round", "joinstyle": "round",
    }  # fmt: skip
    return _symbol("line", properties, {"outlineWidth": '"width_m"', **(defined or {})})


def _points(size: str, unit: str, defined: Mapping[str, str]) -> str:
    """Return discs."""
    properties = {
        "name": "circle", "color": NODE, "outline_style": "no", "size": size, "size_unit": unit,
        "size_map_unit_scale": f"3x:0,0,1,{MINIMUM},0,0",
    }  # fmt: skip
    return _symbol("marker", properties, defined)


# By age: the oldest course has the colour of sand, the youngest that of water.
_BY_TIME = ", ".join(
    f'scale_linear("time_yr", minimum("time_yr"), maximum("time_yr"), {old}, {new})'
    for old, new in ((222, 61), (210, 126), (170, 166))
)
AGED = {"outlineColor": f"color_rgb({_BY_TIME})"}
STYLES: Mapping[str, str] = {
    "channels": _line(WATER),
    "courses": _line(WATER, defined=AGED),
    "abandoned": _line(DRY),
    "oxbows": _symbol("fill", {"color": LAKE, "outline_style": "no"}, {}),
    "nodes": _points("1.6", "MM", {}),
    "points": _points("1.0", "MapUnit", {"size": '"width_m"'}),
}
