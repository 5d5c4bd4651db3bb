"""What this package raises. Every text is one line."""

from valor.common.errors import ValorError


class SignalError(ValorError):
    """A signal has too few samples, or two have too little in common, for what is asked of them."""


class DissimilarSignalsError(SignalError):
    """Two signals from which no delay can be told; says why."""


class ResultError(ValorError):
    """An experiment's result is missing or broken: names the file."""
