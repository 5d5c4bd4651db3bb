"""Errors of Bifrost. Each text is one line for the user: object and expectation."""

import builtins


class Error(Exception):
    """Base of all errors that Bifrost raises on purpose."""


class ConfigurationError(Error):
    """The network file or the keys are missing or wrong; names file, key and expectation."""


class TimeoutError(Error, builtins.TimeoutError):
    """No reply within the timeout."""


class NoServerError(Error):
    """The service has no server."""


class SchemaError(Error):
    """Two nodes use one topic with different types; names both."""


class RemoteError(Error):
    """The server rejected the request, or its handler raised; contains its text."""
