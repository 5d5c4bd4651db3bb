"""Errors that carry one line for a person: file, key, what was expected."""


class ValorError(Exception):
    """Base of every error that the project raises on purpose. Its text is one line."""


class ConfigurationError(ValorError):
    """A file or a setting is missing or wrong: names the file, the key and what was expected."""
