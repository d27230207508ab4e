"""A fleet: what thousands of recordings say, kept as tables, and what follows from them."""
