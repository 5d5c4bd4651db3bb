"""Every experiment, by name: add a line here to add one."""

from __future__ import annotations

from valor.valorctl.experiments import end_effector, ipc_latency, pathway_latency, process_stats, tracking
from valor.valorctl.experiments.experiment import Experiment

# fmt: off
EXPERIMENTS: tuple[Experiment, ...] = (
    #          name             title                            reproduces               runs
    Experiment("process-stats", "What the processes cost",       "Table 5.1",             process_stats.run),
    Experiment("ipc-latency",   "What a message costs",          "Figure 5.1, Table 5.2", ipc_latency.run),
    Experiment("pathway-latency", "How long commands and states take", "Figures 5.2, 5.3", pathway_latency.run),
    Experiment("tracking",      "How the joints follow",         "Figures 5.4–5.6",       tracking.run),
    Experiment("end-effector",  "Where the hand ends",           "Figures 5.7–5.15",      end_effector.run),
)
# fmt: on

BY_NAME = {experiment.name: experiment for experiment in EXPERIMENTS}
