"""Lines and terrains from nothing."""

from warpriver.generate.curves import kinoshita, noisy_line, sine_generated, straight_line, valley_line

__all__ = ["kinoshita", "noisy_line", "sine_generated", "straight_line", "valley_line"]
