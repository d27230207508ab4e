"""The selection of effects from the catalogue, and of smooth curves without a name that compete with them."""
