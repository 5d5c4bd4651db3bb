"""Table of all experiments; a new experiment is a new row."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

from thesis.experiments import end_effector, ipc_latency, pathway_latency, process_stats, tracking
from thesis.experiments.experiment import Experiment, Options
from thesis.report.results import Result
from valor.common.instance import Instance
from valor.valorctl.terminal.console import InterruptedBySignalError, Interruption, Progress, complain

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
    """Run every experiment; each saves a result or a failure in a folder of its name.

    A failure affects only its own chapter of the report.

    Args:
        instance: of each system, in turn.
        options: of each; ``out`` contains their folders.
        progress: display.
        interruption: ends the run.
        tell: called with each result.

    Raises:
        InterruptedBySignalError: the user interrupted.
    """
    began = time.monotonic()
    for i, each in enumerate(EXPERIMENTS):
        progress.done(f"--- {i + 1} of {len(EXPERIMENTS)}: {each.name} ({each.reproduces})")
        try:
            result, _ = each.perform(instance, replace(options, out=options.out / each.name), progress, interruption)
            tell(result)
        except InterruptedBySignalError:
            raise
        except Exception as error:  # the report states the failure
            progress.clear()
            complain(f"{each.name} failed: {error}")
        progress.done(f"--- {(time.monotonic() - began) / 60.0:.1f} min since the first began")
