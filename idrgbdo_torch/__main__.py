"""The command idrgbdo, also as `python -m idrgbdo_torch`: a Ctrl-C ends it in one line from the first moment on."""

from __future__ import annotations

import os
import signal
import sys
from types import FrameType


def main() -> int:
    """Load the command and run it. Until it runs, and after it, there is nothing that Ctrl-C could tear."""
    signal.signal(signal.SIGINT, _quit)
    from .commands.cli import main as command

    try:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        return command()
    except KeyboardInterrupt:  # between two lines of the command's own care
        return _quit()
    finally:
        signal.signal(signal.SIGINT, _quit)


def _quit(number: int = signal.SIGINT, frame: FrameType | None = None) -> int:
    os.write(2, b"interrupted\n")
    os._exit(128 + signal.SIGINT)


if __name__ == "__main__":
    sys.exit(main())
