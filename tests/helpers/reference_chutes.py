"""Float64 NumPy twin of the search for bends that chutes may cut."""

import numpy as np


def bends_to_cut(xy, spacing, width, winding, longest, min_arc):
    """First and last point of each bend of a line that may be cut, as {first: last}."""
    apart = max(int(width / spacing + 0.5), 1)
    last = len(xy) - 1
    index = np.arange(len(xy))
    a = xy - xy[np.maximum(index - apart, 0)]
    b = xy[np.minimum(index + apart, last)] - xy
    turn = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    changes = np.flatnonzero(turn[1:] * turn[:-1] <= 0.0) + 1
    found = {}
    for i in changes[(changes >= apart) & (changes < last - apart) & (turn[changes] != 0.0)].tolist():
        following = np.flatnonzero(turn[i + 1 :] * turn[i] <= 0.0)
        j = i + 1 + int(following[0]) if len(following) else last
        chord = np.hypot(*(xy[j] - xy[i]))
        arc = (j - i) * spacing
        if j < last - apart and chord <= longest * width and arc >= winding * chord and arc > min_arc * width:
            found[i] = j
    return found
