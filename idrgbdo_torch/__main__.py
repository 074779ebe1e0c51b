"""`python -m idrgbdo_torch` is the command idrgbdo."""

import sys

from .commands.cli import main

sys.exit(main())
