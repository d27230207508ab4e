"""Conclusions on the selected effects: how sure each is, what else it may be, and its reported estimate."""
