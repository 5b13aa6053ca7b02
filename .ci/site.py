"""Hooks of MkDocs: the changelog and the pages of ``bench/`` are pages of the site where they are.

Links between these and the pages of ``fastatt/docs`` are written as paths in the repository, so
that they work wherever the files are read; here they become paths in the site.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

from mkdocs.structure.files import File

ROOT = Path(__file__).resolve().parents[1]
DOCS = "fastatt/docs"
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
    folder = os.path.dirname(here if here in outside() else f"{DOCS}/{here}")

    def in_site(link: re.Match[str]) -> str:
        target = os.path.normpath(os.path.join(folder, link[1]))
        target = target.removeprefix(f"{DOCS}/")
        return f"]({os.path.relpath(target, os.path.dirname(here) or '.')}"

    return LINK.sub(in_site, markdown)
