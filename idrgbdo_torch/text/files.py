"""Text as people's programs write it: how it is encoded."""

from __future__ import annotations

import codecs
from pathlib import Path


def read_text(path: Path) -> str:
    """The text of a file in UTF-8 or UTF-16 (as PowerShell's `>` writes), with or without a byte order mark.

    Raises OSError, or UnicodeDecodeError for bytes that are neither.
    """
    data = path.read_bytes()
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return data.decode("utf-16")
    for encoding, zeros in (("utf-16-le", data[1:400:2]), ("utf-16-be", data[:400:2])):
        if zeros and zeros.count(0) > 0.5 * len(zeros):  # digits and Latin letters have a byte 0 there
            return data.decode(encoding)
    return data.decode("utf-8-sig")
