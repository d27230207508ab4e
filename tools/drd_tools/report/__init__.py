"""Pictures and HTML pages, drawn from results that were computed elsewhere."""
