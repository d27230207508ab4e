"""A trial bench: how often the diagnosis is right, on recordings whose answer is known."""
