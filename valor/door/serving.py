"""Which port a server of the operator's page listens on itself, and the door before it, if there is one."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from valor.common.errors import ConfigurationError
from valor.common.instance import Instance, Settings
from valor.common.viewing import Viewing, free_port, page_port

STOP_BUTTON = "/stop-button"
"""Where the page's own door sends whoever wants the stop's."""


def inside(viewing: Viewing, port: int) -> int:
    """The port on the loopback interface of what has ``port`` for everybody."""
    return free_port() if viewing.secured else port


class Guard:
    """A door, where the page is served beyond this computer; else nothing."""

    def __init__(
        self, instance: Instance, settings: Settings, port: int, within: int,
        elsewhere: Mapping[str, int] | None = None,
    ) -> None:  # fmt: skip
        """Listen where the instance's file says.

        Args:
            instance: whose tokens let in.
            settings: of the instance.
            port: for everybody.
            within: of the server on the loopback interface.
            elsewhere: as of ``Door``.

        Raises:
            ConfigurationError: certificate, tokens or address are not to be had.
        """
        viewing = Viewing.of(instance)
        self._door = None
        if not viewing.secured:
            return
        if viewing.certificate is None:
            raise ConfigurationError(f"{instance.viewing_file}: no certificate for {viewing.host}")
        from valor.door.admission import Admission
        from valor.door.certificate import context
        from valor.door.door import Door

        viewer, operator = (_token(file) for file in (instance.viewer_token, instance.operator_token))
        admission = Admission(f"valor_{page_port(settings)}", viewer, [operator])
        self._door = Door((viewing.host, port), context(viewing.certificate), admission, within, elsewhere)

    def close(self) -> None:
        """Nobody comes through any more."""
        if self._door is not None:
            self._door.close()


def _token(file: Path) -> str:
    try:
        return file.read_text().strip()
    except OSError as error:
        raise ConfigurationError(f"{file}: {error.strerror}; `valorctl up` writes it") from None
