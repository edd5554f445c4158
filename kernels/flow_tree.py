"""Numbers that the kernels of water and the host agree on: kinds of primitives, codes of programs, tables of noise."""

# Kinds of primitives; a kind from OWN on is a user's.
CALM, RIPPLE, TURBULENT, WAVE, CASCADE, VORTEX, ECHO, OWN = range(8)
# Codes of a cell's program, besides the numbers of primitives: a leaf is added to the sums at the top of the stack.
OPEN, MERGE, REPLACE = -1, -2, -3
# Sums that a program can set aside at a time.
STACK = 16
# Noise: wavelengths of the first octave in a period, texels of a period, and the tables (smooth, lively, ridged).
PERIOD, TEXELS, TABLES = 8, 256, 3
SMOOTH, LIVELY, RIDGED = range(TABLES)
OCTAVES = (3, 4, 4)
PERSISTENCE = (0.3, 0.42, 0.45)
# Mean of (1 - |n|)^2 over gradient noise n in [-1, 1]. Turbulent water has ridges in its longest octaves, beside waves.
RIDGE_MEAN, RIDGED_OCTAVES = 0.5771, 2
RIDGE_SHARE, WAVE_SHARE = 0.6, 0.55
# A primitive ends where 1 - r^2 is this small: its weight is 1e-12 there, and squares of weights are still numbers.
EDGE = 1.0e-4
# Direction, in a table of noise, that water drifts in: the golden ratio's, along which a torus is long without repeat.
DRIFT = (0.8506508083520400, 0.5257311121191336)
# Share of a cascade's amplitude in the calm water above it, and how strongly crests carry the foam.
UPSTREAM, CREST = 0.25, 1.5
