"""Errors of this package. Every text is one line."""

from valor.common.errors import ValorError


class SignalError(ValorError):
    """A signal has too few samples, or two signals overlap too little."""


class DissimilarSignalsError(SignalError):
    """Two signals too different to determine a delay; states why."""


class ResultError(ValorError):
    """A saved result is missing or malformed, or a report cannot be written; names the file."""
