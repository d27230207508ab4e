"""A search for drives and faults that make the published pose lie."""
