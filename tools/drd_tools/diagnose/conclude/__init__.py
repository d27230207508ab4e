"""How sure each selected effect is, what else it may be, how large it is reported, and what was not seen."""
