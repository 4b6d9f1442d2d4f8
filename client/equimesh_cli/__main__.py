"""`python -m equimesh_cli` is the command `equimesh`."""

import sys

from equimesh_cli import main

sys.exit(main())
