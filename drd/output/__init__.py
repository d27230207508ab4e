"""What the daemon tells over Zenoh, and is asked."""
