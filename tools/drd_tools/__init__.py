"""Tools around the daemon: emulated hardware, demonstrations and pictures. The robot does not need them."""
