"""A whole drive at once: arrays of what the sensors read in, arrays of poses out."""
