"""Hooks of MkDocs: the changelog and the pages of ``bench/`` become pages of the site.

Links between these and the pages of ``fastatt/docs`` are paths in the repository, so that they work
wherever the files are read; here they become paths in the site. Roles of docstrings, such as
``:func:``, and names in "See Also" become links, and numbers in tables are kept in one line. TeX
becomes MathML, which browsers draw without a script. Tables of ``bench/`` are left out of the
search. The one script that the theme loads from another host becomes a file.
"""

from __future__ import annotations

import posixpath
import re
from html import unescape
from pathlib import Path

from latex2mathml.converter import convert
from mkdocs.structure.files import File

ROOT = Path(__file__).resolve().parents[1]
DOCS = "fastatt/docs/"
ROLE = re.compile(r":(?:attr|class|data|func|meth|mod):<code>~?([\w.]+)</code>")
SEE_ALSO = re.compile(r'(?<=<details class="see-also" open>).*?(?=</details>)', re.DOTALL)
ENTRY = re.compile(r"^(\s*<p>|)([\w.]+) : ", re.MULTILINE)
CELL = re.compile(r"(?<=<t[dh]>)[^<]+")
NUMBER = re.compile(r"-?\d[\d.]*e[+-]\d+")
SHIM = "https://unpkg.com/iframe-worker/shim"
LINK = re.compile(r"\]\((?!\w+:)([^)\s#]+)")
# TeX as arithmatex marks it: in the text, or as a block
INLINE = re.compile(r'<span class="arithmatex">\\\((.*?)\\\)</span>', re.DOTALL)
BAR = re.compile("<mo[^>]*>&#x0007C;</mo>")
FUNCTION = re.compile(r"<mi>[a-z]{2,}</mi>(?=<mi|<mrow><mi|<mfrac)")
BLOCK = re.compile(r'<div class="arithmatex">\\\[(.*?)\\\]</div>', re.DOTALL)


def outside() -> list[str]:
    """Pages outside of the folder of pages, as paths in the repository."""
    found = [ROOT / "CHANGELOG.md", *ROOT.glob("bench/*.md")]
    return sorted(p.relative_to(ROOT).as_posix() for p in found)


def on_files(files, config):
    for path in outside():
        files.append(File.generated(config, path, abs_src_path=str(ROOT / path)))
    return files


def on_page_markdown(markdown, page, **_):
    here = page.file.src_uri
    written = here if here in outside() else DOCS + here

    def in_site(link: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join(posixpath.dirname(written), link[1]))
        path = posixpath.relpath(target.removeprefix(DOCS), posixpath.dirname(here) or ".")
        return f"]({path}"

    return LINK.sub(in_site, markdown)


def reference(name: str) -> str:
    target = name if name.startswith("fastatt.") else f"fastatt.{name}"
    return f'<autoref identifier="{target}" optional><code>{name}</code></autoref>'


def entries(see_also: str) -> str:
    """The entries of "See Also", each in a line."""
    return ENTRY.sub(lambda x: (x[1] or "<br>") + reference(x[2]) + " – ", see_also)


def formula(tex: str, display: str) -> str:
    mathml = convert(unescape(tex), display=display)
    if "\\" in mathml or ">&<" in mathml:
        raise ValueError(f"TeX: found {tex}; accepted: what latex2mathml knows")
    mathml = mathml.replace("<math", "<math data-search-exclude", 1)
    mathml = mathml.replace("<mover>", '<mover accent="true">')  # else dots are small
    mathml = BAR.sub('<mo stretchy="false" lspace="0" rspace="0">|</mo>', mathml)
    return FUNCTION.sub(r'\g<0><mspace width="0.17em" />', mathml)


def on_page_content(html, page, **_):
    if page.file.src_uri in outside():
        html = html.replace("<table>", "<table data-search-exclude>")
    html = INLINE.sub(lambda found: formula(found[1], "inline"), html)
    html = BLOCK.sub(lambda found: formula(found[1], "block"), html)
    html = ROLE.sub(lambda role: reference(role[1]), html)
    html = SEE_ALSO.sub(lambda part: entries(part[0]), html)
    return CELL.sub(lambda cell: NUMBER.sub(r'<span class="number">\g<0></span>', cell[0]), html)


def on_post_page(output, page, **_):
    here = posixpath.dirname(page.url) or "."
    return output.replace(SHIM, posixpath.relpath("assets/worker.js", here))


def on_post_template(output, **_):
    return output.replace(SHIM, "assets/worker.js")
