"""What is made of finished graphs: constants taken apart, another order."""

import numpy as np
import pytest

import fastatt as fa
from fastatt.propagation.inspect_step import job_of
from fastatt.tracing.finished import Constants, Flat
from fastatt.tracing.graph import Graph
from fastatt.tracing.nodes import operands
from fastatt.tracing.source import function

# what a body's own numbers give alone is computed once


def test_constants_leave_no_operation_twice_and_no_rounding_changed():
    graph = Graph()
    p, x = graph.inputs("double", "p", 2), graph.input("double", "x", 0)
    alone = (p[0] * p[1] + p[0]) / p[1]
    both = p[0] * p[1] + x  # fused with what moves: not taken apart
    flat = Flat(graph, [alone * x + both, alone], "double")
    constants = Constants("p", "c")
    rest = constants.without(flat)
    assert rest.operations < flat.operations
    assert ("c", 0) in rest.inputs()
    assert ("x", 0) not in constants.flat.inputs()
    values = {("p", 0): 0.3, ("p", 1): 0.7, ("x", 0): 1.1}
    (c,) = function(constants.flat)(*(values[name] for name in constants.flat.inputs()))
    values["c", 0] = c
    apart = function(rest)(*(values[name] for name in rest.inputs()))
    whole = function(flat)(*(values[name] for name in flat.inputs()))
    assert apart == whole


def test_a_sine_of_a_parameter_is_taken_once_a_run():
    shown = fa.inspect_step(
        fa.Scene(rate=fa.rates.Coning(np.linspace(0.3, 1.4, 5), 1.0)), "lie_midpoint"
    )
    before, step = shown.split("for n in range(first, last):")
    # of the quarters of a turn, and of the turns
    assert before.count("rint") == step.count("rint") == 2


# results that wait take registers


def most_waiting(flat):
    """Operations with a user still to come, at the worst place."""
    last = {i: len(flat.nodes) for i in flat.results}
    for i, node in enumerate(flat.nodes):
        for k in operands(node):
            last[k] = max(last.get(k, i), i)
    made = [i for i, node in enumerate(flat.nodes) if node.op not in ("const", "in")]
    return max(sum(i <= at < last.get(i, i) for i in made) for at in made)


@pytest.mark.parametrize("method", ["rk4", "cf4", "rkmk4"])
def test_fewer_results_wait_for_registers(method):
    """Of a free body on the matrix; AVX-512 has 32 registers. The results are the same bits."""
    scene = fa.Scene(inertia=(2.0, 1.0, 2 / 3))
    job = job_of(scene, method, "dcm", np.float64)
    scope = job.formulas.scope(small_angle=True)
    times = scope.time(), scope.number("h"), scope.number("k")
    written = scope.finished(scope.step(*times, scope.state(), scope.extras())[0])
    better = written.in_few_registers()
    assert most_waiting(better) <= 32
    assert most_waiting(better) < most_waiting(written)
    assert sorted(n.op for n in better.nodes) == sorted(n.op for n in written.nodes)
    given = {name: 0.1 + 0.07 * i for i, name in enumerate(sorted(written.inputs()))}
    a, b = (function(f)(*(given[name] for name in f.inputs())) for f in (written, better))
    assert a == b
