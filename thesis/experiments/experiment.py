"""Frame of every experiment: options, systems, result."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

from thesis.analysis import rates
from thesis.report.results import FAILURE_FILE, FILE, Failure, Measure, Picture, Result, Table, host_facts
from valor.common.errors import ValorError
from valor.common.instance import ClockMode, Instance, Link, Recording, Settings
from valor.common.resources import robot_folder
from valor.robot.description import RobotDescription
from valor.valorctl.drive import arm_motion
from valor.valorctl.instance import ros_domain, startup
from valor.valorctl.instance.instance_setup import Request
from valor.valorctl.terminal.console import Interruption, Progress


@dataclass(frozen=True)
class Options:
    """Options of the command line."""

    out: Path  # the experiment's own folder
    quick: bool = False
    seed: int = 0
    actuators: str = "hardware"
    robot: str = "escher"
    profile: str = "sim"
    clock: ClockMode | None = None  # None: that of the profile
    with_clients: bool = False  # also measure the processes while clients work with the robot


@dataclass
class Run:
    """One run of an experiment: means and findings."""

    instance: Instance
    options: Options
    progress: Progress
    interruption: Interruption
    settings: dict[str, str] = field(default_factory=dict)
    text: str = ""
    measures: list[Measure] = field(default_factory=list)
    tables: list[Table] = field(default_factory=list)
    pictures: list[Picture] = field(default_factory=list)
    files: list[Path] = field(default_factory=list)
    rates: list[dict[str, float]] = field(default_factory=list)  # of each recorded system

    @property
    def out(self) -> Path:
        """Folder of the results."""
        return self.options.out

    @contextmanager
    def system(
        self,
        *,
        profile: str | None = None,
        bag: Path | None = None,
        robot: Path | None = None,
        actuators: str | None = None,
        recording: Recording | None = None,
        page: bool = False,
        sensors: tuple[str, ...] = (),
    ) -> Iterator[Settings]:
        """Start a separate system for the block; it is stopped in any case.

        Args:
            profile: of processes; default that of the command line.
            bag: file of the recorder.
            robot: its folder; default that of the command line.
            actuators: profile of imperfections; default that of the command line.
            recording: what is recorded; default everything.
            page: whether to add both ends of a link, with the operator's page behind it.
            sensors: simulated sensors to add.
        """
        if bag is not None:
            bag.unlink(missing_ok=True)  # of an earlier run: the recorder would choose another name
        options = self.options
        request = Request(
            profile=profile or options.profile, robot=str(robot or options.robot), clock=options.clock,
            actuators=actuators or options.actuators, seed=options.seed, bag=bag, recording=recording or Recording(),
            view=page, link=Link(domain=_behind(self.instance) if page else None), sensors=sensors,
        )  # fmt: skip
        with startup.running(self.instance, request, self.progress, self.interruption) as settings:
            rate = RobotDescription.load(settings.robot, settings.control_rate).tables.control_rate
            self.note({
                "robot": settings.robot.name, "profile": settings.profile, "clock": settings.clock,
                "actuators": settings.actuators, "world": settings.world, "seed": str(settings.seed),
                f"{rates.TICK} asked for at": f"{rate:g} Hz",
            })  # fmt: skip
            yield settings
        if bag is not None and bag.exists():
            self.rates.append(rates.achieved(bag))

    def note(self, settings: dict[str, str]) -> None:
        """Store the settings of a system; of several systems all distinct values."""
        for key, value in settings.items():
            known = self.settings.setdefault(key, value)
            if value not in known.split(", "):
                self.settings[key] = f"{known}, {value}"

    def picture(self, files: list[Path], caption: str, reproduces: str = "") -> None:
        """Add figures to the result."""
        self.pictures += [Picture(str(file.relative_to(self.out)), caption, reproduces) for file in files]
        self.interruption.check()


@dataclass(frozen=True)
class Experiment:
    """One row of the table."""

    name: str
    title: str
    reproduces: str
    run: Callable[[Run], None]
    needs: tuple[str, ...] = ()  # groups of robot.yaml that must have joints

    def perform(
        self, instance: Instance, options: Options, progress: Progress, interruption: Interruption
    ) -> tuple[Result, Path]:
        """Run the experiment.

        Returns:
            The result, and its file.

        Raises:
            ValorError: it failed. All its processes have ended.
        """
        try:
            options.out.mkdir(parents=True, exist_ok=True)
            # Plots and bags of an earlier run are overwritten from now on, so its result is invalid.
            for stale in (FILE, FAILURE_FILE):
                (options.out / stale).unlink(missing_ok=True)
        except OSError as error:
            raise ValorError(f"{error.filename}: {error.strerror}") from None
        host = host_facts()
        started = datetime.now().astimezone().isoformat(timespec="seconds")
        began = time.monotonic()
        run = Run(instance, options, progress, interruption)
        words = [f"valorctl experiment {self.name}", *(["--quick"] if options.quick else []), f"--seed {options.seed}",
                 f"--actuators {options.actuators}", f"--robot {options.robot}", f"--profile {options.profile}",
                 *([f"--clock {options.clock}"] if options.clock else []),
                 *(["--with-clients"] if options.with_clients else [])]  # fmt: skip
        command = " ".join(words)
        try:
            if self.needs:
                robot = RobotDescription.load(robot_folder(options.robot))
                arm_motion.require_limbs(robot, f"experiment {self.name}", *self.needs)
            self.run(run)
        except Exception as error:
            known = isinstance(error, ValorError)
            reason = str(error) if known else f"{type(error).__name__}: {error}"
            details = "" if known else traceback.format_exc()
            failure = Failure(experiment=self.name, command=command, started=started, reason=reason, details=details)
            try:
                failure.save(options.out / FAILURE_FILE)
            except OSError as lost:
                if known:
                    raise error from None
                raise ValorError(f"{_lost(lost)}; the experiment had ended with {reason}") from None
            raise
        result = Result(
            experiment=self.name, title=self.title, reproduces=self.reproduces, command=command, started=started,
            quick=options.quick, settings=run.settings | rates.told(run.rates), host=host, text=run.text,
            measures=run.measures, tables=run.tables, pictures=run.pictures,
            files=[str(file.relative_to(run.out)) for file in run.files],
            seconds=round(time.monotonic() - began, 1),
        )  # fmt: skip
        try:
            return result, result.save(options.out / FILE)
        except OSError as lost:
            raise ValorError(f"{_lost(lost)}; the result is lost") from None


def _behind(instance: Instance) -> int:
    """Choose a ROS domain for the operator's side of a link."""
    others = ros_domain.taken(instance.folder.parent)
    robots = ros_domain.choose(instance.name, others, ros_domain.is_free)
    return ros_domain.choose(f"{instance.name} behind the link", {*others, robots}, ros_domain.is_free)


def _lost(error: OSError) -> str:
    return f"{error.filename}: {error.strerror}: expected the folder to stay while the experiment runs"
