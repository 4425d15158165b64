"""What a user can get wrong, said in one sentence: the file, the field and what would work."""


class ShmooError(Exception):
    """Bad input from a user: a map, scenario, checkpoint, data set or option.

    The command line prints the message as it is and exits with code 2, without a traceback.
    The message names the file (or option), the field, and the remedy, in one sentence.
    """
