"""Figures of pages are what their command writes, and what words beside them say of them."""

import re
from collections import Counter
from fnmatch import fnmatch

import page_figures
from each import each

from fastatt.propagation.choice_of_method import DEFAULTS


@each("page", page_figures.PAGES)
def test_pages_have_the_figures_of_the_files(page):
    text = page.read_text(encoding="utf-8")
    assert page_figures.rewritten(text) == text
    stale = text.replace("| 1e-12 rad |", "| 1e-11 rad |").replace(" of 58 published", " of 57")
    assert page_figures.rewritten(stale) == text


def test_every_block_stands_in_a_page():
    text = "".join(page.read_text(encoding="utf-8") for page in page_figures.PAGES)
    for name in page_figures.BLOCKS:
        assert f"<!-- python bench/page_figures.py: {name} -->" in text


def test_where_others_are_first_and_where_single_precision_is():
    """A single short log at 1e-3 rad; and errors of 1e-3 and 1e-6 rad."""
    board, single, others = page_figures.board(), set(), Counter()
    for problem, bodies, *cells in board:
        single |= {k for k, cell in enumerate(cells) if cell.startswith("`") and "float32`" in cell}
        lost = [k for k, cell in enumerate(cells) if not cell.startswith("`")]
        others.update((problem.split(", ")[-1], bodies, k) for k in lost)
    assert single == {0, 1}
    assert others == {("sampled", "one", 0): 1}


def test_defaults_are_first_most_often():
    groups = "prescribed rate", "free body, heavy symmetric top", "any torque"
    names = [page_figures.default(group) for group in groups]
    assert tuple(names) == DEFAULTS[:3]
    for page in page_figures.PAGES[:2]:
        prose = " ".join(page.read_text(encoding="utf-8").split())
        assert f"first most often at 1e-3 and 1e-6 rad: `{names[0]}`" in prose


def test_every_bench_says_which_question_it_answers():
    page = (page_figures.BENCH / "README.md").read_text(encoding="utf-8")
    names = re.findall(r"`([\w*]+\.py)`", page)
    files = sorted(path.name for path in page_figures.BENCH.glob("*.py"))
    assert [x for x in files if not any(fnmatch(x, name) for name in names)] == []
    assert [name for name in names if not any(fnmatch(x, name) for x in files)] == []
