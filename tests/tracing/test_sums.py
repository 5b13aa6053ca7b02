"""Sums taken in term by term: how many operations are left, and what they give."""

import pytest

from fastatt.tracing import source
from fastatt.tracing.finished import Flat
from fastatt.tracing.formulas import onto
from fastatt.tracing.graph import Graph
from fastatt.tracing.nodes import operands

FUSED = ("fma", "fms", "fnma")
X = (3.0, 5.0, 7.0, 11.0)
P, Y, K = 2.0, 13.0, 17.0


def finished(of, *, scaled):
    """(operations that meet the state, value) of y + x, or y + k x."""
    graph = Graph()
    x = graph.inputs("double", "x", 4)
    p, y, k = (graph.input("double", name) for name in "pyk")
    (found,) = onto((y,), (of(x, p),), (k,) if scaled else None)
    flat = Flat(graph, [found], "double")
    given = {("x", i): a for i, a in enumerate(X)} | {("p",): P, ("y",): Y, ("k",): K}
    meets: list[bool] = []
    for n in flat.nodes:
        meets.append(n.args[0] == "x" if n.op == "in" else any(meets[i] for i in operands(n)))
    ops = [n.op for n, of_state in zip(flat.nodes, meets, strict=True) if of_state and n.op != "in"]
    return ops, source.function(flat)(*(given[name] for name in flat.inputs()))[0]


def rotated(x, p):
    return -(x[0] * x[1]) - x[2] * x[3] + x[0] * x[2]


def torque(x, p):
    return (1.0 + p * p) * x[0] - (x[1] * (p * x[2]) - x[3] * x[0] * p)


@pytest.mark.parametrize(
    ("of", "scaled", "fused", "others"),
    [
        (rotated, False, 3, 0),
        (torque, True, 3, 2),  # x1 and x3 are multiplied by others beforehand
        (rotated, True, 3, 2),  # no factor for k: of the sum a product, its sign and two, then k
        (lambda x, p: p * x[0] + abs(x[1]), True, 2, 1),  # no product
    ],
    ids=["sum", "known factors", "none", "no product"],
)
def test_each_term_is_one_operation(of, scaled, fused, others):
    ops, value = finished(of, scaled=scaled)
    assert value == pytest.approx(Y + (K if scaled else 1.0) * of(X, P), rel=1e-15)
    assert sum(op in FUSED for op in ops) == fused
    assert len(ops) == fused + others


def test_known_numbers():
    assert onto((1.0, 2.0), (3.0, 4.0), (5.0, 6.0)) == (16.0, 26.0)
