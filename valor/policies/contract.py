"""Contract of a policy: everything needed to run it on a robot, out of one of four conventions and a sidecar."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray
from valor.common.errors import ConfigurationError, SeveralFaultsError
from valor.policies import exported, metadata
from valor.policies.facts import FACTS, UNKNOWN, Fact, Reading, Source, TermFact
from valor.policies.model_file import ModelFile
from valor.policies.observations import TERMS, Term
from valor.robot.description import RobotDescription

_TOLERANCE = 1e-6  # of periods [s]
_LONGEST = 0.5  # period [s]; more is a frequency
_BEYOND = 0.05  # default positions may be outside limits by this [rad]
_GAINS = ("stiffness", "damping")
_ACTIONS = ("action", "actions", "continuous_actions")  # names of outputs
Outputs = dict[str, tuple[str, npt.NDArray[np.intp]]]


class PolicyError(SeveralFaultsError):
    """A policy that is rejected: one line for each problem; ``convention`` and ``facts`` as of its contract."""

    def __init__(self, faults: Iterable[ConfigurationError], contract: Contract) -> None:
        super().__init__(faults)
        self.convention, self.facts = contract.convention, contract.facts


@dataclass(frozen=True)
class Contract:
    """Inputs and outputs of a policy; vectors have one entry for each of its m joints, in its order."""

    name: str
    convention: str
    facts: Mapping[str, Fact]  # all of ``facts.FACTS``, with sources
    model: ModelFile
    joints: tuple[str, ...]  # names in the robot
    period: float  # between acts [s]
    observation: tuple[Term, ...]
    history_order: str
    history_start: str
    outputs: Outputs  # by role (action, or position; velocity, effort, stiffness, damping): output, places of joints
    default_position: FloatArray  # (m,) [rad]; zeros if not needed
    action_scale: FloatArray  # (m,) [rad]
    action_offset: FloatArray  # (m,) [rad]
    action_clip: FloatArray  # (2, m) of the action
    position_clip: FloatArray  # (2, m) of the target [rad]
    stiffness: FloatArray  # (m,) [N·m/rad]; zeros if an output gives it
    damping: FloatArray  # (m,) [N·m·s/rad]; likewise
    command_ranges: FloatArray  # (2, 3) forward, left [m/s], turning left [rad/s]
    gait: Mapping[str, Any] | None  # ``facts.Gait``
    feedback: Mapping[str, str]  # input: output of the act before
    initial: Mapping[str, FloatArray]  # of inputs that are fed back; zeros without
    constants: Mapping[str, FloatArray]  # of inputs


def sidecar_of(file: Path) -> Path:
    """Path of a policy's sidecar: ``NAME.yaml``, or ``NAME.user.yaml`` if the exporter's file has that name."""
    named, found = file.with_suffix(".yaml"), exported.find(file)
    return file.with_suffix(".user.yaml") if found is not None and found[0] == named else named


def files_of(file: Path, target: Path) -> dict[Path, Path]:
    """Files of a policy, which may be missing, and what they are named next to ``target``, a copy of it."""
    found = exported.find(file)
    named = {} if found is None else {found[0]: target.with_suffix(f".{found[1]}.yaml")}
    beside = [*file.parent.glob(f"{file.stem}*.data"), *file.parent.glob("*_initial_values.safetensors")]
    named |= {each: target.with_name(each.name) for each in beside}
    return {file: target, sidecar_of(file): target.with_suffix(".yaml"), **named}


def load(file: Path, robot: RobotDescription) -> Contract:
    """Read a policy for a robot. Raises ConfigurationError; PolicyError names all that is missing or wrong."""
    model = ModelFile(file)
    model.require_finite()
    found, sidecar = exported.find(file), sidecar_of(file)
    try:
        reading = _read(model, found)
        reading.apply(sidecar)
        contract = _Assembly(model, reading, robot).contract()
    except (AttributeError, IndexError, KeyError, TypeError, ValueError) as error:
        where = file if found is None else found[0]
        raise ConfigurationError(f"{where}: {error!r}; expected values as its exporter writes them") from error
    if reading.problems:
        raise PolicyError(reading.errors(file, sidecar), contract)
    return contract


def _read(model: ModelFile, found: tuple[Path, str] | None) -> Reading:
    if found is not None:
        return exported.read(*found)
    reading = metadata.read(model.metadata) or Reading("none; the sidecar states all")
    if (stated := model.metadata.get("valor")) is not None:
        reading.embed(stated)
    return reading


class _Assembly:
    """Puts a contract together; what is missing or wrong becomes problems of the reading."""

    def __init__(self, model: ModelFile, reading: Reading, robot: RobotDescription) -> None:
        self._model, self._reading, self._robot = model, reading, robot
        self._value, self._reject = reading.value, reading.reject
        self._rename: Mapping[str, str] = self._value("joint_names") or {}
        self._names = self._file_joints()

    def contract(self) -> Contract:
        """Return the contract, which is valid if there are no problems."""
        value, names = self._value, self._names
        feedback, constants = self._connections()
        outputs = self._outputs(feedback)
        acts, offset = "action" in outputs, value("action_offset")
        relative = isinstance(offset, str)
        uses = [term.term for term in value("observation") or ()]
        zero = self._per_joint("default_position", needed=(acts and relative) or "joint_position_relative" in uses)
        gains = [self._per_joint(role, needed=role not in outputs) for role in _GAINS]
        if value("gait") is None and any(name.startswith("gait_") for name in uses):
            self._reject("gait", "unknown", "the period of the feet's phases")
        free = [name for name in self._model.inputs if name not in {*feedback, *constants}]
        terms = self._terms(dict(zip(names, zero, strict=True)), free)
        if any(term.history > 1 for term in terms):
            for fact in ("history_order", "history_start"):
                if value(fact) is None:
                    self._reject(fact, "unknown", "the order and start of histories of several samples")
        return Contract(
            self._model.file.stem, self._reading.convention,
            {name: self._reading.facts.get(name, UNKNOWN) for name in FACTS}, self._model,
            self._known(names, "joints"), self._period(), terms, str(value("history_order")),
            str(value("history_start")), outputs, zero, self._per_joint("action_scale", needed=acts),
            zero if relative else self._per_joint("action_offset", needed=acts),
            self._bounds("action_clip"), self._bounds("position_clip"), gains[0], gains[1], self._ranges(),
            value("gait"), feedback, self._reading.initial, constants,
        )  # fmt: skip

    def _file_joints(self) -> tuple[str, ...]:
        """Return the names of joints in the file; stand-ins if they are unknown."""
        names, motors = list(self._value("joints") or ()), self._value("motor_order")
        if not names:
            size = max((tensor.size for tensor in self._model.outputs.values()), default=1)
            self._reject("joints", "unknown", f"the names of {'all motors, in their order' if motors else 'joints'}")
            return tuple(f"joint {i}" for i in range(len(motors or range(size))))
        if motors is not None:
            if len(names) <= max(motors):
                self._reject("joints", f"{len(names)} names", f"{max(motors) + 1}, all motors in their order")
            names = [names[i] if i < len(names) else f"motor {i}" for i in motors]
        renamed = [self._rename.get(name, name) for name in names]
        for name in sorted({name for name in renamed if renamed.count(name) > 1}):
            self._reject(f"joints {name}", "twice", "each joint once")
        for name in self._rename:
            if name not in names:
                self._reject(f"joint_names {name}", "no joint of the policy", f"one of {', '.join(names)}")
        return tuple(names)

    def _known(self, names: Iterable[str], fact: str) -> tuple[str, ...]:
        """Return the robot's names of joints; rejects those that it does not have."""
        found = tuple(self._rename.get(name, name) for name in names)
        for name in found if self._value("joints") else ():
            if name not in self._robot.index:
                near = difflib.get_close_matches(name, self._robot.joints, n=1, cutoff=0.4)
                like = f" (similar: {near[0]})" if near else ""
                where = f"in {fact}, no joint of {self._robot.name}"
                self._reject(f"joint_names {name}", where, f"its name there{like}")
        return found

    def _per_joint(self, fact: str, *, needed: bool) -> FloatArray:
        """Return (m,) numbers out of one number, a list or a mapping; zeros if they are missing."""
        value, names = self._value(fact), self._names
        if value is None:
            if needed:
                self._reject(fact, "unknown", "a number for each joint")
            return np.zeros(len(names))
        if isinstance(value, Mapping):
            for name in sorted(set(names) ^ set(value)):
                self._reject(f"{fact} of {name}", value.get(name, "unknown"), "a number for each joint of the policy")
            value = [value.get(name, 0.0) for name in names]
        found = np.array(value, float)
        if found.ndim and found.shape != (len(names),):
            self._reject(fact, f"{found.size} values", f"{len(names)}, one for each of joints")
            return np.zeros(len(names))
        found = np.broadcast_to(found, len(names))
        lowest, highest = self._limits(fact)
        for i in np.flatnonzero(~((found >= lowest) & (found <= highest) & np.isfinite(found))):
            limits = f"a number from {lowest[i]:.3g} to {highest[i]:.3g}, {self._robot.name}'s limits"
            self._reject(f"{fact} of {names[i]}", f"{found[i]:g}", limits)
        return found

    def _limits(self, fact: str) -> FloatArray:
        """Return (2, m) limits of a fact's values: of positions the robot's [rad], of gains 0."""
        limits = np.array([[0.0 if fact in _GAINS else -np.inf, np.inf]] * len(self._names)).T
        for i, name in enumerate(self._names if fact == "default_position" else ()):
            if (joint := self._robot.index.get(self._rename.get(name, name))) is not None:
                limits[:, i] = self._robot.lower[joint] - _BEYOND, self._robot.upper[joint] + _BEYOND
        return limits

    def _period(self) -> float:
        period, tick = self._value("period"), self._robot.control_period
        if period is None:
            self._reject("period", "unknown", "the time between acts")
        elif not tick - _TOLERANCE <= (period := float(period)) <= _LONGEST:
            self._reject("period", f"{period:g}", f"{tick:g} to {_LONGEST:g} s; it is no frequency")
        elif abs(round(period / tick) * tick - period) > _TOLERANCE:
            self._reject("period", f"{period:g} s", f"a multiple of {self._robot.name}'s control period, {tick:g} s")
        return period or tick

    def _bounds(self, fact: str) -> FloatArray:
        """Return (2, m) lower and upper bounds; infinite if none are stated."""
        count, value = len(self._names), self._value(fact)
        found = np.array([[-np.inf, np.inf]] if value is None else value, float)
        if found.shape not in {(1, 2), (count, 2)} or not np.all(found[:, 0] <= found[:, 1]):
            self._reject(fact, repr(value), f"[[least, largest]], or {count} of them")
            return np.zeros((2, count))
        return np.broadcast_to(found.T, (2, count))

    def _ranges(self) -> FloatArray:
        stated = self._value("command_ranges") or {}
        found = np.array([stated.get(name) or (-np.inf, np.inf) for name in ("vx", "vy", "wz")], float).T
        if not np.all(found[0] <= found[1]):
            self._reject("command_ranges", stated, "[least, largest] of each")
        return found

    def _connections(self) -> tuple[dict[str, str], dict[str, FloatArray]]:
        """Return the outputs that are fed back by input, and the constants."""
        inputs, outputs = self._model.inputs, self._model.outputs
        if self._value("feedback") is None:  # recurrent networks: h_in, c_in and h_out, c_out
            pairs = {name: f"{name.removesuffix('_in')}_out" for name in inputs if name.endswith("_in")}
            found = {name: output for name, output in pairs.items() if output in outputs}
            self._reading.state("feedback", found or None, Source.DEFAULT, "NAME_out is the next NAME_in")
        feedback: dict[str, str] = self._value("feedback") or {}
        for name, output in feedback.items():
            one, other = inputs.get(name), outputs.get(output)
            if one is None or other is None or one.size != other.size:
                sizes = [each and each.size for each in (one, other)]
                self._reject(f"feedback.{name}", f"{output}, sizes {sizes}", "an input and an output of one size")
        constants = {name: np.array(each, float) for name, each in (self._value("constants") or {}).items()}
        for name, values in constants.items():
            if name not in inputs or inputs[name].size != values.size:
                self._reject(f"constants.{name}", f"{values.size} values", "an input of the model of that size")
        return feedback, constants

    def _outputs(self, feedback: Mapping[str, str]) -> Outputs:
        outputs = self._model.outputs
        if self._value("outputs") is None:
            free = [name for name in outputs if name not in feedback.values()]
            likely = [name for name in free if name in _ACTIONS] or free
            if len(likely) != 1:
                self._reject("outputs", ", ".join(free) or "none", "the name of the action")
                return {}
            self._reading.state("outputs", {"action": likely[0]}, Source.DEFAULT, "the only one, or by its name")
        found: Outputs = {}
        for role, each in self._value("outputs").items():
            name, joints = (each["output"], each["joints"]) if isinstance(each, dict) else (each, self._names)
            if name not in outputs or outputs[name].size != len(joints):
                size = outputs[name].size if name in outputs else "none"
                self._reject(f"outputs.{role}", f"{name}, size {size}", f"an output of size {len(joints)}, the joints'")
            if sorted(joints) != sorted(self._names):
                odd = ", ".join(sorted(set(joints) ^ set(self._names)))
                self._reject(f"outputs.{role}", f"other joints: {odd}", "the joints of the policy")
            order = [list(joints).index(joint) for joint in self._names if joint in joints]
            found[role] = (name, np.array(order, np.intp))
        if not {"action", "position"} & set(found):
            self._reject("outputs", ", ".join(found) or "none", "an action or position")
        return found

    def _terms(self, zero: Mapping[str, float], free: list[str]) -> tuple[Term, ...]:
        """Bind the terms of the observation, and compare their sizes with those of the model's inputs."""
        stated: tuple[TermFact, ...] = self._value("observation") or ()
        if not stated:
            self._reject("observation", "unknown", f"terms in the order of the input, of {', '.join(TERMS)}")
        for each in stated:
            if each.term not in TERMS:
                self._reject(f"observation {each.name or each.term}", "not known here", f"terms of {', '.join(TERMS)}")
        before = len(self._reading.problems)
        terms = tuple(self._bind(each, zero, free) for each in stated if each.term in TERMS)
        for name in free if len(terms) == len(stated) > 0 and len(self._reading.problems) == before else ():
            parts = [(term.name, term.size * term.history) for term in terms if term.input == name]
            if (size := sum(each for _, each in parts)) != self._model.inputs[name].size:
                found = f"{size} numbers ({', '.join(f'{term} {each}' for term, each in parts) or 'no terms'})"
                self._reject("observation", found, f"{self._model.inputs[name].size}, the size of input {name!r}")
        return terms

    def _bind(self, stated: TermFact, zero: Mapping[str, float], free: list[str]) -> Term:
        about, names = f"observation {stated.name or stated.term}", stated.joints or self._names
        source = stated.input or (free[0] if len(free) == 1 else "")
        if source not in free:
            self._reject(about, f"input {source!r}", f"an input of the model, of {', '.join(free)}")
        gait = self._value("gait") or {}
        sizes = {"joints": len(names), "action": len(self._names), "feet": len(gait.get("offsets", (0, 0)))}
        kind = TERMS[stated.term][0]
        size = kind if isinstance(kind, int) else sizes.get(kind, len(stated.value or ()))
        if stated.size not in {None, size}:
            self._reject(about, f"size {stated.size}", size)
        affine = {key: np.atleast_1d(np.array(getattr(stated, key), float)) for key in ("scale", "offset")}
        for key, each in affine.items():
            if each.size not in {1, size} or not np.isfinite(each).all():
                self._reject(about, f"{key} {getattr(stated, key)}", f"1 or {size} numbers")
        if stated.clip is not None and not stated.clip[0] < stated.clip[1]:
            self._reject(about, f"clip {stated.clip}", "[least, largest]")
        order = self._value("quaternion_order") if stated.term == "base_orientation" else "wxyz"
        if order not in {"wxyz", "xyzw"}:
            self._reject("quaternion_order", order or "unknown", "wxyz or xyzw")
        if stated.term == "joint_position_relative" and (odd := set(names) - set(zero)):
            self._reject(about, ", ".join(sorted(odd)), "joints with a default position")
        joints = self._known(names, about) if stated.joints else tuple(self._rename.get(name, name) for name in names)
        index = np.array([self._robot.index.get(name, 0) for name in joints], np.intp)
        zeros, value = np.array([zero.get(name, 0.0) for name in names]), np.array(stated.value or (), float)
        return Term(
            stated.term, source, size, affine["scale"], affine["offset"], stated.clip, stated.history, index, zeros,
            value, str(order),
        )  # fmt: skip
