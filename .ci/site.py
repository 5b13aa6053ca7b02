"""Hooks of MkDocs: the changelog and the pages of ``bench/`` become pages of the site.

Links between these and the pages of ``fastatt/docs`` are paths in the repository, so that they work
wherever the files are read; here they become paths in the site. Roles of docstrings, such as
``:func:``, become links, and the one script that the theme loads from another host a file.
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path

from mkdocs.structure.files import File

ROOT = Path(__file__).resolve().parents[1]
DOCS = "fastatt/docs/"
ROLE = re.compile(r":(?:attr|class|data|func|meth|mod):<code>~?([\w.]+)</code>")
SHIM = "https://unpkg.com/iframe-worker/shim"
LINK = re.compile(r"\]\((?!\w+:)([^)\s#]+)")


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


def on_page_content(html, **_):
    return ROLE.sub(r'<autoref identifier="\1" optional><code>\1</code></autoref>', html)


def on_post_page(output, page, **_):
    here = posixpath.dirname(page.url) or "."
    return output.replace(SHIM, posixpath.relpath("assets/worker.js", here))


def on_post_template(output, **_):
    return output.replace(SHIM, "assets/worker.js")
