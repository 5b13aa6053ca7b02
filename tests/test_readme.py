"""The README and the pages of ``fastatt/docs``: their examples run, their commands and links exist.

Every page is in the navigation of the site, and every public name and option in the reference.

Every block fenced as ``python`` is run, from the top of its page down in one namespace, as a reader
would type them. A block fenced as ``text`` that comes next, with nothing but blank lines between,
is the printed output: compared with any run of blanks as one, and ``...`` for whatever changes from
run to run. Commands stand in blocks fenced as ``sh`` and in the text, between backticks. Examples
that are not to be looked at carry another fence, such as ``console`` or ``toml``.
"""

from __future__ import annotations

import argparse
import contextlib
import doctest
import functools
import importlib
import io
import linecache
import re
import shlex
import traceback
from dataclasses import dataclass
from pathlib import Path

import pytest
from each import each

import fastatt
from fastatt import cli

ROOT = Path(__file__).resolve().parents[1]
README = ROOT / "README.md"
DOCS = ROOT / "fastatt" / "docs"
PAGES = [README, *sorted(DOCS.rglob("*.md"))]
LONGEST = 200  # lines of the README

BLOCK = re.compile(
    r"^```python[ \t]*\n(?P<code>.*?)^```[ \t]*$(?:\s*^```text[ \t]*\n(?P<output>.*?)^```[ \t]*$)?",
    re.MULTILINE | re.DOTALL,
)
SHELL = re.compile(r"^```sh[ \t]*\n(?P<code>.*?)^```[ \t]*$", re.MULTILINE | re.DOTALL)
FENCED = re.compile(r"^```.*?^```[ \t]*$", re.MULTILINE | re.DOTALL)
INLINE = re.compile(r"`([^`]+)`")
LINK = re.compile(r"\]\((?!https?:)([^)\s#]+)(?:#([^)]*))?\)")
HEADING = re.compile(r"^#+ (.*)$", re.MULTILINE)
PROGRAMS = ("make", "python", "pytest", "fastatt", "pip", ".ci/run")
OPTIONS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
ROUNDING = re.compile(r"(?:-?\d(?:\.\d+)?|\.\.\.)e-(?:1[3-9]|2\d)|\b0e\+00")


@dataclass(frozen=True)
class Example:
    line: int
    code: str
    output: str | None


def examples(page: str) -> list[Example]:
    """The page's python blocks with the output that they state."""
    return [
        Example(page.count("\n", 0, m.start("code")) + 1, m["code"], m["output"])
        for m in BLOCK.finditer(page)
    ]


def run(example: Example, namespace: dict[str, object], name: str) -> str:
    """What the example prints; its lines have the page's numbers in a traceback."""
    printed = io.StringIO()
    text = "\n" * (example.line - 1) + example.code
    # as at a notebook's prompt: functions are traced from their source
    place = f"<{name}, line {example.line}>"
    linecache.cache[place] = (len(text), None, text.splitlines(keepends=True), place)
    code = compile(text, place, "exec")
    with contextlib.redirect_stdout(printed):
        exec(code, namespace)
    return printed.getvalue()


def difference(expected: str, found: str) -> str | None:
    """None where what was printed is what was to be printed.

    Rounding errors below 1e-12 depend on the processor: only that they are as small is compared.
    """
    checker = doctest.OutputChecker()
    if checker.check_output(*(ROUNDING.sub("ROUNDING", x) for x in (expected, found)), OPTIONS):
        return None
    return checker.output_difference(doctest.Example("", expected), found, OPTIONS)


def failures(page: str, name: str) -> list[str]:
    """What is wrong with a page's examples, each with its line."""
    namespace: dict[str, object] = {"__name__": "__page__"}
    found = []
    for example in examples(page):
        try:
            printed = run(example, namespace, name)
        except Exception:  # noqa: BLE001 (whatever an example raises)
            found.append(f"{name}, line {example.line}:\n{traceback.format_exc()}")
            continue
        if example.output is not None:
            wrong = difference(example.output, printed)
            if wrong is not None:
                found.append(f"{name}, line {example.line}:\n{wrong}")
    return found


# commands


def in_blocks(page: str) -> list[str]:
    """Command lines of the page's blocks, without comments and prompts."""
    lines = []
    for block in SHELL.finditer(page):
        text = block["code"].replace("\\\n", " ")
        lines += [" ".join(shlex.split(line, comments=True)) for line in text.splitlines()]
    return [line for line in lines if line]


def in_text(page: str) -> list[str]:
    """Commands between backticks."""
    spans = (" ".join(span.split()) for span in INLINE.findall(FENCED.sub("", page)))
    return [s for s in spans if s.split()[0] in PROGRAMS and (" " in s or "/" in s)]


def refused(page: str) -> list[str]:
    """Commands of a page that name a file, a target or a test that is not there, with that."""
    targets = (ROOT / "Makefile").read_text(encoding="utf-8")
    found = []
    for command in (*in_blocks(page), *in_text(page)):
        program, *words = shlex.split(command)
        files = [w for w in (program, *words) if w.endswith(".py") or w == ".ci/run"]
        gone = [w for w in files if not (ROOT / w).is_file()]
        if program == "make":
            gone += [w for w in words if f"\n{w}:" not in targets]
        if "-k" in words and not gone:
            name = words[words.index("-k") + 1]
            gone += [name] * all(name not in (ROOT / w).read_text(encoding="utf-8") for w in files)
        found += [f"{command}: no {w}" for w in gone]
    return found


def astray(path: Path) -> list[str]:
    """Links of a page to files or headings that are not there."""
    found = []
    for target, heading in LINK.findall(path.read_text(encoding="utf-8")):
        page = path.parent / target
        if not page.exists() or (heading and heading not in headings(page)):
            found.append(f"{target}#{heading}")
    return found


def headings(page: Path) -> set[str]:
    """A page's headings as links name them."""
    text = FENCED.sub("", page.read_text(encoding="utf-8"))
    return {re.sub(r"[^\w -]", "", h.lower()).replace(" ", "-") for h in HEADING.findall(text)}


# the pages


def test_pages_examples_and_commands_are_found():
    assert {p.stem for p in PAGES} > {"README", "index", "tutorial", "methods", "status"}
    texts = [p.read_text(encoding="utf-8") for p in PAGES]
    found = [x for text in texts for x in examples(text)]
    assert len(found) > 100
    assert sum(x.output is not None for x in found) > 50
    assert {x.split()[0] for t in texts for x in (*in_blocks(t), *in_text(t))} >= {"make", "pytest"}
    assert refused("`make no-such-target`, `pytest tests/each.py -k no_such_name`")


def test_what_an_example_does_not_print_is_noticed():
    page = "```python\nprint(1)\n```\n\n```text\n{}\n```\n"
    assert failures(page.format(1), "page.md") == []
    assert "page.md, line 2" in failures(page.format(2), "page.md")[0]
    assert "ZeroDivisionError" in failures(page.replace("(1)", "(1 / 0)"), "page.md")[0]


def test_every_page_is_in_the_navigation_once():
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    listed = re.findall(r"^ +- (?:[^:\n]+: )?(\S+\.md)$", text.partition("\nnav:")[2], re.MULTILINE)
    outside = ["CHANGELOG.md", *(f"bench/{p.name}" for p in ROOT.glob("bench/*.md"))]
    assert sorted(listed) == sorted(
        [*(p.relative_to(DOCS).as_posix() for p in PAGES[1:]), *outside]
    )


@each("module", ["", "dask", "estimation", "interchange", "plots", "rates", "torques", "forces"])
def test_every_public_name_is_in_the_reference(module):
    text = "".join(p.read_text(encoding="utf-8") for p in DOCS.glob("reference/*.md"))
    shown = set(re.findall(r"^::: fastatt\.(\S+)$", text, re.MULTILINE))
    shown |= {name.partition(".")[0] for name in shown}  # a module by what it holds
    shown.add("estimation.preintegration")  # a module of kernels
    package = getattr(fastatt, module, None) or importlib.import_module(
        f"fastatt.{module}".strip(".")
    )
    assert [n for n in package.__all__ if not {n, f"{module}.{n}"} & shown] == []


def test_the_page_of_the_command_line_has_every_option_with_its_help():
    page = (DOCS / "reference" / "cli.md").read_text(encoding="utf-8")
    commands = next(a for a in cli._parser()._actions if isinstance(a, argparse._SubParsersAction))
    sections = dict(
        re.findall(r"^## fastatt (\w+)\n(.*?)(?=^## |\Z)", page, re.MULTILINE | re.DOTALL)
    )
    assert sections.keys() == commands.choices.keys()
    for name, parser in commands.choices.items():
        rows = re.findall(r"^\| (`.*?) \| (.*?) ?\| (.*) \|$", sections[name], re.MULTILINE)
        actions = [a for a in parser._actions if "--help" not in a.option_strings]
        names = [", ".join(f"`{x}`" for x in a.option_strings or [a.dest]) for a in actions]
        assert rows == [(n, values(a), a.help) for n, a in zip(names, actions, strict=True)]


def values(action: argparse.Action) -> str:
    """What an option takes, as the page writes it."""
    if action.choices:
        return ", ".join(f"`{x}`" for x in action.choices)
    if action.nargs == 0 or not action.option_strings:
        return ""
    shown = action.metavar or action.dest.upper()
    return f"`{shown}`" if isinstance(shown, str) else f"`{' '.join(shown)} ...`"


def of_tier(path: Path):
    """A page as a case: in `make test` the one that a newcomer reads first."""
    marks = () if path == README else pytest.mark.slow
    return pytest.param(path, id=path.relative_to(ROOT).as_posix(), marks=marks)


@pytest.mark.parametrize("path", [of_tier(path) for path in PAGES])
def test_examples_print_what_the_page_says(path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    if path.stem == "cluster":  # workers in processes take seconds to start: see test_dask
        client = pytest.importorskip("distributed").Client
        threads = functools.partialmethod(client.__init__, processes=False)
        monkeypatch.setattr(client, "__init__", threads)
    found = failures(path.read_text(encoding="utf-8"), path.name)
    assert not found, "\n".join(found)


@each("path", PAGES)
def test_commands_and_links_lead_somewhere_and_no_figure_is_missing(path):
    text = path.read_text(encoding="utf-8")
    assert refused(text) == []
    assert astray(path) == []
    assert re.findall(r"\{\{.*?\}\}", text, re.DOTALL) == []


def test_readme_is_short_and_leads_to_every_guide():
    text = README.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= LONGEST
    linked = {(README.parent / t).resolve() for t, _ in LINK.findall(text)}
    wanted = [DOCS / "index.md", DOCS / "tutorial.md", *(DOCS / "guides").glob("*.md")]
    assert [p.name for p in wanted if p not in linked] == []
