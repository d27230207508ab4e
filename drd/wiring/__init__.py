"""Check from samples whether the robot is wired as configured; the running daemon does not load this."""
