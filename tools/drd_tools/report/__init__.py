"""Pictures and HTML pages of results computed elsewhere."""
