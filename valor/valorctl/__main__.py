"""``valorctl``: the command line's entry point and its exit status."""

from __future__ import annotations

import sys

from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.valorctl.app import app
from valor.valorctl.console import complain
from valor.valorctl.interruption import InterruptedBySignalError

EXIT_FAILURE = 1


def main() -> int:
    """Run the command line.

    Returns:
        0 when the thing was done and verified, 1 when not, 128 and the signal's number when interrupted. A wrong
        command line exits with 2.
    """
    try:
        app()
    except InterruptedBySignalError as error:
        complain(str(error))
        return error.exit_status
    except ValorError as error:
        complain(str(error))
        return EXIT_FAILURE
    except Exception as error:
        # Bifrost takes long to import: whatever it raised, it has been imported.
        if (bifrost := sys.modules.get("bifrost")) and isinstance(error, bifrost.Error):
            complain(str(error) if Instance.from_environment().settings_file.exists() else f"not up: {error}")
            return EXIT_FAILURE
        raise
    return 0


if __name__ == "__main__":
    sys.exit(main())
