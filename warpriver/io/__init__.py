"""Files in and out; the modules that a format needs are imported when it is used."""

from warpriver.io.vector.networks import line_formats, read_network, write_network

__all__ = ["line_formats", "read_network", "write_network"]
