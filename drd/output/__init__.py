"""The daemon's outputs and queries over Zenoh."""
