"""What a soak does to a system from outside does what it says."""

from __future__ import annotations

import errno
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from tests.soak import disk, links

TALKER = (
    "import socket, sys; s = socket.create_connection(('127.0.0.1', int(sys.argv[1]))); print(s.recv(1), flush=True)"
)


def test_connections_of_another_process_are_cut() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        command = [sys.executable, "-c", TALKER, str(port)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as talker:
            connection, _ = server.accept()
            with connection:
                connection.settimeout(20.0)
                assert links.cut(talker.pid) == 1
                assert connection.recv(1) == b""
                assert talker.communicate(timeout=20.0)[0] == "b''\n"


def test_a_disk_is_filled_to_the_last_byte_and_given_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(disk, "SIZE", 4 << 20)
    folder = tmp_path / "disk"
    folder.mkdir()
    if not disk.mount(folder):
        pytest.skip("this user may not mount a disk in memory")
    log = folder / "log"
    log.write_text("as it was")
    disk.fill(folder)
    with pytest.raises(OSError) as raised, log.open("a") as file:
        file.write("x" * 8192)
    assert raised.value.errno == errno.ENOSPC
    disk.empty(folder)
    (folder / "other").write_text("x" * 8192)
    kept = disk.leave(folder, keep=True)
    assert kept is not None and (kept / "log").read_text().startswith("as it was")
    assert not folder.exists()
