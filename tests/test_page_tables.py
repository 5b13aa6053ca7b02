"""Tables of the pages name what the records and modules have: no more and no less."""

import inspect
import re
from pathlib import Path

import fastatt as fa

PAGES = Path(fa.__file__).parent / "docs"


def table(page, header):
    """The cells of the rows of the table with a header."""
    _, found, text = (PAGES / page).read_text(encoding="utf-8").partition(f"\n| {header} |")
    assert found
    rows = text.partition("\n\n")[0].splitlines()[2:]
    return [[cell.strip() for cell in re.split(r"(?<!\\)\|", row)[1:-1]] for row in rows]


def test_the_guide_has_every_model_with_its_arguments():
    for module, header in (("rates", "model"), ("torques", "model of `fa.torques`")):
        models = getattr(fa, module)
        calls = [
            re.fullmatch(r"`(\w+)\((.*)\)`", row[0]) for row in table("guides/scenes.md", header)
        ]
        assert {call[1] for call in calls} == set(models.__all__)
        for call in calls:
            named = call[2].removesuffix(", ...").split(", ")
            parameters = list(inspect.signature(getattr(models, call[1])).parameters)
            assert named == parameters[: len(named)]
            assert len(named) == len(parameters) or call[2].endswith("...")


def test_the_page_has_every_method_with_its_source():
    rows = table("explanations/methods.md", "name")
    named = [name for row in rows for name in re.findall(r"`(\w+)`", row[0])]
    assert sorted(named) == sorted(fa.METHODS)


def test_the_page_has_the_methods_that_are_reversible():
    scenes = {"prescribed rates": {"rate"}, "free bodies": {"spherical", "symmetric", "free"}}
    scenes["free bodies and torques"] = {*scenes["free bodies"], "torqued"}
    for names, where in table("reference/methods.md", "methods"):
        expected = {m.name for m in fa.METHODS.values() if set(m.reversible) == scenes[where]}
        assert set(re.findall(r"`(\w+)`", names)) == expected
