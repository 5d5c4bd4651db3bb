"""What every experiment is given, and how it leaves its result."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

from valor.analysis.results import FAILURE_FILE, FILE, Failure, Measure, Picture, Result, Table, host_facts
from valor.common.errors import ValorError
from valor.common.instance import ClockMode, Instance, Link, Recording, Settings
from valor.common.resources import robot_folder
from valor.common.viewing import Viewing
from valor.robot.description import RobotDescription
from valor.valorctl import arm_motion, ros_domain, startup
from valor.valorctl.console import Progress
from valor.valorctl.instance_setup import Request
from valor.valorctl.interruption import Interruption


@dataclass(frozen=True)
class Options:
    """What the command line said."""

    out: Path  # the experiment's own folder
    quick: bool = False
    seed: int = 0
    actuators: str = "hardware"
    robot: str = "escher"
    profile: str = "sim"
    clock: ClockMode | None = None  # as the profile has it unless said
    beside: bool = False  # also measure the processes while others work with the robot


@dataclass
class Run:
    """One run: what it may use, and what it has found so far."""

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

    @property
    def out(self) -> Path:
        """The folder for what it leaves."""
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
    ) -> Iterator[Settings]:
        """A system of the experiment's own that is up inside and down behind, whatever happens.

        Args:
            profile: which processes it has; that of the command line unless given.
            bag: where its recorder writes.
            robot: its folder; the profile's robot unless given.
            actuators: a profile of imperfections; that of the command line unless given.
            recording: what the recorder keeps; everything unless given.
            page: with both ends of a link, and the operator's page behind it.
        """
        if bag is not None:
            bag.unlink(missing_ok=True)  # an earlier run's: the recorder would take another name
        options = self.options
        request = Request(
            profile=profile or options.profile, robot=str(robot or options.robot), clock=options.clock,
            actuators=actuators or options.actuators, seed=options.seed, bag=bag, recording=recording or Recording(),
            view=Viewing() if page else None, link=Link(domain=_behind(self.instance) if page else None),
        )  # fmt: skip
        with startup.running(self.instance, request, self.progress, self.interruption) as settings:
            self._note({
                "robot": settings.robot.name, "profile": settings.profile, "clock": settings.clock,
                "actuators": settings.actuators, "world": settings.world, "seed": str(settings.seed),
            })  # fmt: skip
            yield settings

    def _note(self, settings: dict[str, str]) -> None:
        """Keep what a system had; of several systems all that differ."""
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
    """One line of the table."""

    name: str
    title: str
    reproduces: str
    run: Callable[[Run], None]
    needs: tuple[str, ...] = ()  # groups of robot.yaml that must have joints

    def perform(
        self, instance: Instance, options: Options, progress: Progress, interruption: Interruption
    ) -> tuple[Result, Path]:
        """Run it.

        Returns:
            Its result, and the file that it was written to.

        Raises:
            ValorError: it failed; says where. Nothing goes on running behind it.
        """
        try:
            options.out.mkdir(parents=True, exist_ok=True)
            # Figures and bags of an earlier run are written over from now on: its result would be of no run at all.
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
                 *(["--beside"] if options.beside else [])]  # fmt: skip
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
                failure.save(options.out)
            except OSError as lost:
                if known:
                    raise error from None
                raise ValorError(f"{_lost(lost)}; the experiment had ended with {reason}") from None
            raise
        result = Result(
            experiment=self.name, title=self.title, reproduces=self.reproduces, command=command, started=started,
            quick=options.quick, settings=run.settings, host=host, text=run.text, measures=run.measures,
            tables=run.tables, pictures=run.pictures, files=[str(file.relative_to(run.out)) for file in run.files],
            seconds=round(time.monotonic() - began, 1),
        )  # fmt: skip
        try:
            return result, result.save(options.out)
        except OSError as lost:
            raise ValorError(f"{_lost(lost)}; the result is lost") from None


def _behind(instance: Instance) -> int:
    """A ROS domain for the operator's side of a link."""
    others = ros_domain.taken(instance.folder.parent)
    robots = ros_domain.choose(instance.name, others, ros_domain.is_free)
    return ros_domain.choose(f"{instance.name} behind the link", {*others, robots}, ros_domain.is_free)


def _lost(error: OSError) -> str:
    return f"{error.filename}: {error.strerror}: expected the folder to stay while the experiment runs"
