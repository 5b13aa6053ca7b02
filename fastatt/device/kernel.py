"""The run of a job as Python text that Numba compiles for a GPU, with one thread for each body.

The computation is that of ``fastatt.engine``, in the same order, with the state in registers.
Products and fused products are written as calls that no compiler merges, so that a kernel rounds
like a processor with fused multiplications; library functions (``exp``, ``log`` ...) are those of
the device.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import Any

import numpy as np
from numba import config

from fastatt.engine.job import Job
from fastatt.engine.status import DIAGNOSTICS
from fastatt.tracing import source
from fastatt.tracing.finished import Flat, Forms
from fastatt.tracing.nodes import LIBRARY, Node
from fastatt.tracing.user import MOST_OPERATIONS

#: arguments of a kernel before its tables
ARGUMENTS = (
    "q_rows", "y_rows", "p_rows", "x_rows", "out", "norm_error", "watch", "known", "stages", "t0",
    "step", "last_edge", "most_quiet", "first", "last", "n_steps", "save_every", "slot", "restore",
    "origin", "block", "begins",
)  # fmt: skip
_FUSED = ("fma", "fms", "fnma")


def _negative(x: ast.expr) -> ast.expr:
    return ast.UnaryOp(ast.USub(), x)


def _larger(x: ast.expr, y: ast.expr) -> ast.expr:
    """The larger of two numbers, or NaN."""
    above = ast.BinOp(
        ast.Compare(x, [ast.Gt()], [y]), ast.BitOr(), ast.Compare(x, [ast.NotEq()], [x])
    )
    return source.call_of("selp", above, x, y)


class _Text(source.GraphText):
    """A graph as statements of a kernel, its constants in ``constants``.

    Numbers in the text would be of double precision, and take Numba longer than names.
    """

    def __init__(self, flat: Flat, prefix: str, constants: dict[str, Any]) -> None:
        self._constants = constants
        super().__init__(flat, prefix)

    def _expression(self, node: Node, name: str | None) -> tuple[ast.expr, int]:
        if node.op == "const":
            value = source.SCOPE[node.kind](node.args[0])
            known = f"{node.kind}_{value.tobytes().hex()}"
            self._constants[known] = value
            return ast.Name(known), 0
        return super()._expression(node, name)

    def _operation(self, node: Node, args: list[ast.expr]) -> ast.expr:
        op = node.op
        narrow = "f" if node.kind == "single" else ""
        if op in _FUSED:
            x, y, z = args
            x = _negative(x) if op == "fnma" else x
            return source.call_of(f"fma{narrow}", x, y, _negative(z) if op == "fms" else z)
        if op in ("*", "rint", "floor"):
            return source.call_of({"*": "product"}.get(op, op) + narrow, *args)
        if op == "select":
            return source.call_of("selp", *args)
        if op == "larger":
            return _larger(*args)
        if op == "gather":
            table = ast.Subscript(
                ast.Name(source.table_name(node.args[0])), source.call_of("whole", *args)
            )
            return source.call_of(node.kind, table)
        return super()._operation(node, args)


class _Writer:
    """Writes the lines of a job's kernel."""

    def __init__(self, job: Job) -> None:
        self.job, self.formulas = job, job.formulas
        self.lines: list[str] = []
        self.constants: dict[str, Any] = {}
        self._indent = 0

    def _add(self, *lines: str) -> None:
        self.lines += [" " * self._indent + line for line in lines]

    @contextmanager
    def _under(self, line: str) -> Iterator[None]:
        """A line that begins a block, and the block."""
        self._add(line)
        self._indent += 4
        yield
        self._indent -= 4

    def _formulas(self, flat: Flat, prefix: str, *targets: str) -> list[str]:
        """Write a graph; its first results get names, the others are returned."""
        text = _Text(flat, prefix, self.constants)
        self._add(*text.lines)
        n = len(targets)
        if n:
            self._add(f"{', '.join(targets)}, = {', '.join(text.results[:n])},")
        return text.results[n:]

    def _names(self, group: str, n: int) -> list[str]:
        return [f"{group}{i}" for i in range(n)]

    def text(self) -> str:
        """The whole kernel."""
        formulas = self.formulas
        tables = [source.table_name(name[1]) for name in formulas.resources]
        state = self._names("x", formulas.size)
        with self._under(f"def kernel({', '.join([*ARGUMENTS, *tables])}):"):
            self._add("body = cuda.grid(1)", "selp = cuda.selp")
            self._add("if body >= x_rows.shape[0]:", "    return")
            self._begin(state)
            self._add("n = first", "due = begins")
            with self._under("while True:"):
                with self._under("if due:"):
                    self._save()
                self._add("if n >= last:", "    break", "gone = (n - origin) % save_every")
                self._add("stop = min((n // block + 1) * block, last, n + save_every - gone)")
                if formulas.project is not None:
                    self._add(
                        "if restore > 0:", "    stop = min(stop, (n // restore + 1) * restore)"
                    )
                self._block(state)
                self._add("if turn > most:", "    most = turn", "n = stop")
                if formulas.project is not None:
                    with self._under("if restore > 0 and n % restore == 0:"):
                        (far,) = self._formulas(formulas.project, "m", *state)
                        self._worse(1, far)
                self._add("due = (n - origin) % save_every == 0 or n == n_steps")
            self._add(*(f"x_rows[body, {i}] = {x}" for i, x in enumerate(state)))
            self._add("watch[0, body] = most")
        return "\n".join([*self.lines, ""])

    def _begin(self, state: list[str]) -> None:
        """The body's numbers, and its initial state."""
        job, formulas = self.job, self.formulas
        kind = job.kind
        self._add(f"h = {kind}(step)", "k = h", f"edge = {kind}(last_edge)", "t = t0")
        for array, name, first, last in (
            ("q_rows", "y", 0, formulas.coordinates),
            ("y_rows", "y", formulas.coordinates, formulas.given),
            ("p_rows", "p", 0, formulas.parameters),
        ):
            if last > first:
                self._add(f"row = min(body, {array}.shape[0] - 1)")
            self._add(*(f"{name}{i} = {array}[row, {i - first}]" for i in range(first, last)))
        constants = self._names("c", len(formulas.constants.results))
        if constants:
            self._formulas(formulas.constants, "d", *constants)
        extras = self._names("e", formulas.extras)
        kept = self._names("invariants", formulas.invariants)
        rest = self._formulas(formulas.begin, "b", *state, *extras, *kept)
        with self._under("if first > 0:"):
            self._add(*(f"{x} = x_rows[body, {i}]" for i, x in enumerate(state)))
            self._add("most = watch[0, body]")
        with self._under("else:"):
            self._add(
                *(f"watch[{i}, body] = 0.0" for i in range(len(DIAGNOSTICS))), f"most = {kind}(0.0)"
            )
        if not job.known:
            return
        self._add("row = min(body, known.shape[0] - 1)")
        self._add(
            f"bound = {rest[0] if job.bounds else f'{kind}(product(known[row], known[row]))'}"
        )
        self._add(f"quiet = bound <= {kind}(product(most_quiet, most_quiet))")
        self._add("if quiet and first == 0:", "    most = bound")

    def _save(self) -> None:
        """Save the state after n steps, and the errors of its invariants."""
        formulas = self.formulas
        size = formulas.handed_out
        self._add("span = product(double(n), step)", "t = t0 + span")
        self._add(f"since = {self.job.kind}(span)")
        found = self._formulas(formulas.save, "s")
        self._add("save = (n - origin - 1) // save_every + slot if n > origin else 0")
        self._add(*(f"out[save, body, {i}] = {x}" for i, x in enumerate(found[:size])))
        self._add(f"norm_error[save, body] = {found[size]}")
        for k, value in enumerate(found[size:], 1):
            self._worse(k, f"abs({value})")

    def _worse(self, row: int, value: str) -> None:
        """Store the larger of two numbers, or NaN."""
        self._add(f"before = watch[{row}, body]", f"value = {value}")
        self._add("if not (before >= value or before != before):")
        self._add(f"    watch[{row}, body] = value")

    def _block(self, state: list[str]) -> None:
        """Steps [n, stop), repeated in the any-angle form if angles are large."""
        job, formulas = self.job, self.formulas
        small_angle = (formulas.small_angle, job.monitored, "a")
        if formulas.any_angle is None:
            self._steps(state, *small_angle)
            return
        any_angle = (formulas.any_angle, True, "f")
        if job.known:
            with self._under("if quiet:"):
                self._steps(state, *small_angle)
            with self._under("else:"):
                self._steps(state, *any_angle)
            return
        start = ", ".join(self._names("start", formulas.size))
        names = ", ".join(state)
        self._add(f"{start}, = {names},")
        self._steps(state, *small_angle)
        with self._under(f"if turn > {math.pi**2!r}:"):
            self._add(f"{names}, = {start},")
            self._steps(state, *any_angle)

    def _steps(self, state: list[str], forms: Forms, noted: bool, prefix: str) -> None:
        job = self.job
        flat = forms.monitored if noted else forms.plain
        self._add(f"turn = {job.kind}(0.0)")
        with self._under("for m in range(n, stop):"):
            if not job.method.stages:
                self._step(state, flat, noted, prefix, "double(m)")
                return
            with self._under("for i in range(stages.shape[0]):"):
                self._add(
                    *(
                        f"{x} = {job.kind}(product(stages[i, {k}], step))"
                        for k, x in enumerate("hk")
                    )
                )
                self._step(state, flat, noted, prefix, "double(m) + stages[i, 2]")

    def _step(self, state: list[str], flat: Flat, noted: bool, prefix: str, time: str) -> None:
        if ("t",) in flat.inputs():
            self._add(f"t = t0 + product({time}, step)")
        rest = self._formulas(flat, prefix, *state)
        if noted:
            (z,) = rest
            self._add(f"turn = selp({z} > turn, {z}, turn)")  # NaN is noticed in the state


def text(job: Job) -> tuple[str, dict[str, Any]]:
    """The kernel of a job as Python text, ``kernel(*ARGUMENTS, *tables)``, and its constants.

    Raises ``ValueError`` for formulas that call a function which is not traced, and for per-body
    step sizes, saves at given times, breakpoints, sampled controllers and a shorter last step.
    """
    if job.own_steps:
        raise ValueError(
            'device: found "cuda" with a dt of each body, save_at, breakpoints, a sampled '
            "controller or a t_end of no whole number of steps; accepted: one dt, n_steps, "
            "save_every"
        )
    for group, function in job.formulas.resources:
        if group == "function":
            raise ValueError(
                f'device: found "cuda" with {getattr(function, "name", function)}, a function that '
                "is compiled for the processor alone; accepted: functions whose branches and "
                "loops are known beforehand, of + - * / and the functions of math, with up to "
                f"{MOST_OPERATIONS} operations in all evaluations of a step"
            )
    writer = _Writer(job)
    return writer.text(), writer.constants


@lru_cache(maxsize=256)
def kernel_of(job: Job) -> Any:
    """The kernel of a job for Numba, which compiles it for a device at its first launch."""
    from numba import cuda

    program, constants = text(job)
    scope: dict[str, Any] = {**_scope(), **constants, "cuda": cuda}
    exec(compile(program, "<kernel>", "exec"), scope)
    return cuda.jit(scope["kernel"])


def _scope() -> dict[str, Any]:
    """The names in the text: Numba's functions for a device, or NumPy's in its simulator."""
    named: dict[str, Any] = {"single": np.float32, "double": np.float64, "nan": math.nan}
    if config.ENABLE_CUDASIM:
        both = {"fma": _fma, "product": np.multiply, "rint": np.rint, "floor": np.floor}
        named |= {name + narrow: f for name, f in both.items() for narrow in ("", "f")}
        return {**source.SCOPE, **named, "whole": int}
    from numba.cuda import libdevice

    return (
        named
        | {name: getattr(math, name) for name in ("sqrt", *LIBRARY)}
        | {
            "abs": math.fabs,
            "logical_not": np.logical_not,
            "fma": libdevice.fma_rn,
            "fmaf": libdevice.fmaf_rn,
            "product": libdevice.dmul_rn,
            "productf": libdevice.fmul_rn,
            "rint": libdevice.rint,
            "rintf": libdevice.rintf,
            "floor": libdevice.floor,
            "floorf": libdevice.floorf,
            "whole": np.int64,
        }
    )


def _fma(x: Any, y: Any, z: Any) -> Any:
    return x * y + z
