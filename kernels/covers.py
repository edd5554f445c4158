"""What covers a cell of a landscape, and how far channels are felt: numbers that kernels and host share."""

# What covered a cell last: nothing, ground that a channel left as it moved, a loop that was cut off, a course that was
# given up, the channel.
NOTHING, BAR, OXBOW, ABANDONED, CHANNEL = range(5)
# How far a channel is felt, in widths, and how far its deposits reach; its bank.
FELT, SEDIMENT_REACH, BANK = 6.0, 4.0, 0.5
# Parts of a year that times are added up in.
QUANTA = 2.0**32
