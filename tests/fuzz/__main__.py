"""`python -m tests.fuzz --seeds 0:20000`: the attacks of one seed after the other; see docs/reliability.md."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from fuzz.runner import main

sys.exit(main(sys.argv[1:]))
