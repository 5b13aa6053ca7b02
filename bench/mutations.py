"""Random mutations of the package, and how many of them the tests notice.

A mutation is one small change of one expression or statement: another comparison or arithmetic
operator, a number one larger or smaller, a negated condition, ``and`` for ``or``, a statement left
out, two arguments exchanged, a keyword left out. They are drawn uniformly from all of ``fastatt``
outside ``kernels``. Annotations, texts of messages and code for type checkers stay; so do the
encoding of files, ``strict=`` of ``zip``, and the order of the arguments of ``max`` and ``min``.

Each is made in a copy of the checkout, where the tests that touch the file run until one fails.
Which these are tells a run of the suite under coverage, with a context a test. Those that execute
the changed statement run first, then those of the folder that mirrors the package's (what Numba
compiles is not seen by coverage), then those that execute another line of the file.

    pip install -e '.[test]' pytest-cov
    pytest -p no:benchmark --cov=fastatt --cov-context=test --cov-report=
    python bench/mutations.py --count 200 --seed 1

prints each mutation with its outcome, and how many were noticed. Outcomes are kept in ``--folder``,
and a second call goes on from there. Without coverage data the mirroring folder runs alone.
"""

from __future__ import annotations

import argparse
import ast
import copy
import json
import os
import random
import shutil
import sqlite3
import subprocess
import sys
from collections import Counter
from pathlib import Path
from time import monotonic
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parents[1]
SMALL = bool(os.environ.get("FASTATT_SMOKE"))
OPERATORS = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq, ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Mod: ast.Mult,
    ast.FloorDiv: ast.Mult, ast.Pow: ast.Mult, ast.And: ast.Or, ast.Or: ast.And,
}  # fmt: skip
SYMMETRIC = ("max", "min", "np.maximum", "np.minimum")
REFUSALS = "tests/refusals"  # of all packages
TESTS_BESIDE = {"fastatt/engine": "tests/propagation", "fastatt/codegen": "tests/engine"}


class Mutation(NamedTuple):
    """``file`` with ``old``, at ``begin`` (in bytes), replaced by ``new``."""

    file: str
    lines: range  # of the statement
    begin: int
    old: str
    new: str


def changes(node: ast.AST) -> list[ast.AST]:
    """All small changes of a node itself; those of its parts are theirs."""
    found: list[ast.AST] = []

    def change(**fields: object) -> None:
        found.append(copy.copy(node))
        vars(found[-1]).update(fields)

    match node:
        case ast.Compare(ops=[operator]):
            change(ops=[OPERATORS[type(operator)]()])
        case ast.BinOp(op=operator) | ast.BoolOp(op=operator) if type(operator) in OPERATORS:
            change(op=OPERATORS[type(operator)]())
        case ast.Constant(value=bool()):
            change(value=not node.value)
        case ast.Constant(value=int() | float()):
            change(value=node.value + 1)
            change(value=node.value - 1)
        case ast.UnaryOp(op=ast.USub() | ast.Not()):
            found.append(node.operand)
        case ast.If() | ast.While() | ast.IfExp():
            change(test=ast.UnaryOp(ast.Not(), node.test))
        case ast.Call():
            starred = any(isinstance(a, ast.Starred) for a in node.args)
            if len(node.args) > 1 and not starred and ast.unparse(node.func) not in SYMMETRIC:
                change(args=[node.args[1], node.args[0], *node.args[2:]])
            for keyword in parts(node):
                if isinstance(keyword, ast.keyword):
                    change(keywords=[k for k in node.keywords if k is not keyword])
        case ast.Expr(value=ast.Call()) | ast.AugAssign() | ast.Raise() | ast.Break():
            found.append(ast.Pass())
    return found


def parts(node: ast.AST) -> list[ast.AST]:
    """The parts of a node without what only readers and type checkers see."""
    unseen = {"annotation", "returns", "type_params"}
    if isinstance(node, ast.Raise):
        unseen.add("exc")
    fields = [value for name, value in ast.iter_fields(node) if name not in unseen]
    nodes = [x for field in fields for x in (field if isinstance(field, list) else [field])]
    found = []
    for part in nodes:
        match part:
            case ast.JoinedStr() | ast.Expr(value=ast.Constant()):
                pass
            case ast.keyword(arg="encoding" | "strict"):
                pass
            case ast.If(test=ast.Name(id="TYPE_CHECKING")) | ast.Call(func=ast.Name(id="cast")):
                pass
            case ast.AST():
                found.append(part)
    return found


def mutations(file: Path) -> list[Mutation]:
    """All mutations of a file."""
    source = file.read_bytes()
    name = file.relative_to(ROOT).as_posix()
    starts = [0]
    for line in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    found: list[Mutation] = []

    def walk(node: ast.AST, lines: range) -> None:
        if isinstance(node, ast.stmt):
            body = getattr(node, "body", None)
            last = max(node.lineno, body[0].lineno - 1) if body else node.end_lineno
            lines = range(node.lineno, last + 1)
        for new in changes(node):
            here, there = node, new
            if isinstance(node, (ast.If, ast.While)):
                here, there = node.test, new.test
            begin = starts[here.lineno - 1] + here.col_offset
            old = source[begin : starts[here.end_lineno - 1] + here.end_col_offset].decode()
            text = ast.unparse(ast.fix_missing_locations(there))
            text = f"({text})" if isinstance(here, ast.expr) else text
            found.append(Mutation(name, lines, begin, old, text))
        for part in parts(node):
            walk(part, lines)

    walk(ast.parse(source), range(1, 2))
    return found


def drawn(count: int, seed: int) -> list[Mutation]:
    """So many of all mutations outside the kernels."""
    files = sorted((ROOT / "fastatt").rglob("*.py"))
    every = [m for file in files if "kernels" not in file.parts for m in mutations(file)]
    return random.Random(seed).sample(every, count)


def run_pytest(folder: Path, *options: str, limit: float | None = None) -> Any:
    """The tests of a copy of the checkout, with caches of its own."""
    caches = {name: str(folder / f".{name}") for name in ("FASTATT_CACHE", "NUMBA_CACHE_DIR")}
    variables = {**os.environ, **caches, "PYTHONPATH": ".", "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:benchmark", *options]
    return subprocess.run(
        command, cwd=folder, env=variables, capture_output=True, text=True, check=False,
        timeout=limit,
    )  # fmt: skip


def tests_of(mutation: Mutation, coverage: Path) -> list[str]:
    """The tests that touch the file; those that execute the statement first."""
    package = Path(mutation.file).parent.as_posix()
    beside = package.replace("fastatt", "tests"), REFUSALS, TESTS_BESIDE.get(package)
    folders = tuple(filter(None, beside))
    if not coverage.exists():
        return [*folders]
    with sqlite3.connect(coverage) as data:
        tests = [context for (context,) in data.execute("SELECT context FROM context")]
        executed = data.execute(
            "SELECT context, numbits FROM line_bits JOIN context ON context.id = context_id "
            "JOIN file ON file.id = file_id WHERE path LIKE ?", (f"%/{mutation.file}",),
        ).fetchall()  # fmt: skip
    here = package != "fastatt"
    ranks = {test: 2 for test in tests if here and test.startswith(folders)}
    for test, bits in executed:
        runs = any(n // 8 < len(bits) and bits[n // 8] >> n % 8 & 1 for n in mutation.lines)
        ranks[test] = (0 if test.startswith(folders) else 1) if runs else ranks.get(test, 3)
    ordered = sorted(filter(None, ranks), key=ranks.__getitem__)
    return [*dict.fromkeys(test.rpartition("|")[0] for test in ordered)]


def outcome(mutation: Mutation, folder: Path, tests: list[str], limit: float) -> str:
    """Run the tests with a mutation: which one fails first, or that none does."""
    file = folder / mutation.file
    source = file.read_bytes()
    end = mutation.begin + len(mutation.old.encode())
    file.write_bytes(source[: mutation.begin] + mutation.new.encode() + source[end:])
    (folder / "ids").write_text("\n".join(tests), encoding="utf-8")
    try:
        done = run_pytest(folder, "-x", "--assert=plain", "@ids", limit=limit)
    except subprocess.TimeoutExpired:
        return "time limit: none failed before"
    finally:
        shutil.copy2(ROOT / mutation.file, file)
    failed = [x for x in done.stdout.splitlines() if x.startswith(("FAILED", "ERROR"))]
    # of pytest: no such tests, unless the mutation ends their import
    if done.returncode in (4, 5) and "ERROR collecting" not in done.stdout:
        raise RuntimeError(f"{mutation}: {done.stdout}{done.stderr}")
    return f"noticed: {' '.join(failed) or done.returncode}" if done.returncode else "survived"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--count", type=int, default=1 if SMALL else 200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--limit", type=float, default=600.0, help="s for a mutation's tests")
    parser.add_argument("--coverage", type=Path, default=ROOT / ".coverage")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="begin none after this")
    parser.add_argument("--folder", type=Path, default=ROOT / "results/mutations")
    given = parser.parse_args()
    folder = given.folder.resolve()
    unneeded = shutil.ignore_patterns(".git", ".venv", ".*_cache*", "results", "__pycache__")
    shutil.copytree(ROOT, folder, ignore=unneeded, dirs_exist_ok=True)
    report = folder / "outcomes.jsonl"
    outcomes = dict(map(json.loads, report.read_text().splitlines())) if report.exists() else {}
    # coverage may be of other tests than these
    listed = run_pytest(folder, "--collect-only").stdout.splitlines()
    begun = monotonic()
    for mutation in drawn(given.count, given.seed):
        if monotonic() - begun > given.seconds:
            break
        place = f"{mutation.file}:{mutation.lines[0]} (byte {mutation.begin})"
        key = f"{place}: {mutation.old!r:.60} -> {mutation.new!r:.60}"
        if key not in outcomes:
            tests = tests_of(mutation, given.coverage)
            if given.coverage.exists():
                tests = [*filter(set(listed).__contains__, tests)]
            outcomes[key] = outcome(mutation, folder, tests, given.limit)
            with report.open("a", encoding="utf-8") as lines:
                lines.write(json.dumps([key, outcomes[key]]) + "\n")
        print(key, outcomes[key], sep="\n    ", flush=True)
    print(Counter(text.partition(":")[0] for text in outcomes.values()))


if __name__ == "__main__":
    main()
