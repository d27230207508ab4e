"""`drd web`: the pose in a browser, and metrics for Prometheus; a Zenoh client beside the daemon.

Data flows one way: `daemon` (Zenoh's threads) -> `state` (what is known) -> `server` (ten times a second) -> `hub` (the
browsers) and `metrics`. `guard` decides who may ask. `page/` is the page: HTML, CSS and JavaScript, served as they are.
"""
