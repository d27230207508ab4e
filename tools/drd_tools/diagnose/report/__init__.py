"""Pictures, tables and sentences of a diagnosis, from its files."""
