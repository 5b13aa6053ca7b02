"""Every figure of the cases that others published, as ``make cases`` compares it."""

import cases
import pytest
from cases_rows import Case, at_most, page, printed

import fastatt as fa


@pytest.mark.parametrize("case", cases.CASES, ids=lambda case: case.title)
def test_figures_agree(case):
    rows = list(case.rows())
    assert rows
    assert [row for row in rows if not row.agrees] == []
    # the page is of these cases
    text = cases.OUT.read_text(encoding="utf-8")
    assert [r.quantity for r in rows if f"| {r.quantity} | {r.theirs} |" not in text] == []


def test_units_are_those_of_the_digits_printed():
    assert printed("", "1.50, 2e-3", [1.51, 0.0]).apart == pytest.approx(2.0)
    assert printed("", "15", [14.4]).apart == pytest.approx(0.6)


def test_a_figure_apart_is_marked():
    rows = [printed("one", "1.0", [1.2]), at_most("two", "1e-3", 2e-3, 1e-3, "rad")]
    text = page([Case("Title", "Text.", "None.", lambda: iter(rows))])
    assert text.count("| **differs** |") == 2
    assert "0 of 2 figures agree" in text
    assert not printed("one", "1.0", [float("nan")]).agrees


def test_jsbsims_trapezoidal_rule_is_refused_as_one_of_order_2():
    with pytest.raises(ValueError, match=r"order 2 gives -0\.5, not 0\.5"):
        fa.runge_kutta("late", order=2, c=(0, -1), a=((-1,),), b=(1 / 2, 1 / 2))
