"""What survives the daemon: the estimate in a file of the service's state directory.

A file is one line, `drd-state/VERSION sha256=DIGEST`, and the digested rest, JSON. It is replaced as a whole, so it is
that of one moment at any time. Files that cannot be used are kept beside it, as NAME.refused-1 and so on.
"""
