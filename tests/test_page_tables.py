"""Tables of the pages name what the records and modules have: no more and no less."""

import inspect
import re
from pathlib import Path

from each import each

import fastatt as fa
from fastatt.attitudes import ATTITUDES
from fastatt.scene.models import Model
from fastatt.scene.torque_record import Dependence

PAGES = Path(fa.__file__).parent / "docs"


def table(page, header):
    """The cells of the rows of the tables with a header."""
    _, *found = (PAGES / page).read_text(encoding="utf-8").split(f"\n| {header} |")
    assert found
    rows = [row for text in found for row in text.partition("\n\n")[0].splitlines()[2:]]
    return [[cell.strip(" `") for cell in re.split(r"(?<!\\)\|", row)[1:-1]] for row in rows]


def test_the_guide_has_every_model_with_its_arguments():
    for module, header in (("rates", "model"), ("torques", "model of `fa.torques`")):
        models = getattr(fa, module)
        calls = [re.fullmatch(r"(\w+)\((.*)\)", x) for x, *_ in table("guides/scenes.md", header)]
        assert {call[1] for call in calls} == set(models.__all__)
        for call in calls:
            named = call[2].removesuffix(", ...").split(", ")
            parameters = list(inspect.signature(getattr(models, call[1])).parameters)
            assert named == parameters[: len(named)]
            assert len(named) == len(parameters) or call[2].endswith("...")


def test_the_guide_says_what_a_torque_depends_on_and_where_it_accepts_tables():
    depends = {"no": Dependence.POSITION, "linearly": Dependence.DAMPED, "yes": Dependence.RATE}
    for call, _, on_rate, tables in table("guides/scenes.md", "model of `fa.torques`"):
        name = call.strip("`").partition("(")[0]
        model = getattr(fa.torques, name)
        # a controller's torque is held, and a switch exerts none: methods take both as RATE
        if on_rate in depends and name not in ("SampledControl", "Switch"):
            assert model.depends == depends[on_rate], name
        assert (tables == "yes") == any(x.table for x in model.fields.values()), name


@each("module", [fa.rates, fa.torques, fa.forces])
def test_every_model_is_public(module):
    bases = {"Model", "UserModel", "Rate", "Torque", "Force"}
    defined = {n for n, x in vars(module).items() if isinstance(x, type) and issubclass(x, Model)}
    assert defined - bases == set(module.__all__)


def test_the_page_has_every_representation_with_its_size():
    rows = table("explanations/methods.md", "name | numbers")
    expected = [(x.name, x.size) for x in ATTITUDES.values()]
    assert sorted((row[0].strip("`"), int(row[1])) for row in rows) == sorted(expected)


def test_representations_are_named_where_one_is_chosen():
    glossary, methods = ((PAGES / x).read_text() for x in ("glossary.md", "reference/methods.md"))
    for text in (fa.propagate.__doc__, glossary, methods):
        assert [name for name in ATTITUDES if f'"{name}"' not in text] == []


def test_the_guide_has_all_that_a_log_holds():
    page = (PAGES / "guides/gyro-logs.md").read_text(encoding="utf-8")
    fields = fa.gyro.GyroLog.__dataclass_fields__
    assert [name for name in fields if f"log.{name}" not in page] == []


def test_the_pages_name_the_methods_that_step_states():
    names = [f"`{m.name}`" for m in fa.METHODS.values() if m.couples]
    for page, text in (
        ("guides/scenes.md", f"{', '.join(names)} and user-defined tableaus support this"),
        ("guides/events.md", f"{', '.join(names[:-1])} and {names[-1]}."),
    ):
        assert text in " ".join((PAGES / page).read_text(encoding="utf-8").split())


def test_the_page_of_equations_has_every_tableau():
    rows = table("explanations/equations.md", "method | stages | coefficients")
    tableaus = [m for m in fa.METHODS.values() if m.uses == ("derivative",) and m.body_calls]
    expected = [(m.name, m.body_calls) for m in tableaus]
    assert [(row[0].strip("`"), int(row[1])) for row in rows] == expected


def test_the_changelog_names_what_users_choose_from():
    text = (PAGES.parents[1] / "CHANGELOG.md").read_text(encoding="utf-8")
    names = [*fa.METHODS, *ATTITUDES, *(flag.name for flag in fa.Status if flag)]
    names += [n for x in (fa.rates, fa.torques, fa.forces) for n in x.__all__]
    assert [name for name in names if not re.search(rf"\b{name}\b", text)] == []


def test_the_page_has_every_method_with_its_source():
    rows = table("explanations/methods.md", "name | method")
    named = [name for row in rows for name in re.findall(r"\w+", row[0])]
    assert sorted(named) == sorted(fa.METHODS)
    found = {(row[0], row[-1]) for row in table("explanations/methods.md", "method | for")}
    assert {x for x in found if x[1]} <= {(m.name, m.summary) for m in fa.METHODS.values()}
    assert {name for name, summary in found if summary} == set(fa.METHODS)


def test_the_page_has_the_flags_and_the_limits_of_the_records():
    flags = [[flag.name, str(int(flag))] for flag in fa.Status if flag]
    assert [row[:2] for row in table("explanations/status.md", "flag")] == flags
    expected = []
    for record in filter(lambda m: m.is_stepped, fa.METHODS.values()):
        stored = [x for x in ("quat", "dcm", "mrp", "euler313") if record.stores(x)]
        limits = [f"{record.limit(x):.3g}" for x in stored] + [""] * (4 - len(stored))
        for other in ({"body": True}, {"torqued": True}):
            own = record.limit("quat", **other)
            limits.append("" if own == record.limit("quat") else f"{own:.3g}")
        expected.append([record.name, record.measure, *limits])
    assert table("explanations/status.md", "method | measure") == expected


def test_the_page_has_the_methods_that_are_reversible():
    scenes = {"prescribed rates": {"rate"}, "free bodies": {"spherical", "symmetric", "free"}}
    scenes["free bodies and torques"] = {*scenes["free bodies"], "torqued"}
    for names, where in table("reference/methods.md", "methods"):
        expected = {m.name for m in fa.METHODS.values() if set(m.reversible) == scenes[where]}
        assert set(re.findall(r"\w+", names)) == expected
