"""Which effects of the catalogue are there, and which smooth curves without a name compete with them."""
