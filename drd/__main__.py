"""`python -m drd` is the command `drd`."""

from drd.cli import main

raise SystemExit(main())
