"""What Bifrost raises. Every text is one line for a person: the thing, and what was expected."""

from __future__ import annotations

import builtins


class Error(Exception):
    """Base of every error that Bifrost raises on purpose."""


class ConfigurationError(Error):
    """The network file or the keys are missing or wrong: names file, key and what was expected."""


class TimeoutError(Error, builtins.TimeoutError):
    """No answer within the time allowed."""


class NoServerError(Error):
    """Nobody serves the topic."""


class SchemaError(Error):
    """Two nodes use one topic with different types: names both."""


class RemoteError(Error):
    """The server refused the request or its handler raised: carries its text."""
