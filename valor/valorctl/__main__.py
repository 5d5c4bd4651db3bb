"""``valorctl``: the command line's entry point and its exit status.

Until ``main`` has begun Ctrl-C would end in a traceback; so it ends without a word until then, as by other signals.
"""

# No `from __future__`: it would look for a file before Ctrl-C is seen to.
import _signal  # type: ignore[import-not-found]  # loaded with the interpreter

if _signal.getsignal(_signal.SIGINT) is not _signal.SIG_IGN:  # as under nohup
    _signal.signal(_signal.SIGINT, _signal.SIG_DFL)

import contextlib
import gc
import os
import signal
import sys

EXIT_FAILURE = 1
STOP_NICE = -5  # as the VRC's on hardware


def main() -> int:
    """Run the command line as a process of its own; what ``run`` says, and a signal at any moment ends it in one line.

    Where something must be put in order first, ``interruption`` takes over.
    """
    for signum in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(signum) is not signal.SIG_IGN:  # as under nohup
            signal.signal(signum, _end)
    try:
        return run()
    finally:
        gc.freeze()  # what is left ends with the process: to look through it for cycles takes longer than some verbs


def _end(signum: int, _frame: object) -> None:
    """End here and now: an exception would surface wherever an import or a library's callback happens to be."""
    name = signal.Signals(signum).name
    clear = "\r\033[K\033[?25h" if os.isatty(2) else ""  # the line that told of progress, and the cursor again
    os.write(2, f"{clear}valorctl: interrupted by {name}\n".encode())
    os._exit(128 + signum)


def run() -> int:
    """Run the command line.

    Returns:
        0 when the thing was done and verified, 1 when not, 128 and the signal's number when interrupted. A wrong
        command line exits with 2.
    """
    # `import mujoco` looks for the platform that this names, and fails where it is absent. Only pictures need one, and
    # they find their own.
    if os.environ.get("MUJOCO_GL") != "osmesa":
        os.environ["MUJOCO_GL"] = "disable"

    from valor.common.errors import ValorError
    from valor.valorctl.console import complain
    from valor.valorctl.interruption import InterruptedBySignalError

    try:
        _obey(sys.argv[1:])
    except InterruptedBySignalError as error:
        complain(str(error))
        return error.exit_status
    except ValorError as error:
        complain(str(error))
        return EXIT_FAILURE
    except Exception as error:
        # Bifrost takes long to import: whatever it raised, it has been imported.
        if (bifrost := sys.modules.get("bifrost")) and isinstance(error, bifrost.Error):
            from valor.common.instance import Instance

            instance = Instance.from_environment()
            complain(str(error) if instance.settings_file.exists() else instance.not_up)
            return EXIT_FAILURE
        raise
    return 0


def _obey(arguments: list[str]) -> None:
    """Do what a command line says; what is asked most urgently, or most often, waits for no other verb's imports.

    A stop does not wait for its turn, either, if that is granted.
    """
    if "stop" in arguments:
        with contextlib.suppress(PermissionError):
            os.setpriority(os.PRIO_PROCESS, 0, STOP_NICE)
        from valor.valorctl import stopping

        if plain := stopping.command_line(arguments):
            stopping.run(*plain)
            return
    if "status" in arguments:
        from valor.valorctl.plain_command import plain_command

        if asked := plain_command(arguments, "status", ("--json",)):
            from valor.valorctl import watch

            instance, options = asked
            watch.run(instance, "--json" in options)
            return
    from valor.valorctl.app import app

    app()


if __name__ == "__main__":
    sys.exit(main())
