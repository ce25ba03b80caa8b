"""The one error class that users are meant to see."""


class MistrayError(ValueError):
    """Bad input or a missing part; the message names the object, the value and the remedy in one line.

    The command line prints it without a traceback and exits with code 2.
    """
