"""supervisord's configuration, rendered from the process table."""

from collections.abc import Iterable, Mapping
from pathlib import Path

from valor.common.errors import ConfigurationError
from valor.common.instance import Instance
from valor.common.processes import EXIT_CONFIGURATION, SUPERVISED, Process

# In the environment of supervisord and its descendants, not of programs that joined the instance.
PYTHON = "VALOR_PYTHON"
FOLDER = "VALOR_FOLDER"
RUN = "VALOR_RUN"
NAMESPACE = "valor"  # of calls with deadlines in XML-RPC
SOCKET = "supervisor.sock"  # in the instance's folder

DESCRIPTORS = 256
"""File descriptors per process; the recorder uses most, 77 with a standing robot."""

_SOCKET_PATH_LIMIT = 107  # sun_path is 108 bytes with the final NUL
# supervisord binds a name with its pid appended, then links it to the configured one.
_SOCKET_SUFFIX = len(".4194304")

# Paths are passed in the environment: in the file, `;`, `#` and `%` would need escaping.
_HEADER = f"""\
; Written by `valorctl up` from valor/common/processes.py.
[supervisord]
nodaemon=true
minfds={DESCRIPTORS}
logfile=%(ENV_VALOR_FOLDER)s/logs/supervisord.log
logfile_maxbytes=0
pidfile=%(ENV_VALOR_FOLDER)s/supervisord.pid
childlogdir=%(ENV_VALOR_FOLDER)s/logs
identifier=%(ENV_VALOR_RUN)s

[unix_http_server]
file=%(ENV_VALOR_FOLDER)s/supervisor.sock
chmod=0700

[rpcinterface:supervisor]
supervisor.rpcinterface_factory=supervisor.rpcinterface:make_main_rpcinterface

[rpcinterface:{NAMESPACE}]
supervisor.rpcinterface_factory=valor.valorctl.hosts.deadlines:DeadlineInterface
"""

# startsecs=0 and exitcodes: a process is restarted after any end except a configuration error, which would recur.
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
    """Text of the configuration file, the same for every instance."""
    return _HEADER + programs(processes)


def programs(processes: Iterable[Process]) -> str:
    """The part of the configuration file about processes."""
    return "".join(
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
    """The environment of supervisord and of its processes."""
    return (
        dict(inherited)
        | instance.environment()
        | {
            SUPERVISED: "1",
            PYTHON: python,
            FOLDER: str(instance.folder),
            RUN: instance.settings().run or "valor",
            "BIFROST_OWNERS": str(instance.owners),
            "PYTHONUNBUFFERED": "1",
            "MUJOCO_GL": "disable",  # no service renders, and `import mujoco` fails if EGL is requested and absent
            # One thread per process: thread pools compete for the cores of the control loops.
            "OPENBLAS_NUM_THREADS": "1",
            "OMP_NUM_THREADS": "1",
            "MKL_NUM_THREADS": "1",
            "NUMEXPR_NUM_THREADS": "1",
        }
    )


def config_file(instance: Instance) -> Path:
    """The configuration file of an instance that is up."""
    return instance.folder / "supervisord.conf"


def pid_file(instance: Instance) -> Path:
    """The file with supervisord's process id."""
    return instance.folder / "supervisord.pid"


def socket_file(instance: Instance) -> Path:
    """Supervisord's socket. Raises ``ConfigurationError``: the path is too long for a Unix socket."""
    file = instance.folder / SOCKET
    limit = _SOCKET_PATH_LIMIT - _SOCKET_SUFFIX
    if (length := len(str(file).encode())) > limit:
        raise ConfigurationError(
            f"{file}: {length} bytes, but a unix socket's path may have {limit}; choose a shorter VALOR_HOME"
        )
    return file
