"""A case that others published: a row for each figure of theirs, and how far ours is from it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from decimal import Decimal
from typing import Any


@dataclass(frozen=True)
class Row:
    """A figure. ``apart`` and ``allowed`` are in ``unit``; ``allowed`` follows from theirs."""

    quantity: str
    theirs: str
    ours: str
    apart: float
    allowed: float
    unit: str

    @property
    def agrees(self) -> bool:
        return self.apart <= self.allowed


@dataclass(frozen=True)
class Case:
    """``text`` says where the figures come from, ``spread`` what their own tools differ by."""

    title: str
    text: str
    spread: str
    rows: Callable[[], Iterator[Row]]


def printed(quantity: str, theirs: str, ours: Sequence[Any], units: float = 1.0) -> Row:
    """Numbers as they print them, which ours are to meet within some units of the last digit.

    One unit is what their rounding and ours may take between them.
    """
    figures = [Decimal(x) for x in theirs.split(", ")]
    places = [-int(x.as_tuple().exponent) for x in figures]
    each = [
        abs(float(y) - float(x)) * 10.0**p for x, y, p in zip(figures, ours, places, strict=True)
    ]
    shown = ", ".join(f"{y:.{max(p, 0) + 1}f}" for y, p in zip(ours, places, strict=True))
    return Row(quantity, theirs, shown, max(each), units, "units of the last digit")


def at_most(quantity: str, theirs: str, value: float, limit: float, unit: str) -> Row:
    """An error of ours that is to be no larger than theirs."""
    return Row(quantity, theirs, f"{value:.2g} {unit}", value, limit, unit)


def page(cases: Sequence[Case]) -> str:
    """The page, Markdown."""
    found = [(case, list(case.rows())) for case in cases]
    rows = [row for _, some in found for row in some]
    out = [HEADER.format(agree=sum(row.agrees for row in rows), total=len(rows))]
    for case, some in found:
        out += [f"## {case.title}", "", case.text, "", f"Their own tools: {case.spread}", ""]
        out += ["| figure | published | fastatt | difference | allowed | |", "| --- " * 6 + "|"]
        for x in some:
            mark = "" if x.agrees else "**differs**"
            out.append(
                f"| {x.quantity} | {x.theirs} | {x.ours} | {x.apart:.2g} | "
                f"{x.allowed:.2g} {x.unit} | {mark} |"
            )
        out.append("")
    return "\n".join(out)


HEADER = """\
# Cases that others published

Made by `make cases`. {agree} of {total} figures agree.

"Published" is a figure as its source prints it; that of fastatt has one digit more.
"Difference" is the largest difference of the numbers in a row, in the unit of "allowed".
"Allowed" follows from the digits of the published figure, or from the statement of its source.
"""
