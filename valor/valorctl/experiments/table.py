"""Every experiment, by name: add a line here to add one; and all of them in a row."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

from valor.analysis.results import Result
from valor.common.instance import Instance
from valor.valorctl.console import Progress, complain
from valor.valorctl.experiments import end_effector, ipc_latency, pathway_latency, process_stats, tracking
from valor.valorctl.experiments.experiment import Experiment, Options
from valor.valorctl.interruption import InterruptedBySignalError, Interruption

ARM = ("right_arm",)
# fmt: off
EXPERIMENTS: tuple[Experiment, ...] = (
    #          name             title                            reproduces               runs, needs
    Experiment("process-stats", "What the processes cost",       "Table 5.1",             process_stats.run),
    Experiment("ipc-latency",   "What a message costs",          "Figure 5.1, Table 5.2", ipc_latency.run),
    Experiment("pathway-latency", "How long commands and states take", "Figures 5.2, 5.3", pathway_latency.run, ARM),
    Experiment("tracking",      "How the joints follow",         "Figures 5.4–5.6",       tracking.run, ARM),
    Experiment("end-effector",  "Where the hand ends",           "Figures 5.7–5.15",      end_effector.run, ARM),
)
# fmt: on

BY_NAME = {experiment.name: experiment for experiment in EXPERIMENTS}


def perform_all(
    instance: Instance,
    options: Options,
    progress: Progress,
    interruption: Interruption,
    tell: Callable[[Result], None],
) -> None:
    """Run every experiment of the table; each leaves a result or a failure in a folder of its name.

    One that fails costs its own chapter of the report, no other's.

    Args:
        instance: of each system, one after the other.
        options: of each; ``out`` is the folder of their folders.
        progress: told how it goes on.
        interruption: ends it, with the experiment of that moment.
        tell: is handed each result.

    Raises:
        InterruptedBySignalError: somebody asked to stop.
    """
    began = time.monotonic()
    for i, each in enumerate(EXPERIMENTS):
        progress.done(f"--- {i + 1} of {len(EXPERIMENTS)}: {each.name} ({each.reproduces})")
        try:
            result, _ = each.perform(instance, replace(options, out=options.out / each.name), progress, interruption)
            tell(result)
        except InterruptedBySignalError:
            raise
        except Exception as error:  # told in the report, with all that there is to say
            progress.clear()
            complain(f"{each.name} failed: {error}")
        progress.done(f"--- {(time.monotonic() - began) / 60.0:.1f} min since the first began")
