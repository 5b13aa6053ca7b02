"""Events in the generated step: user-defined functions at the end of each step."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from fastatt.engine.brackets import crosses, turns
from fastatt.tracing.finished import Flat
from fastatt.tracing.formulas import Vector
from fastatt.tracing.graph import Double, choose
from fastatt.tracing.user import UserFunction

if TYPE_CHECKING:
    from fastatt.engine.job import Scope


class Watch(NamedTuple):
    """A user-defined function whose first zero crossing is located, and its direction."""

    function: UserFunction
    direction: int
    #: whether a body stops at the event
    terminal: bool

    @property
    def reads_position(self) -> bool:
        """Whether the function takes velocity and position, not only time, attitude and rate."""
        return len(self.function.form.before) > 4


def values(scope: Scope) -> Vector:
    """The functions of the events, at the state after the given number of steps."""
    if not scope.job.events:
        return ()
    t, since = scope.time(), scope.number("since")
    x = scope.left(t, since, scope.number("edge"), scope.state(), scope.extras())
    own, structure = scope.parts(x)[0], scope.job.structure
    # velocity and position come before the states of the scene
    states = structure.turning.law.states
    beside = tuple(map(Double, own[len(own) - structure.beside :]))
    moved, s = beside[: len(beside) - states], beside[len(beside) - states :]
    p = scope.graph.inputs("double", "p", structure.turning.n_params)
    found = []
    for watch in scope.job.events:
        # the scene's ``params`` are the last parameters of the rotation
        given = p[len(p) - watch.function.n_params :]
        placed = (moved[:3], moved[3:]) if watch.reads_position else ()
        found.append(scope.called(watch.function.given, t, own, *placed, s, given))
    return tuple(found)


def after_step(scope: Scope) -> Flat:
    """For each function its value, that of the step before, and whether it may have crossed zero.

    The inputs ("event", i) are these results after the step before.
    """
    watches, found = scope.job.events, values(scope)
    n = len(watches)
    rows = scope.inputs("event", 3 * n)
    last, before, marks = rows[:n], rows[n : 2 * n], rows[2 * n :]
    marked = []
    for watch, a, b, x, mark in zip(watches, before, last, found, marks, strict=True):
        c = type(b)(x)
        test = crosses(b, c, watch.direction) | turns(a, b, c)
        marked.append(choose(test, 1.0, mark))
    return scope.finished((*found, *last, *marked))
