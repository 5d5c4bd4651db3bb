"""Errors whose text is one line for the user: file, key, value, expectation."""

from collections.abc import Iterable


class ValorError(Exception):
    """Base of all errors raised on purpose. The text is one line for each fault."""


class ConfigurationError(ValorError):
    """A file or a setting is missing or wrong; names the file, the key and the expectation."""


class SeveralFaultsError(ConfigurationError):
    """Several faults, and the checks that they prevented, ``unchecked``; one line each."""

    def __init__(self, faults: Iterable[ConfigurationError], unchecked: Iterable[str] = ()) -> None:
        self.faults = tuple(faults)
        self.unchecked = tuple(unchecked)
        super().__init__("\n".join([*map(str, self.faults), *self.unchecked]))

    @classmethod
    def each(cls, error: ConfigurationError) -> tuple[ConfigurationError, ...]:
        """The single faults of an error."""
        return error.faults if isinstance(error, cls) else (error,)

    @classmethod
    def require_none(cls, faults: Iterable[ConfigurationError]) -> None:
        """Raise the faults, if there are any; a single fault as it is."""
        found = list(faults)
        if found:
            raise found[0] if len(found) == 1 else cls(found)


class RefusalError(ValorError):
    """Rejection of a command: ``kind``, one word for the cause, and the reason."""

    def __init__(self, kind: str, reason: str) -> None:
        super().__init__(reason)
        self.kind = kind


def expected(value: str, known: Iterable[str], besides: str = "") -> str:
    """Text about a value that is not among the allowed ones: these, ``besides`` them, and the most similar one."""
    from difflib import get_close_matches

    names = list(known)
    text = "; ".join(
        [f"expected {besides}one of {', '.join(names) or '(none found)'}"]
        + [f"did you mean {near!r}?" for near in get_close_matches(value, names, n=1)]
    )
    return f"{value!r}: {text}"


def require_one_of(what: str, value: str, known: Iterable[str]) -> None:
    """Raise ConfigurationError, with all allowed values, if a value is not among them."""
    names = list(known)
    if value not in names:
        raise ConfigurationError(f"{what} {expected(value, names)}")
