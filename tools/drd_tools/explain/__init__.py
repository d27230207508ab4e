"""Error budget of the pose: its uncertainty by cause, and the most likely causes of an actual error."""
