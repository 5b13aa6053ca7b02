"""The assembly of a run's loops, and what is in it."""

import re

import pytest
from llvmlite import binding

from fastatt import _numba, _store
from fastatt.codegen import modules
from fastatt.codegen.processor import processor
from fastatt.engine.program import Program
from fastatt.propagation import plan

needs_avx = pytest.mark.skipif(
    not binding.get_host_cpu_features().get("avx"), reason="no AVX: nothing to pack into"
)
ARITHMETIC = re.compile(r"^\s+v?(?:fn?m(?:add|sub)\w*?|mul|add|sub|div|sqrt)([ps])([ds])\s(.*)")
CONVERSION = re.compile(r"^\s+v?cvt(?:ps2pd|pd2ps|ss2sd|sd2ss)\s")
# of an x86, and of a 64-bit ARM
JUMP = re.compile(r"^\s+(?:j\w+|b(?:\.\w+)?|cbn?z\s+\w+,)\s+(\.L\w+)")
CALL = re.compile(r"^\s+call\w*\s+(.*)")
REGISTER = {64: "zmm", 32: "ymm", 16: "xmm"}
LARGE = 30  # operations that tell a step from a copy or a comparison


class _Seen(Exception):  # noqa: N818
    pass


def job_of(monkeypatch, run):
    """The job whose program a run asks for; it is not made, and nothing is run."""

    def record(job, *_):
        raise _Seen(job)

    monkeypatch.setattr(plan, "program", record)
    with pytest.raises(_Seen) as seen:
        run()
    monkeypatch.undo()
    return seen.value.args[0]


def texts(job):
    """The functions of a job in LLVM's language: its program, and the form for any angle.

    They are compiled in memory: what comes from disk has no text.
    """
    found, kept = [], (_store.folder, modules.needed)
    _store.folder = lambda: None
    modules.needed = lambda made: found.append(made.inspect_llvm())
    try:
        program = Program(job)
        if job.any_angle is not None:
            program.compile_any_angle()
    finally:
        _store.folder, modules.needed = kept
    return found


def assemblies(job):
    """Their assembly, without the wrappers by which they are called."""
    triple, name, features = _numba.target()
    machine = binding.Target.from_triple(triple).create_target_machine(
        cpu=name, features=features, opt=3, reloc="static", codemodel="jitdefault"
    )
    found = []
    for text in texts(job):
        assembly = machine.emit_assembly(binding.parse_assembly(text))
        parts = re.split(r"(?m)^\s*\.globl\s+", assembly)
        (own,) = [x for x in parts if re.match(r"_ZN\S*3run", x)]
        found.append(own)
    return found


def innermost_loops(assembly):
    """Lines from each label to a jump back to it, with no other such pair between."""
    lines = [line for line in assembly.splitlines() if line.strip()]
    labels, spans = {}, []
    for i, line in enumerate(lines):
        if label := re.match(r"^(\.L\w+):", line):
            labels[label[1]] = i
        elif (jump := JUMP.match(line)) and jump[1] in labels:
            spans.append((labels[jump[1]], i))
    inner = [
        (a, b)
        for a, b in spans
        if not any((c, d) != (a, b) and a <= c and d <= b for c, d in spans)
    ]
    return [lines[a:b] for a, b in inner]


def arithmetic(lines):
    """Arithmetic instructions by kind: packed or scalar (p, s), double or single (d, s)."""
    found = {"pd": 0, "sd": 0, "ps": 0, "ss": 0}
    for line in lines:
        if match := ARITHMETIC.match(line):
            found[match[1] + match[2]] += 1
    return found


def is_full(line):
    """Whether an arithmetic instruction works on the machine's widest vectors."""
    match = ARITHMETIC.match(line)
    return match is None or REGISTER[processor().vector] in match[3]


def large_loops(assembly):
    """Innermost loops with a step's worth of arithmetic of any kind."""
    return [x for x in innermost_loops(assembly) if sum(arithmetic(x).values()) >= LARGE]


def is_packed(lines, kind="pd"):
    """Whether a loop has full packed arithmetic of one kind alone, and no call."""
    found = arithmetic(lines)
    alone = sum(found.values()) == found[kind]
    return alone and all(map(is_full, lines)) and not any(map(CALL.match, lines))
