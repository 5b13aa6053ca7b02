"""The README's examples run and print what it says.

Every block fenced as ``python`` is run, from the top of the page down in one namespace, as a reader
would type them. A block fenced as ``text`` that comes next, with nothing but blank lines between,
is the printed output: compared with any run of blanks as one, and ``...`` for whatever changes from
run to run. Examples that are not to be run carry another fence, such as ``console`` or ``toml``.
"""

from __future__ import annotations

import contextlib
import doctest
import io
import re
from dataclasses import dataclass
from pathlib import Path

import pytest

README = Path(__file__).resolve().parents[1] / "README.md"
BLOCK = re.compile(
    r"^```python[ \t]*\n(?P<code>.*?)^```[ \t]*$(?:\s*^```text[ \t]*\n(?P<output>.*?)^```[ \t]*$)?",
    re.MULTILINE | re.DOTALL,
)
OPTIONS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


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


def run(example: Example, namespace: dict[str, object]) -> str:
    """What the example prints; its lines have the page's numbers in a traceback."""
    printed = io.StringIO()
    code = compile("\n" * (example.line - 1) + example.code, str(README), "exec")
    with contextlib.redirect_stdout(printed):
        exec(code, namespace)
    return printed.getvalue()


def difference(expected: str, found: str) -> str | None:
    """None where what was printed is what was to be printed."""
    checker = doctest.OutputChecker()
    if checker.check_output(expected, found, OPTIONS):
        return None
    return checker.output_difference(doctest.Example("", expected), found, OPTIONS)


EXAMPLES = examples(README.read_text(encoding="utf-8")) if README.is_file() else []


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """For each example what it printed, or the error that stopped it."""
    namespace: dict[str, object] = {"__name__": "__readme__"}
    found: list[str | Exception] = []
    with contextlib.chdir(tmp_path_factory.mktemp("readme")):
        for example in EXAMPLES:
            try:
                found.append(run(example, namespace))
            except Exception as error:  # noqa: BLE001 (raised again by the example's own test)
                found.append(error)
    return found


def test_readme_has_examples():
    assert EXAMPLES, f"{README.name} has no python block"


@pytest.mark.parametrize("number", range(len(EXAMPLES)), ids=[f"line{e.line}" for e in EXAMPLES])
def test_example(number, results):
    found, expected = results[number], EXAMPLES[number].output
    if isinstance(found, Exception):
        raise found
    if expected is not None:
        wrong = difference(expected, found)
        assert wrong is None, wrong


PAGE = """# Page

```python
x = 1
print(x)
```

```text
1
```

Prose.

```python
print(x / 0)
```

```console
$ run
```

```text
not an output
```
"""


def test_blocks_are_found_with_their_lines_and_outputs():
    first, second = examples(PAGE)
    assert first == Example(4, "x = 1\nprint(x)\n", "1\n")
    assert (second.line, second.output) == (15, None)


def test_names_carry_over_and_errors_name_the_line():
    first, second = examples(PAGE)
    namespace: dict[str, object] = {}
    assert run(first, namespace) == "1\n"
    with pytest.raises(ZeroDivisionError) as caught:
        run(second, namespace)
    assert caught.traceback[-1].lineno + 1 == second.line


@pytest.mark.parametrize(
    ("expected", "found", "same"),
    [
        ("1 2\n", "1   2\n", True),
        ("took ... s\n", "took 0.31 s\n", True),
        ("1\n", "2\n", False),
        ("1\n", "", False),
    ],
)
def test_outputs_are_compared(expected, found, same):
    assert (difference(expected, found) is None) is same
