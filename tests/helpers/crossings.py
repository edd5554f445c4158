"""Where lines cross themselves, exactly but for the rounding of one product."""

import numpy as np
from scipy.spatial import cKDTree


def crossings(xy):
    """Pairs of segments of a line that cross in their insides, (k, 2), the earlier one first; touching does not count.

    Two segments that cross have middles no farther apart than the longest of all is long.
    """
    a, b = xy[:-1], xy[1:]
    longest = np.hypot(*(b - a).T).max(initial=0.0)
    # A little farther, against the rounding of distances.
    pair = cKDTree(0.5 * (a + b)).query_pairs(longest * (1.0 + 1e-9), output_type="ndarray")
    pair = np.sort(pair[abs(pair[:, 0] - pair[:, 1]) > 1], axis=1)

    def side(p, q, r):
        return (q[:, 0] - p[:, 0]) * (r[:, 1] - p[:, 1]) - (q[:, 1] - p[:, 1]) * (r[:, 0] - p[:, 0])

    i, j = pair.T
    apart = side(a[i], b[i], a[j]) * side(a[i], b[i], b[j]) < 0.0
    return pair[apart & (side(a[j], b[j], a[i]) * side(a[j], b[j], b[i]) < 0.0)]


def crosses_itself(xy):
    """Whether a line crosses itself anywhere."""
    return len(xy) > 3 and len(crossings(xy)) > 0
