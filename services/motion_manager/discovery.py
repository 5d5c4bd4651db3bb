"""Discovery of handlers and drivers."""

from collections.abc import Iterator
from importlib import import_module
from pkgutil import iter_modules
from typing import Any


def classes(package: str, *bases: type) -> Iterator[Any]:
    """The subclasses of ``bases`` in a package's modules, without ``bases`` themselves; imports these modules."""
    for found in iter_modules(import_module(package).__path__):
        module = import_module(f"{package}.{found.name}")
        for value in vars(module).values():
            own = isinstance(value, type) and value.__module__ == module.__name__
            if own and issubclass(value, bases) and value not in bases:
                yield value
