"""Wheel radii and effective tread, from recordings with a reference or from UMBmark."""
