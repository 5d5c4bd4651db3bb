"""The verbs on their own: ``python -m bifrost.cli``."""

from __future__ import annotations

import sys

import typer

from bifrost.cli.services import service
from bifrost.cli.topics import topic
from bifrost.errors import Error

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.add_typer(topic)
app.add_typer(service)


def main() -> int:
    """Run the verbs on their own: 0 done, 1 with one line on stderr, 2 wrong usage."""
    try:
        app(prog_name="bifrost")
    except Error as error:
        print(f"bifrost: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
