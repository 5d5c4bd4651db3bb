"""supervisord's configuration, rendered from the process table."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

from valor.common.errors import ConfigurationError
from valor.common.instance import Instance
from valor.common.processes import EXIT_CONFIGURATION, SUPERVISED, Process

"""In the environment of supervisord and all its descendants, and of nobody who merely joined the instance."""

PYTHON = "VALOR_PYTHON"
FOLDER = "VALOR_FOLDER"

DESCRIPTORS = 256
"""File descriptors that a process may need; the recorder, which holds most of them, had 77 beside a standing robot."""

_SOCKET_PATH_LIMIT = 107  # sun_path is 108 bytes with the final NUL
# supervisord binds a name with its pid appended, then links it to the one asked for.
_SOCKET_SUFFIX = len(".4194304")

# Paths come in through the environment: in the file itself `;`, `#` and `%` would need care.
_HEADER = f"""\
; Written by `valorctl up` from valor/common/processes.py.
[supervisord]
nodaemon=true
minfds={DESCRIPTORS}
logfile=%(ENV_VALOR_FOLDER)s/logs/supervisord.log
logfile_maxbytes=0
pidfile=%(ENV_VALOR_FOLDER)s/supervisord.pid
childlogdir=%(ENV_VALOR_FOLDER)s/logs
identifier=valor

[unix_http_server]
file=%(ENV_VALOR_FOLDER)s/supervisor.sock
chmod=0700

[rpcinterface:supervisor]
supervisor.rpcinterface_factory=supervisor.rpcinterface:make_main_rpcinterface
"""

# startsecs=0 and exitcodes: a process is restarted whatever happened to it, except that a configuration error
# (which would come again) leaves it where it is.
_PROGRAM = """
[program:{name}]
command="%(ENV_{python})s" -m {module}
autostart=false
autorestart=unexpected
exitcodes={configuration_error}
startsecs=0
startretries=3
stopsignal=TERM
stopwaitsecs={stop_timeout}
stopasgroup=true
killasgroup=true
redirect_stderr=true
stdout_logfile=%(ENV_VALOR_FOLDER)s/logs/{name}.log
stdout_logfile_maxbytes=10MB
stdout_logfile_backups=2
"""


def render(processes: Iterable[Process]) -> str:
    """The configuration file's text; the same for every instance."""
    return _HEADER + "".join(
        _PROGRAM.format(
            name=process.name,
            python=PYTHON,
            module=process.module,
            configuration_error=EXIT_CONFIGURATION,
            stop_timeout=max(1, round(process.stop_timeout)),
        )
        for process in processes
    )


def environment(instance: Instance, python: str, inherited: Mapping[str, str]) -> dict[str, str]:
    """The environment of supervisord and so of every process under it."""
    return (
        dict(inherited)
        | instance.environment()
        | {
            SUPERVISED: "1",
            PYTHON: python,
            FOLDER: str(instance.folder),
            "BIFROST_OWNERS": str(instance.owners),
            "PYTHONUNBUFFERED": "1",
            "MUJOCO_GL": "disable",  # no service draws, and `import mujoco` fails where EGL is asked for and absent
            # One thread each: pools of them fight over the cores that the control loops need.
            "OPENBLAS_NUM_THREADS": "1",
            "OMP_NUM_THREADS": "1",
            "MKL_NUM_THREADS": "1",
            "NUMEXPR_NUM_THREADS": "1",
        }
    )


def config_file(instance: Instance) -> Path:
    """Where the configuration stands while the instance is up."""
    return instance.folder / "supervisord.conf"


def pid_file(instance: Instance) -> Path:
    """Where supervisord writes its process id."""
    return instance.folder / "supervisord.pid"


def log_file(instance: Instance) -> Path:
    """What supervisord itself tells."""
    return instance.logs / "supervisord.log"


def socket_file(instance: Instance) -> Path:
    """Where supervisord listens.

    Raises:
        ConfigurationError: the path is longer than a unix socket's may be.
    """
    file = instance.folder / "supervisor.sock"
    limit = _SOCKET_PATH_LIMIT - _SOCKET_SUFFIX
    if (length := len(str(file).encode())) > limit:
        raise ConfigurationError(
            f"{file}: {length} bytes, but a unix socket's path may have {limit}; choose a shorter VALOR_HOME"
        )
    return file
