"""Text from outside, made fit for a terminal."""

from __future__ import annotations

MOST_SHOWN = 200  # letters of a value from outside in a message


def plain(value: object) -> str:
    """Text from outside on one line, as it may go to a terminal: what cannot be printed is spelt out.

    Names of files, keys of TOML files and answers of servers can hold sequences that move the cursor, turn the reading
    direction or are no letters at all.
    """
    text = str(value).encode("utf-8", errors="backslashreplace").decode("utf-8")
    hidden = {letter for letter in text if not letter.isprintable()}
    return text.translate({ord(letter): letter.encode("unicode_escape").decode() for letter in hidden})


def shown(value: object, quoted: bool = True) -> str:
    """A value for a message, as Python writes it (quoted) or reads it, cut where it is long."""
    try:
        text = repr(value) if quoted else str(value)
    except (ValueError, RecursionError):  # an integer of thousands of digits, lists in lists in lists
        return f"something long ({type(value).__name__})"
    return text if len(text) <= MOST_SHOWN else f"{text[:MOST_SHOWN]}... ({len(text)} letters)"
