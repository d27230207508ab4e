"""The next drive: find by simulation which manoeuvres settle the open questions."""
