"""What to drive next, so that the open questions are settled."""
