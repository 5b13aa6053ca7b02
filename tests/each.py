"""Many small cases in one test, where pytest's own work would take longer; cases in tiers."""

import functools
import inspect
import re
import traceback

import pytest


def each(names, cases):
    """As ``pytest.mark.parametrize``, in one test that names every case that fails."""
    names = names.replace(" ", "").split(",") if isinstance(names, str) else list(names)

    cases = list(cases)
    assert cases

    def decorate(test):
        signature = inspect.signature(test)
        # pytest's -k finds a test by its attributes too, thus by a word of one of its cases
        words = {word for case in cases for word in re.findall(r"\b[A-Za-z]\w*", repr(case))}

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
        vars(of_all).update(dict.fromkeys(words, True))
        of_all.__signature__ = signature.replace(parameters=kept)
        return of_all

    return decorate


#: a case of ``pytest.mark.parametrize`` in the slow tier
slow = functools.partial(pytest.param, marks=pytest.mark.slow)


def in_tiers(often, cases):
    """Cases of ``pytest.mark.parametrize``; those that are not among ``often`` are slow."""
    rows = [(x, x if type(x) is tuple else (x,)) for x in cases]
    return [pytest.param(*row) if x in often else slow(*row) for x, row in rows]
