"""`python -m idrgbdo_torch` is the command idrgbdo."""

import sys

from .cli import main

sys.exit(main())
