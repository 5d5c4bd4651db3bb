"""Entry point of ``valorctl`` and its exit status."""

import gc
import os
import signal
import sys

EXIT_FAILURE = 1
STOP_NICE = -5  # niceness of ``stop`` and ``down``, that of the Valor ROS Controller on hardware


def main() -> int:
    """Run the command line as a process: see ``run``. A signal ends the process at once with one line.

    A verb that must finish a change first replaces the signal handlers by an ``Interruption``.
    """
    for signum in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(signum) is not signal.SIG_IGN:  # ignored under nohup
            signal.signal(signum, _end)
    if not {"stop", "down"}.isdisjoint(sys.argv):
        _take_priority()
    try:
        return run()
    finally:
        gc.freeze()  # the collection at exit takes longer than some verbs


def _take_priority() -> None:
    """Schedule this process next after the control loops, which may leave others a twentieth of a slow computer."""
    import contextlib  # only now, when signals are handled

    with contextlib.suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, STOP_NICE)
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(1))


def _end(signum: int, _frame: object) -> None:
    """End the process here: an exception would surface in an import or in a library's callback."""
    name = signal.Signals(signum).name
    clear = "\r\033[K\033[?25h" if os.isatty(2) else ""  # removes the progress line and shows the cursor
    os.write(2, f"{clear}valorctl: interrupted by {name}\n".encode())
    os._exit(128 + signum)


def run() -> int:
    """Run the command line; returns 0, or 1 after a failure, or 128 plus the number of the signal."""
    # `import mujoco` fails where the platform named by this variable is absent. Only pictures need a platform, and
    # they choose one themselves.
    if os.environ.get("MUJOCO_GL") != "osmesa":
        os.environ["MUJOCO_GL"] = "disable"

    from valor.common.errors import ValorError
    from valor.valorctl.terminal.app import app
    from valor.valorctl.terminal.console import InterruptedBySignalError, complain

    try:
        app()
    except InterruptedBySignalError as error:
        complain(str(error))
        return error.exit_status
    except ValorError as error:
        complain(str(error))
        return EXIT_FAILURE
    except Exception as error:
        bifrost = sys.modules.get("bifrost")  # imported already, if it raised the error
        if bifrost is None or not isinstance(error, bifrost.Error):
            raise
        from valor.common.instance import Instance

        instance = Instance.from_environment()
        complain(str(error) if instance.settings_file.exists() else instance.not_up)
        return EXIT_FAILURE
    return 0


if __name__ == "__main__":
    sys.exit(main())
