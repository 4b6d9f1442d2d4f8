"""`python -m generator` in the folder docs builds the site."""

import sys

from generator.command import main

sys.exit(main())
