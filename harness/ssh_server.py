"""A computer's ssh server for tests: commands and Unix sockets for one key, until it is killed.

    python -m harness.ssh_server ADDRESS PORT FOLDER

FOLDER has ``host_key`` and ``authorized_keys``. Commands run in this process' environment, network and clocks.
"""

from __future__ import annotations

import asyncio
import contextlib
import sys

import asyncssh


class _Server(asyncssh.SSHServer):  # type: ignore[misc]
    def unix_connection_requested(self, dest_path: str) -> bool:
        return True


async def _run(process: asyncssh.SSHServerProcess) -> None:
    child = await asyncio.create_subprocess_shell(
        process.command or "true",
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
    )
    await process.redirect(stdin=child.stdin, stdout=child.stdout, stderr=child.stderr)
    with contextlib.suppress(OSError, asyncssh.Error):
        process.exit(await child.wait())


async def _serve(address: str, port: str, folder: str) -> None:
    await asyncssh.listen(
        address,
        int(port),
        server_factory=_Server,
        server_host_keys=[f"{folder}/host_key"],
        authorized_client_keys=f"{folder}/authorized_keys",
        process_factory=_run,
        encoding=None,
    )
    print("listens", flush=True)
    await asyncio.Event().wait()


if __name__ == "__main__":
    asyncio.run(_serve(*sys.argv[1:]))
