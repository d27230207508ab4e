"""The whitened recording as a regression: the parameters of given effects, and the sizes of the noise, are fitted."""
