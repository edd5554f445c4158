"""Lines in and out: text, GIS formats, their attributes and the topology that they tell."""
