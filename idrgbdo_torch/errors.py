"""The one root of every error that a user can cause; its message is one line that says what to do."""


class IdRgbdoError(ValueError):
    """Wrong input: names the argument, what was expected, what came, and what to do about it."""
