"""Mutation score of a package: how many small wrong changes its fast tests notice (``make mutants``).

cosmic-ray makes the changes. This samples them, and tries each with those tests alone that execute the changed
statement, the quickest first, in a fork of a process that has collected all tests. cosmic-ray's own runner starts the
whole test command for each of ten thousand changes.
"""

from __future__ import annotations

import argparse
import ast
import gc
import hashlib
import importlib.machinery
import itertools
import os
import random
import resource
import signal
import sys
import time
import tomllib
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

import coverage
import hypothesis
import pytest
from cosmic_ray import plugins
from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code

from harness.places import REPOSITORY

OUT = REPOSITORY / "build" / "mutants"
OURS = ("valor", "bifrost", "tests")
LONGEST = 10.0  # of all tests that a mutant is tried with, as they were without it, watched [s of CPU]
PATIENCE = 5.0  # with what a test waits for in vain [s]
EXTERNAL = "IN_MUTANT"  # set in the environment of a fork
ARGUMENTS = ("-q", "-p", "no:cacheprovider", "--hypothesis-profile=mutants", "-o", "timeout=0")


@dataclass(frozen=True)
class Mutant:
    """One change: an occurrence of an operator in a file."""

    file: Path
    line: int
    operator: str
    occurrence: int
    source: str = field(repr=False, compare=False)

    def code(self) -> str | None:
        """The file's text with the change; None: it changes nothing that runs."""
        made = mutate_code(self.source, plugins.get_operator(self.operator)(), self.occurrence)
        try:
            return None if made is None or _running(made) == _running(self.source) else str(made)
        except SyntaxError:
            return None

    def describe(self, code: str) -> str:
        """Where it is, and the line before and after."""
        lines = list(zip(self.source.splitlines(), code.splitlines(), strict=False))
        number, (old, new) = next((i, pair) for i, pair in enumerate(lines, 1) if pair[0] != pair[1])
        where = f"{self.file.relative_to(REPOSITORY)}:{number} {self.operator.rpartition('/')[2]}"
        return f"{where}\n    - {old.strip()}\n    + {new.strip()}"


class _Annotations(ast.NodeTransformer):
    """Takes away what annotations say: with postponed evaluation nothing of them runs."""

    def visit_arg(self, node: ast.arg) -> ast.AST:
        node.annotation = None
        return node

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        node.returns = None
        return self.generic_visit(node)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST:
        node.annotation = ast.Name("_")
        return self.generic_visit(node)


@cache
def _running(source: str) -> str:
    return ast.dump(_Annotations().visit(ast.parse(source)))


def all_mutants(files: Sequence[Path]) -> Iterator[Mutant]:
    """Every change that cosmic-ray knows."""
    operators = [name for name in plugins.operator_names() if not plugins.get_operator(name).arguments()]
    for file in files:
        source = file.read_text()
        nodes = list(ast_nodes(get_ast(source)))
        for name in operators:
            operator = plugins.get_operator(name)()
            places = itertools.chain.from_iterable(operator.mutation_positions(node) for node in nodes)
            for occurrence, ((line, _), _) in enumerate(places):
                yield Mutant(file, line, name, occurrence, source)


def statement(source: str, line: int) -> tuple[range, bool]:
    """Lines of the smallest statement around a line, and whether a function runs it."""
    lines, inside = range(1, source.count("\n") + 2), False
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.stmt):
            continue
        first, last = (
            min([node.lineno, *(each.lineno for each in getattr(node, "decorator_list", []))]),
            node.end_lineno,
        )
        if last is None or not first <= line <= last:
            continue
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            inside |= line >= node.body[0].lineno
        elif not isinstance(node, ast.ClassDef) and getattr(node, "body", None):  # of ``if`` and the like, the head
            last = max(node.lineno, node.body[0].lineno - 1)  # type: ignore[attr-defined]
        if line <= last and last - first < len(lines):
            lines = range(first, last + 1)
    return lines, inside


class Recorder:
    """While the map is made: notes how long each test takes that passes, of the CPU's time and of the wall's."""

    def __init__(self) -> None:
        self.seconds: dict[str, tuple[float, float]] = {}
        self._passed: set[str] = set()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Any:
        began, on_the_wall = time.process_time(), time.monotonic()
        try:
            return (yield)
        finally:
            if item.nodeid in self._passed:
                self.seconds[item.nodeid] = time.process_time() - began, time.monotonic() - on_the_wall

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """One that fails without any mutant says nothing of any."""
        if report.when == "call" and report.passed:
            self._passed.add(report.nodeid)


class Map:
    """Which tests execute a line, and how long each of them takes."""

    def __init__(self, name: str) -> None:
        self._data = coverage.CoverageData(str(OUT / f"{name}.coverage"))
        self._data.read()
        self._files = {os.path.realpath(path): path for path in self._data.measured_files()}
        rows = [row.split(" ", 2) for row in (OUT / f"{name}.seconds").read_text().splitlines()[1:]]
        self.seconds = {test: float(seconds) for seconds, _, test in rows}
        self.on_the_wall = {test: float(seconds) for _, seconds, test in rows}

    @staticmethod
    def make(name: str, folder: str, tests: Sequence[str]) -> None:
        """Run all tests once, with coverage; in a process of its own, for coverage must come before all imports.

        Not where nothing has changed since it was made.
        """
        state, file = _state(folder, tests), OUT / f"{name}.seconds"
        if file.exists() and file.read_text().partition("\n")[0] == state:
            return
        os.environ |= {"COVERAGE_FILE": str(OUT / f"{name}.coverage"), "COVERAGE_CORE": "ctrace"}
        recorder = Recorder()
        ended = pytest.main(
            [*tests, "-q", "-p", "no:cacheprovider", f"--cov={folder}", "--cov-context=test", "--cov-report="],
            [recorder],
        )
        if ended not in (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED):
            sys.exit(1)
        rows = [f"{cpu:.4f} {wall:.4f} {test}" for test, (cpu, wall) in recorder.seconds.items()]
        file.write_text("\n".join([state, *rows]))

    def tests(self, mutant: Mutant) -> list[str]:
        """Those that execute the mutant's statement, the quickest first, as many as fit into ``LONGEST``."""
        path = self._files.get(str(mutant.file))
        if path is None:
            return []
        by_line = self._data.contexts_by_lineno(path)
        lines, inside = statement(mutant.source, mutant.line)
        found = {test for line in lines for test in by_line.get(line, ())} - {""}
        if not found and not inside:  # executed by the import alone
            found = {test for each in by_line.values() for test in each} - {""}
        # What a fixture makes is looked at by other tests than the first one.
        modules = {name.partition("::")[0] for name in found if name.endswith("|setup")}
        names = {name.rpartition("|")[0] for name in found} & self.seconds.keys()
        names |= {test for test in self.seconds if test.partition("::")[0] in modules}
        ordered = sorted(names, key=self.seconds.__getitem__)
        totals = itertools.accumulate(self.seconds[test] for test in ordered)
        return [test for i, (test, total) in enumerate(zip(ordered, totals, strict=True)) if i == 0 or total <= LONGEST]


def _state(folder: str, tests: Sequence[str]) -> str:
    """What the tests and what they test are now."""
    files = sorted(file for root in (Path("tests"), Path(folder)) for file in root.rglob("*.py"))
    return hashlib.sha256(repr(tests).encode() + b"".join(file.read_bytes() for file in files)).hexdigest()


def exchange(file: Path, old: str, new: str) -> bool:
    """Give the one function that differs its new code, wherever it is known; whether that was all that differs."""
    before, after = (list(_functions(compile(text, str(file), "exec"))) for text in (old, new))
    if len(before) != len(after):
        return False
    pairs = [(was, now) for was, now in zip(before, after, strict=True) if _content(was) != _content(now)]
    if len(pairs) != 1:
        return False
    was, now = pairs[0]
    found = [
        each
        for each in gc.get_objects()
        if type(each) is FunctionType
        and (each.__code__.co_qualname, each.__code__.co_firstlineno) == (was.co_qualname, was.co_firstlineno)
        and os.path.realpath(each.__code__.co_filename) == str(file)
        and each.__code__.co_freevars == now.co_freevars
    ]
    for each in found:
        each.__code__ = now
    return bool(found)


def _functions(code: CodeType) -> Iterator[CodeType]:
    """Of a module and its classes, not those inside functions."""
    for each in code.co_consts:
        if isinstance(each, CodeType):
            if each.co_flags & 0x2:  # CO_NEWLOCALS
                yield each
            else:
                yield from _functions(each)


def _content(code: CodeType) -> Any:
    parts = [_content(each) if isinstance(each, CodeType) else (type(each), each) for each in code.co_consts]
    return code.co_code, code.co_names, code.co_varnames, repr(parts)


class Runner:
    """pytest's loop over its tests replaced by one over mutants, each in a fork."""

    def __init__(self, mutants: Sequence[Mutant], tests: Map, log: Path) -> None:
        self._mutants, self._tests, self._log = mutants, tests, log
        self.verdicts: Counter[str] = Counter()

    def pytest_runtestloop(self, session: pytest.Session) -> bool | None:
        """Try every mutant."""
        if EXTERNAL in os.environ:
            return None
        items = {item.nodeid: item for item in session.items}
        gc.freeze()
        with open(self._log, "w") as log:
            for mutant in self._mutants:
                code = mutant.code()
                chosen = [items[test] for test in self._tests.tests(mutant) if test in items] if code else []
                verdict = "equivalent" if not code else self._try(session, mutant, code, chosen)
                self.verdicts[verdict] += 1
                if code and verdict != "killed":
                    print(f"{verdict} [{len(chosen)} tests] {mutant.describe(code)}", file=log, flush=True)
        return True

    def _try(self, session: pytest.Session, mutant: Mutant, code: str, items: Sequence[pytest.Item]) -> str:
        if not items:
            return "uncovered"
        expected = sum(self._tests.seconds[item.nodeid] for item in items)
        pid = os.fork()
        if pid == 0:
            status = 1
            with suppress(BaseException):
                _become_quiet(limit=int(4 * expected + 12))
                status = _run(session, mutant, code, items)
            os._exit(status)
        wall = sum(self._tests.on_the_wall[item.nodeid] for item in items)
        deadline = time.monotonic() + 10 * wall + 60  # of one that waits for ever
        ended, status = 0, 0
        while not ended and time.monotonic() < deadline:
            ended, status = os.waitpid(pid, os.WNOHANG)
            time.sleep(0.01)
        with suppress(ProcessLookupError):
            os.killpg(pid, signal.SIGKILL)  # and what it has started
        if not ended:
            os.waitpid(pid, 0)
        return "survived" if ended and status == 0 else "killed"


def _become_quiet(limit: int) -> None:
    """In a fork: a process group of its own, nothing printed, so much CPU and no more [s]."""
    os.setsid()
    os.environ[EXTERNAL] = "1"
    patience = sys.modules["harness.waiting"].PATIENCE
    for name, module in list(sys.modules.items()):
        if name.startswith(("tests.", "harness.")) and getattr(module, "PATIENCE", None) == patience:
            module.PATIENCE = PATIENCE  # type: ignore[attr-defined]
    resource.setrlimit(resource.RLIMIT_CPU, (limit, limit))
    for descriptor in (1, 2):
        os.dup2(os.open(os.devnull, os.O_WRONLY), descriptor)


def _run(session: pytest.Session, mutant: Mutant, code: str, items: Sequence[pytest.Item]) -> int:
    """0 if the tests pass with the mutant. Where more than a function's code differs, all is imported anew."""
    if statement(mutant.source, mutant.line)[1] and exchange(mutant.file, mutant.source, code):
        for item, following in itertools.zip_longest(items, items[1:]):
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
            if session.testsfailed:
                return 1
        return 0
    for name in [name for name in sys.modules if name.split(".")[0] in OURS]:
        del sys.modules[name]
    original = importlib.machinery.SourceFileLoader.get_code

    def get_code(self: Any, name: str) -> CodeType | None:
        changed = os.path.realpath(self.path) == str(mutant.file)
        return compile(code, self.path, "exec") if changed else original(self, name)

    importlib.machinery.SourceFileLoader.get_code = get_code  # type: ignore[method-assign, assignment]
    return int(pytest.main([*ARGUMENTS, "-x", *(item.nodeid for item in items)]) != 0)


def main() -> None:
    """Score one package of the table ``tool.mutants``."""
    tables = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["tool"]["mutants"]
    parser = argparse.ArgumentParser(description="How many wrong changes do the tests of a package notice?")
    parser.add_argument("package", choices=tables)
    parser.add_argument("--sample", type=int, default=100, help="changes to try")
    parser.add_argument("--seed", type=int, default=0, help="of the sample")
    options = parser.parse_args()
    os.chdir(REPOSITORY)
    OUT.mkdir(parents=True, exist_ok=True)
    name, table = options.package, tables[options.package]
    tests = [str(path) for pattern in table["tests"] for path in sorted(Path().glob(pattern))]
    if os.fork() == 0:
        Map.make(name, table["folder"], tests)
        sys.exit()
    if os.wait()[1]:
        sys.exit(1)
    hypothesis.settings.register_profile(
        "mutants", deadline=None, derandomize=True, database=None,
        phases=[hypothesis.Phase.explicit, hypothesis.Phase.generate],
    )  # fmt: skip
    without = tuple(table.get("without", ()))
    files = [
        path.resolve() for path in sorted(Path(table["folder"]).rglob("*.py")) if not str(path).startswith(without)
    ]
    mutants = list(all_mutants(files))
    sample = random.Random(options.seed).sample(mutants, min(options.sample, len(mutants)))
    runner = Runner(sample, Map(name), log := OUT / f"{name}.txt")
    pytest.main([*ARGUMENTS, *tests], [runner])
    counts = runner.verdicts
    tried = counts.total() - counts["equivalent"]  # fewer than the sample after Ctrl-C
    print(f"{name}: {counts['killed']} of {tried} noticed, seed {options.seed}, of {len(mutants)}; the others: {log}")


if __name__ == "__main__":
    main()
