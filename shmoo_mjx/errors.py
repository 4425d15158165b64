"""The error type for wrong user input."""


class ShmooError(Exception):
    """Wrong user input: a map, scenario, checkpoint, data set or option.

    The message names the file (or option), the field and the remedy in one sentence. The command line prints the
    message without a traceback and exits with code 2.
    """
