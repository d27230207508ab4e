"""The configuration: every key with its unit, limits and default; files, and their errors with file and line."""
