"""Rasters in and out: GeoTIFF, ASCII grids, NumPy files, height maps and xarray."""
