"""A fleet: the results of thousands of recordings, kept as tables, and their statistics."""
