"""Riverscape: courses, bed and water of the rivers on a terrain, to be looked at from any distance."""

from __future__ import annotations

__all__: list[str] = []
