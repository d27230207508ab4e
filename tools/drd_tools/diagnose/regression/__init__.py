"""The regression of a whitened recording: it fits the parameters of given effects, and the sizes of the noise."""
