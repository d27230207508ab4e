"""The error budget of the pose: how much of its uncertainty each cause brings, and what an actual error is due to."""
