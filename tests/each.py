"""Many small cases in one test, where pytest's own work would take longer than theirs."""

from __future__ import annotations

import functools
import inspect
import traceback

import pytest


def each(names, cases):
    """As ``pytest.mark.parametrize``, in one test that names every case that fails."""
    names = names.replace(" ", "").split(",") if isinstance(names, str) else list(names)

    cases = list(cases)
    assert cases

    def decorate(test):
        signature = inspect.signature(test)

        @functools.wraps(test)
        def of_all(**others):
            failed = []
            for case in cases:
                given = dict(zip(names, [case] if len(names) == 1 else case, strict=True))
                try:
                    test(**given, **others)
                except (Exception, pytest.fail.Exception):  # noqa: BLE001 (of all kinds)
                    failed.append(f"{given}:\n{traceback.format_exc()}")
            assert not failed, "\n".join([f"{len(failed)} of {len(cases)} cases", *failed])

        kept = [p for name, p in signature.parameters.items() if name not in names]
        of_all.__signature__ = signature.replace(parameters=kept)
        return of_all

    return decorate
