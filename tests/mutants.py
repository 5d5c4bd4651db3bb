"""Mutation score of a package: how many small wrong changes its fast tests notice (``make mutants``).

cosmic-ray makes one change at a time in a checkout of HEAD, in build/mutants, and runs the package's tests there.
Packages are in pyproject.toml, ``tool.mutants``.
"""

from __future__ import annotations

import argparse
import random
import subprocess
import sys
import tomllib
from pathlib import Path

from cosmic_ray.work_db import WorkDB, use_db
from cosmic_ray.work_item import WorkerOutcome, WorkResult

from harness.places import REPOSITORY

TREE = REPOSITORY / "build" / "mutants"
BIN = Path(sys.executable).parent
CONFIG = """[cosmic-ray]
module-path = "{folder}"
timeout = 300.0
excluded-modules = {without}
test-command = "{python} -B -m pytest -x -q -p no:cacheprovider {tests}"
[cosmic-ray.distributor]
name = "local"
"""


def configuration(package: str) -> str:
    """Of cosmic-ray."""
    tables = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["tool"]["mutants"]
    if package not in tables:
        sys.exit(f"package {package!r}; expected one of {', '.join(tables)}")
    table = tables[package]
    without = [f"{each}*" if each.endswith(("/", "_")) else each for each in table.get("without", ())]
    tests = sorted(str(path.relative_to(TREE)) for pattern in table["tests"] for path in TREE.glob(pattern))
    return CONFIG.format(folder=table["folder"], without=without, python=sys.executable, tests=" ".join(tests))


def skip_all_but(count: int, seed: int, session: Path) -> None:
    """Mark all changes of a session as skipped, except a sample."""
    with use_db(session, WorkDB.Mode.open) as database:
        jobs = [item.job_id for item in database.work_items]
        sample = set(random.Random(seed).sample(sorted(jobs), min(count, len(jobs))))
        print(f"{len(sample)} of {len(jobs)} changes", flush=True)
        skipped = WorkResult(worker_outcome=WorkerOutcome.SKIPPED, output="not in the sample")
        database.set_multiple_results([job for job in jobs if job not in sample], skipped)


def main() -> None:
    """Print each change that the tests have not noticed, and the share that they have."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("package")
    parser.add_argument("--sample", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()

    def run(*command: str, folder: Path = TREE) -> None:
        subprocess.run(command, cwd=folder, check=True)

    run("git", "worktree", "prune", folder=REPOSITORY)
    if not TREE.exists():
        run("git", "worktree", "add", "--quiet", "--detach", str(TREE), folder=REPOSITORY)
    run("git", "checkout", "--quiet", "--force", "--detach", "HEAD")
    config, session = TREE / "mutants.toml", TREE / "mutants.sqlite"
    config.write_text(configuration(options.package))
    ray = str(BIN / "cosmic-ray")
    run(ray, "baseline", str(config))
    run(ray, "init", "--force", str(config), str(session))
    skip_all_but(options.sample, options.seed, session)
    run(ray, "exec", str(config), str(session))
    run(str(BIN / "cr-report"), "--surviving-only", "--show-diff", str(session))
    run(str(BIN / "cr-rate"), str(session))


if __name__ == "__main__":
    main()
