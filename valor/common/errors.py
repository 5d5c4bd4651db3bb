"""Errors that carry one line for a person: file, key, what was expected."""

from __future__ import annotations

from collections.abc import Iterable


class ValorError(Exception):
    """Base of every error that the project raises on purpose. Its text is one line; of several faults, one each."""


class ConfigurationError(ValorError):
    """A file or a setting is missing or wrong: names the file, the key and what was expected."""


class SeveralFaultsError(ConfigurationError):
    """Several things are missing or wrong: a line for each.

    Attributes:
        faults: one error each.
        unchecked: what could not be looked at because of them, a line each.
    """

    def __init__(self, faults: Iterable[ConfigurationError], unchecked: Iterable[str] = ()) -> None:
        self.faults = tuple(faults)
        self.unchecked = tuple(unchecked)
        super().__init__("\n".join([*map(str, self.faults), *self.unchecked]))

    @classmethod
    def each(cls, error: ConfigurationError) -> tuple[ConfigurationError, ...]:
        """The faults that an error stands for."""
        return error.faults if isinstance(error, cls) else (error,)

    @classmethod
    def require_none(cls, faults: Iterable[ConfigurationError]) -> None:
        """Raise them; one alone as it is.

        Raises:
            ConfigurationError: there are any.
        """
        found = list(faults)
        if found:
            raise found[0] if len(found) == 1 else cls(found)


class RefusalError(ValorError):
    """A command that is not obeyed, and why.

    Attributes:
        kind: one word for what is wrong with it.
    """

    def __init__(self, kind: str, reason: str) -> None:
        super().__init__(reason)
        self.kind = kind


def expected(value: str, known: Iterable[str], besides: str = "") -> str:
    """What to say of a value that is none of those known: which are, and which of them it nearly is.

    Args:
        value: what was given.
        known: what it could have been.
        besides: what else it could have been, in words.
    """
    from difflib import get_close_matches

    names = list(known)
    text = "; ".join(
        [f"expected {besides}one of {', '.join(names) or '(none found)'}"]
        + [f"did you mean {near!r}?" for near in get_close_matches(value, names, n=1)]
    )
    return f"{value!r}: {text}"


def require_one_of(what: str, value: str, known: Iterable[str]) -> None:
    """Check a value against those known.

    Raises:
        ConfigurationError: it is none of them; lists them.
    """
    names = list(known)
    if value not in names:
        raise ConfigurationError(f"{what} {expected(value, names)}")
