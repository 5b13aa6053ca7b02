"""Run every command that a page names, and every script of bench/, small.

Commands run in a copy of the checkout, with ``FASTATT_SMOKE=1``: scripts of ``bench/`` and targets
of the Makefile then take few bodies and few repeats. Targets that ``.ci/run`` calls itself, tests
and benches (``make test``, ``make bench-smoke``) and installations are not run again.
"""

from __future__ import annotations

import gzip
import os
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from time import perf_counter

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.append(str(ROOT / "tests"))

from test_readme import PAGES, in_blocks, in_text  # noqa: E402

#: what ``.ci/run`` or a test does by itself; the leaderboard, which needs the other libraries; and
#: what takes minutes
ELSEWHERE = (
    ".ci/run", "make commands", "make docs", "make format", "make fuzz", "make layers",
    "make leaderboard", "make pythons",
    "make test", "make venv", "pip ", "pytest ",
    "python bench/leaderboard.py", "python bench/mutations.py",
    "python bench/page_figures.py",
)  # fmt: skip
LIMIT = 900  # s, for a command that hangs


def commands() -> list[str]:
    """The commands of all pages, and scripts, each once, but for those that CI runs elsewhere."""
    pages = [*PAGES, *sorted((ROOT / "bench").glob("*.md"))]
    texts = [page.read_text(encoding="utf-8") for page in pages]
    named = dict.fromkeys(c for text in texts for c in (*in_blocks(text), *in_text(text)))
    targets = (ROOT / "Makefile").read_text(encoding="utf-8")
    for script in sorted((ROOT / "bench").glob("*.py")):
        is_command = "__main__" in script.read_text(encoding="utf-8")
        if is_command and not any(script.name in text for text in (*named, targets)):
            named[f"python bench/{script.name}"] = None
    return [c for c in named if not c.startswith(ELSEWHERE)]


def write_inputs(folder: Path) -> None:
    """A gyro log that begins at rest, and one without units, whose stamps are in µs."""
    t = np.arange(0.0, 20.0, 0.01)
    rates = np.where(t[:, None] < 6.0, 0.0, 0.3) * np.sin(np.outer(t, (0.5, 0.9, 1.3)))
    table = np.column_stack([t, rates])
    head = "time [s],gyro_x [rad/s],gyro_y [rad/s],gyro_z [rad/s]"
    np.savetxt(folder / "LOG.csv", table, delimiter=",", header=head, comments="")
    table[:, 0] *= 1e6
    (folder / "FOLDER").mkdir()
    for name in ("MONDAY.csv", "TUESDAY.csv"):
        shutil.copy(folder / "LOG.csv", folder / name)
    head = "time,gyro_x,gyro_y,gyro_z"
    np.savetxt(folder / "no_units.csv", table, delimiter=",", header=head, comments="")
    (folder / "LOG.csv.gz").write_bytes(gzip.compress((folder / "LOG.csv").read_bytes()))


def run(command: str, folder: Path) -> str | None:
    """What a command that failed printed, else None."""
    program = command.replace("python ", f"{sys.executable} ", 1).removesuffix(" BROAD")
    program = program.replace("/scratch", str(folder / "scratch"))
    if "--time-unit" in command:  # refused where it contradicts the log
        program = program.replace("LOG.csv", "no_units.csv")
    # the environment is the checkout's: not to be made again from the copy
    program = program.replace("make ", "make -o .venv/.test -o .venv/.trade ", 1)
    if program.startswith("fastatt trade"):
        program += " --quick --bodies 64" + " --methods rk4,exact" * ("--methods" not in program)
    variables = {
        "FASTATT_SMOKE": "1",
        # which one of the commands removes
        "FASTATT_CACHE": str((folder if "cache" in command else ROOT) / ".fastatt_cache"),
        "NUMBA_CACHE_DIR": str(ROOT / ".numba_cache"),
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": str(folder),
    }
    begun = perf_counter()
    try:
        done = subprocess.run(
            ["bash", "-c", program], cwd=folder, env={**os.environ, **variables}, timeout=LIMIT,
            capture_output=True, text=True, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return f"{command}: not done after {LIMIT} s"
    print(f"{perf_counter() - begun:6.1f} s  {command}", flush=True)
    if done.returncode == 0:
        return None
    return f"{command}: exit status {done.returncode}\n{done.stdout[-1000:]}{done.stderr[-2000:]}"


def main() -> int:
    """Run them all; 1 where one failed."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "fastatt"
        ignored = shutil.ignore_patterns(".git", ".venv*", ".*_cache", "results", "__pycache__")
        shutil.copytree(ROOT, folder, ignore=ignored)
        (folder / ".venv").symlink_to(ROOT / ".venv")
        write_inputs(folder)
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            all_commands = commands()
            failures = [x for x in pool.map(lambda c: run(c, folder), all_commands) if x]
    print(f"{len(all_commands)} commands, {len(failures)} failed")
    print("\n".join(failures), file=sys.stderr)
    return int(bool(failures))


if __name__ == "__main__":
    sys.exit(main())
