"""Riverscapes: Rosgen types, courses, beds and water of rivers on a terrain that is too coarse to show them.

It makes what a map of heights leaves out plausible, at any scale, by the type of each river [Peytavie2019]. It is not a
hydraulic model: depths and speeds are those of uniform flow in a section of the type.
"""

from warpriver.riverscape.courses import Basins, Courses, Falls, Rocks

__all__ = ["Basins", "Courses", "Falls", "Rocks"]
