"""The next drive: which manoeuvre settles the open questions, by simulation."""
