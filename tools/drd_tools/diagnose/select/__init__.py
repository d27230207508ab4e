"""Selection of effects from the catalogue, and of unnamed smooth curves that compete with them."""
