"""The loop over small cases: none is left out, every one that fails is named."""

import pytest
from each import each


def test_every_case_that_fails_is_named(tmp_path):
    seen = []

    @each("a", [1, 2])
    @each(("b", "c"), [(3, 4), (5, 6)])
    def looked(a, b, c, tmp_path):
        seen.append((a, b, c))
        if b == 3:
            assert a == 1
        else:
            with pytest.raises(ValueError, match="never"):
                assert tmp_path.exists()

    with pytest.raises(AssertionError) as caught:
        looked(tmp_path=tmp_path)
    assert seen == [(1, 3, 4), (1, 5, 6), (2, 3, 4), (2, 5, 6)]
    told = str(caught.value)
    assert "2 of 2 cases" in told
    for case in ("{'b': 5, 'c': 6}:", "{'b': 3, 'c': 4}:", "DID NOT RAISE"):
        assert case in told


def test_no_cases_are_no_test():
    with pytest.raises(AssertionError):
        each("a", [])


def test_a_test_has_the_words_of_its_cases_where_pytest_looks_for_them():
    @each("method, n", [("rk4", 1), ("cf4", 2)])
    def looked(method, n):
        assert n

    assert {"rk4", "cf4"} <= set(vars(looked))  # of -k
