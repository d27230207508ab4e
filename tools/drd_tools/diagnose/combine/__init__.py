"""Combined estimates from several recordings of one robot, and effects that only their joint regression shows."""
