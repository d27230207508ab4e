"""What several recordings of one robot say together."""
