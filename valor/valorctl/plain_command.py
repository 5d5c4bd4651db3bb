"""Command lines so plain that they are read without the other verbs' imports, which take longer than some verbs do."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from valor.common.instance import Instance


def plain_command(
    arguments: Sequence[str], verb: str, options: Collection[str]
) -> tuple[Instance, frozenset[str]] | None:
    """The instance and the options of a command line that is nothing but a verb and some of its options.

    Args:
        arguments: of the command line.
        verb: its first word.
        options: those without a value, but for ``--instance NAME``, which may stand anywhere.

    Returns:
        None: it is another one, or a wrong one, for the command line as a whole to tell.
    """
    words = list(arguments)
    name = None
    if "--instance" in words[:-1]:
        at = words.index("--instance")
        name = words[at + 1]
        del words[at : at + 2]
    if words[:1] != [verb] or not {*words[1:]} <= {*options}:
        return None
    return Instance.from_environment(name), frozenset(words[1:])
