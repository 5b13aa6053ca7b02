"""Cases that others published: ``python bench/cases.py`` writes ``bench/CASES.md``, a table a case.

Ends with 1 where a figure is further from theirs than their own digits allow.
"""

from __future__ import annotations

from pathlib import Path

import cases_asteroids
import cases_tools
import cases_wheels
from cases_rows import page

CASES = (*cases_tools.CASES, *cases_wheels.CASES, *cases_asteroids.CASES)
OUT = Path(__file__).with_name("CASES.md")


def main() -> int:
    text = page(CASES)
    OUT.write_text(text, encoding="utf-8")
    print(text)
    return int("**apart**" in text)


if __name__ == "__main__":
    raise SystemExit(main())
