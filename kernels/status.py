"""What a batch of sub-steps tells the host: the places of one small block of integers on the device."""

# How a batch of sub-steps goes: why the one at hand cannot be committed (0: it can), not 0 where those to come must
# leave all as it is (TOUCH: channels have come to touch), the sub-steps done, the cutoffs in them and their points, the
# whole steps done and their goal, the sub-steps of the step at hand, the points of the network after the last one, and
# the places where channels touch.
FAULT, HALT, DONE, CUTS, CUT_POINTS, STEPS, GOAL, SUBSTEPS, POINTS, CONTACTS = range(10)
# What the sub-step at hand needs: capacity for points, cutoffs, their points and shortcuts, also where it is too small.
POINTS_NEEDED, CUTS_NEEDED, CUT_POINTS_NEEDED, LINKS_NEEDED = range(10, 14)
# Whole steps done before the batch, and crevasses at the end of the last one in it.
BEGUN, CREVASSES = 14, 15
STATUS_SIZE = 16
TOUCH = 2
# What may be wrong with a sub-step.
FAULT_NONE, FAULT_NOT_FINITE, FAULT_OXBOWS_FULL, FAULT_SHORTCUTS_FULL, FAULT_POINTS_FULL = 0, 1, 2, 3, 4
# The sub-step at hand: its number within the step, how many there are, and 1 where that is settled.
NUMBER, TOTAL, PLANNED, SUBSTEP_SIZE = 0, 1, 2, 3
