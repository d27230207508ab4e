"""A recording as steps of time: what each sensor says of each step, and the events that need no regression."""
