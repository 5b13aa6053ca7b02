"""What is made of finished graphs: constants taken apart, another order."""

import numpy as np

import fastatt as fa
from fastatt.tracing.finished import Constants, Flat
from fastatt.tracing.graph import Graph
from fastatt.tracing.source import function

FUSED = {
    "fma": (lambda x, y, z: x * y + z, lambda x, y, z: z + x * y),
    "fms": (lambda x, y, z: x * y - z, lambda x, y, z: -(x * y) - z),
    "fnma": (lambda x, y, z: z - x * y,),
}


def test_a_product_fuses_with_the_only_sum_that_uses_it():
    for op, formulas in FUSED.items():
        for formula in formulas:
            graph = Graph()
            numbers = graph.inputs("double", "x", 3)
            flat = Flat(graph, [formula(*numbers)], "double")
            assert sum(node.op == op for node in flat.nodes) == 1
            assert not {"*", "+", "-"} & {node.op for node in flat.nodes}
            places = [k for _, k in flat.inputs()]
            given = 0.5, 3.0, -4.0
            assert function(flat)(*(given[k] for k in places)) == (formula(*given),)
            product = numbers[0] * numbers[1]
            apart = Flat(graph, [formula(*numbers), product], "double")
            assert op not in {node.op for node in apart.nodes}


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
