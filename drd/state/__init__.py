"""State that survives the daemon: the estimate in a file of the service's state directory.

A file is one line, `drd-state/VERSION sha256=DIGEST`, and the digested rest, JSON. It is replaced as a whole, so it
always holds the state of one moment. Unusable files are kept beside it, as NAME.refused-1 and so on.
"""
