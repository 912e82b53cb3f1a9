"""Bad input, wherever it is found."""


class InputError(ValueError):
    """Input that cannot be used. The message names value, limit and remedy; a program prints it and exits with 2."""
