"""What single precision gains, and where its floor is."""

from __future__ import annotations

from leaderboard_contestants import our_plans
from leaderboard_problems import MANY, PROBLEMS

from fastatt.propagation.choice_of_method import methods_for
from fastatt.trade.measure import best_time

_PROBLEMS = ("coning-small", "coning-large", "free", "top")
_STEPS, _FLOOR, _REPEATS = 96, (32, 64, 128, 256, 512), 15


def single_table(*, quick: bool) -> str:
    """Markdown: a line for each problem and method, of ensembles."""
    heads = "problem", "method", "ns a body-step", "float32", "gain", "float32's least error, rad"
    lines = [f"| {' | '.join(heads)} |", "| --- " * len(heads) + "|"]
    for name in _PROBLEMS[:1] if quick else _PROBLEMS:
        problem = PROBLEMS[name](quick)
        for method in methods_for(problem.scene, "quat")[: 2 if quick else None]:
            steps = 1 if method == "exact" else _STEPS
            double, single = (
                next(our_plans(problem, method, dtype, (steps,))(MANY))
                for dtype in ("float64", "float32")
            )
            seconds = [1.0, 1.0]
            for _ in range(2 if quick else _REPEATS):
                for k, run in enumerate((double, single)):
                    seconds[k] = min(seconds[k], best_time(run.call, 1)[0])
            floor = min(
                problem.error(run.attitudes(run.call()))
                for run in our_plans(problem, method, "float32", _FLOOR)(MANY)
            )
            a, b = (1e9 * s / steps / len(problem.q0) for s in seconds)
            lines.append(
                f"| {problem.title} | `{method}` | {a:.2f} | {b:.2f} | {a / b:.2f} | {floor:.0e} |"
            )
    return "\n".join(lines) + "\n"
