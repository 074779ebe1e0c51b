"""Text from outside, made fit for a terminal."""

from __future__ import annotations

import unicodedata

HIDDEN = ("Cc", "Cf", "Zl", "Zp")  # Unicode's categories: controls, formats such as right-to-left, line separators


def plain(value: object) -> str:
    """Text from outside on one line, as it may go to a terminal: control characters and broken letters are spelt out.

    Names of files, keys of TOML files and answers of servers can hold sequences that move the cursor or do worse.
    """
    text = str(value).encode("utf-8", errors="backslashreplace").decode("utf-8")
    hidden = {letter for letter in text if unicodedata.category(letter) in HIDDEN}
    return text.translate({ord(letter): letter.encode("unicode_escape").decode() for letter in hidden})
