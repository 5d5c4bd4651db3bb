"""All experiments in a row. One that fails costs its own chapter of the report, no other's."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

from valor.analysis.results import Result
from valor.common.instance import Instance
from valor.valorctl.console import Progress, complain
from valor.valorctl.experiments.experiment import Options
from valor.valorctl.experiments.table import EXPERIMENTS
from valor.valorctl.interruption import InterruptedBySignalError, Interruption


def perform(
    instance: Instance,
    options: Options,
    progress: Progress,
    interruption: Interruption,
    tell: Callable[[Result], None],
) -> None:
    """Run every experiment of the table; each leaves a result or a failure in a folder of its name.

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
