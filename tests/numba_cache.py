"""Where Numba keeps what it compiled: a folder for each state of the package's source.

Numba's disk cache looks at the file of the function that it compiled, not at the files of the
kernels inlined into it, so an edited kernel would be tested in its old form. Run as a script,
this prints the folder.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
IN_USE = 3600.0  # s: another run may still be working in a folder this young


def source_hash(package: Path) -> str:
    """Hash of names and contents of all modules below ``package``."""
    digest = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        for part in (path.relative_to(package).as_posix().encode(), path.read_bytes()):
            digest.update(len(part).to_bytes(8, "little"))
            digest.update(part)
    return digest.hexdigest()[:16]


def cache_dir(root: Path = ROOT) -> Path:
    """The folder for the source as it is now, made; when it is new, old ones are removed."""
    caches = root / ".numba_cache"
    current = caches / source_hash(root / "fastatt")
    if not current.is_dir():
        oldest = time.time() - IN_USE
        for other in caches.glob("*"):
            if other.stat().st_mtime < oldest:
                shutil.rmtree(other, ignore_errors=True)
    current.mkdir(parents=True, exist_ok=True)
    os.utime(current)
    return current


if __name__ == "__main__":
    print(cache_dir())
