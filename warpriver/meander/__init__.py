"""What a meandering channel does in one step: migrate, cut off, be resampled."""
