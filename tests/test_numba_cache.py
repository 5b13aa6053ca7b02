"""The cache folder follows the source."""

from __future__ import annotations

import os
import time

import pytest
from numba_cache import IN_USE, cache_dir


@pytest.fixture
def root(tmp_path):
    (tmp_path / "fastatt" / "kernels").mkdir(parents=True)
    (tmp_path / "fastatt" / "__init__.py").write_text("")
    (tmp_path / "fastatt" / "kernels" / "quat.py").write_text("one")
    return tmp_path


def test_same_source_same_folder(root):
    assert cache_dir(root) == cache_dir(root)


@pytest.mark.parametrize("change", ["edit", "rename", "add"])
def test_changed_source_new_folder(root, change):
    before = cache_dir(root)
    kernel = root / "fastatt" / "kernels" / "quat.py"
    if change == "edit":
        kernel.write_text("two")
    elif change == "rename":
        kernel.rename(kernel.with_name("dcm.py"))
    else:
        kernel.with_name("so3.py").write_text("")
    assert cache_dir(root) != before


def test_new_folder_removes_those_no_longer_in_use(root):
    caches = root / ".numba_cache"
    old, young = caches / "old", caches / "young"
    for folder in (old, young):
        folder.mkdir(parents=True)
        (folder / "kernel.nbc").write_text("")
    past = time.time() - 2.0 * IN_USE
    os.utime(old, (past, past))
    current = cache_dir(root)
    assert sorted(caches.iterdir()) == sorted([current, young])


def test_tests_run_with_a_cache_of_their_own():
    assert os.environ["NUMBA_CACHE_DIR"]
