"""Is the robot wired as the configuration says? Judged from samples; the running daemon does not load it."""
