"""The summary of a study: on one screen, and as a page. How to read them.

- A row is one method with one step size on one ensemble. Times are CPU times of one thread,
  the least of five rounds or more in which all runs of a scene take turns, without compilation;
  errors and drifts do not depend on the machine.
- `error` is the largest angle, rad, between the attitude of any body at the end and the reference,
  which is a closed form or a run of a method of high order whose error is far smaller.
- `method` is the fastest of those whose `error` is at most the target. Each is measured with
  smaller and smaller step sizes, from the coarsest that its limit allows down to rounding. Rows
  with a status flag are left out. A closed form takes no steps and has its own row: `exact`.
- `step` is the step size, s, and `µs` the time for one body over the whole duration, microseconds.
  A dash is the step of a closed form, a drift of zero or of nothing that the motion conserves, or
  an error that no method reaches.
- `drift` is the largest of the norm error (of a matrix: the orthogonality error ‖C Cᵀ − 1‖) and the
  relative changes of energy and angular momentum, of any body, where the motion conserves them.
- Times within 10 % of each other are ties.
- An error that rounding limits counts as better than another only if it is 4 times smaller.
- In long runs all methods have one step size, in which the fastest body rotates by 0.2 rad. The
  drift is the root mean square over the bodies, and a mark tells how its largest value so far grows
  from a thirtieth of the run to the end, as the power t^p of time: bounded (=) if p < 0.25, as a
  random walk (~) if p < 0.75, linearly (/) if p < 1.5, and faster (^) otherwise.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from operator import attrgetter
from textwrap import wrap

from fastatt.trade.long_run import Drifted, ends
from fastatt.trade.measure import BRIEF, Row, frontier, table

#: rad; errors at which methods are compared
TARGETS = (1e-3, 1e-6, 1e-9, 1e-12)
_WIDTH = 100
_STORED = ("quat", "dcm")
#: what the screen shows: quantities that tell methods apart
_SHOWN = (("coning", "norm"), ("free", "energy"), ("free", "momentum"), ("top", "energy"))
_LETTERS = {"bounded": "=", "random walk": "~", "linear": "/", "faster": "^"}
#: how to read the results, as the page of the trade has it too
COLUMNS = (__doc__ or "").partition("\n\n")[2].strip()


def fastest(rows: Iterable[Row], target: float) -> Row | None:
    """The fastest row of a method that takes steps and meets a target, if there is one."""
    met = [r for r in rows if not (r.status or r.is_exact) and r.error_max <= target]
    return min(met, key=attrgetter("seconds_per_body"), default=None)


def closed_form(rows: Iterable[Row]) -> Row | None:
    """The row of the closed form, if there is one."""
    return next((row for row in rows if row.is_exact), None)


def by_scene(rows: Sequence[Row]) -> dict[str, dict[str, list[Row]]]:
    """Rows by ensemble and representation."""
    return {
        scene: {
            name: [r for r in rows if (r.input, r.representation) == (scene, name)]
            for name in _STORED
        }
        for scene in dict.fromkeys(row.input for row in rows)
    }


def screen(rows: Sequence[Row], long: Sequence[Drifted]) -> str:
    """The fastest method at each error, and how far what is conserved drifts: 33 lines at most."""
    half = f"{'method':<12} {'step, s':>8} {'µs':>8} {'drift':>7}"
    lines = [f"{'':<16} {'quaternion':<41} DCM", f"{'scene':<8} {'error':>7}  {half}     {half}"]
    for scene, stored in by_scene(rows).items():
        best = {"any": [closed_form(group) for group in stored.values()]}
        for target in TARGETS:
            best[f"{target:.0e}"] = [fastest(group, target) for group in stored.values()]
        for error, first in best.items():
            if any(first):
                cells = "     ".join(_cell(row, stored) for row in first)
                lines.append(f"{scene:<8} {error:>7}  {cells}".rstrip())
    return "\n".join([*lines, *_drifts(long)])


def _cell(row: Row | None, stored: dict[str, list[Row]]) -> str:
    if row is None:
        return f"{'–' if any(stored.values()) else '':<12} {'':>8} {'':>8} {'':>7}"
    step = "–" if row.is_exact else f"{row.dt:.3g}"
    drift = f"{row.drift:.0e}" if row.drift else "–"
    return f"{row.method:<12} {step:>8} {row.seconds_per_body * 1e6:>8.3g} {drift:>7}"


def _drifts(long: Sequence[Drifted]) -> list[str]:
    lines: list[str] = []
    for scene, quantity in _SHOWN:
        shown = scene, quantity, "quat"
        last = [x for x in ends(long) if (x.input, x.quantity, x.representation) == shown]
        if not last:
            continue
        if not lines:
            laws = ", ".join(f"{letter} {law}" for law, letter in _LETTERS.items())
            lines.append(f"Drift after {last[0].n_steps} steps, quaternions ({laws}):")
        # a method and its drift stay on one line
        words = [
            f"{x.method}\N{NO-BREAK SPACE}{x.drift:.0e}{_LETTERS[x.growth]}"
            for x in sorted(last, key=lambda x: x.drift)
        ]
        text = f"{scene}\N{NO-BREAK SPACE}{quantity}: {' '.join(words)}"
        lines += wrap(text, _WIDTH, subsequent_indent="    ", break_on_hyphens=False)
    return [line.replace("\N{NO-BREAK SPACE}", " ") for line in lines]


def page(title: str, headings: dict[str, str], rows: Sequence[Row], long: Sequence[Drifted]) -> str:
    """The summary as Markdown: the screen, the frontier of each ensemble, drifts of long runs."""
    text = f"# Speed, error and drift of each method\n\n{title}\n\n## How to read the results\n\n"
    text += f"{COLUMNS}\n\n```text\n{screen(rows, long)}\n```\n"
    for scene, stored in by_scene(rows).items():
        best = [row for group in stored.values() for row in frontier(group)]
        text += f"\n## {scene}\n\n{headings[scene]}. The fastest way to each error:\n"
        text += f"\n```text\n{table(best, BRIEF)}\n```\n"
    ranked = sorted(ends(long), key=lambda x: (x.input, x.quantity, x.representation, x.drift))
    text += f"\n## Drift over long runs\n\n```text\n{table(ranked)}\n```\n"
    return text
