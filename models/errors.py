"""Bad input, wherever it is found."""


class InputError(ValueError):
    """Input that cannot be used. The message names the value, the limit and the remedy; a program prints it and exits with 2."""
