"""Loops around formulas: over rows, over steps, over a log's samples, over what stays in place."""

import numpy as np
import pytest

from fastatt.codegen.rows import LogFunction, RowFunction
from fastatt.codegen.scalar import scalar_function
from fastatt.tracing import dual
from fastatt.tracing.formulas import axpy, quat


def normalised(t, x, p):
    return quat.normalise(x), t * p[0]


def test_rows():
    repeated = RowFunction(normalised, {"t": None, "x": 4, "p": 2}, (4, None))
    n = 700
    x = np.random.default_rng(0).normal(size=(n, 4))
    t, p = np.linspace(0.0, 1.0, n), (2.0, 5.0)
    q, s = repeated(t, x, p)
    assert (s == 2.0 * t).all()
    one = scalar_function(quat.normalise)
    assert q.tolist() == [list(one(tuple(row))) for row in x.tolist()]
    threads = repeated(t, x, p, n_threads=3)
    assert all((a == b).all() for a, b in zip(threads, (q, s), strict=True))
    back, _ = repeated(0.0, x[::-1], p)
    assert (back == q[::-1]).all()
    with pytest.raises(ValueError, match=r"x: has shape \(700,\); accepted: \(..., 4\)"):
        repeated(t, t, p)


def derived(x, p):
    y = quat.exp(dual.seed(x, 3))
    return dual.value(y), tuple(s for c in y for s in dual.derivatives(c, 3)), p[0]


def test_rows_of_derivatives():
    x = np.random.default_rng(1).normal(size=(2, 5, 3))
    found = RowFunction(derived, {"x": 3, "p": 1}, (4, 12, None))(x, (2.0,))
    single = scalar_function(derived)
    true = [[single(tuple(row), (2.0,)) for row in rows] for rows in x.tolist()]
    for a, b in zip(found, range(3), strict=True):
        assert a.tolist() == np.array([[row[b] for row in rows] for rows in true]).tolist()


# what goes from sample to sample


def turned(x, w, h, bias):
    q, t = x[:4], x[4]
    u = tuple(h[0] * (a - b) for a, b in zip(w, bias, strict=True))
    return quat.mul(q, quat.exp(u)), t + h[0]


FOLD = LogFunction(turned, {"x": 5, "w": 3, "h": 1, "bias": 3}, (5,))


def folded(n_logs, n_threads=1):
    generator = np.random.default_rng(3)
    w, bias = generator.normal(size=(19, 11, 3)), generator.normal(size=(19, 3))
    start = np.tile((1.0, 0.0, 0.0, 0.0, 0.0), (n_logs, 1))
    spans = np.linspace(0.1, 0.2, 11)[None, :, None]
    return FOLD(start, (w[:n_logs], spans), (bias[:n_logs],), n_threads), w, bias, spans


def test_a_fold_is_the_steps_of_each_log():
    found, w, bias, spans = folded(19)
    one = scalar_function(turned)
    for end, rates, b in zip(found, w, bias, strict=True):
        x = (1.0, 0.0, 0.0, 0.0, 0.0)
        for rate, h in zip(rates, spans[0], strict=True):
            q, t = one(x, tuple(rate.tolist()), tuple(h.tolist()), tuple(b.tolist()))
            x = (*q, t)
        assert end.tolist() == list(x)
    # however many there are, and however they are shared out
    for n, threads in ((1, 1), (3, 2), (19, 2)):
        assert (folded(n, threads)[0] == found[:n]).all()


# arrays that stay where they are


@pytest.mark.parametrize("n", [1, 5, 40])
def test_in_place(n):
    def moved(x, y, k):
        return axpy(k[0], y, x), x[0]

    x, y, k, first = (
        np.arange(2.0 * n).reshape(n, 2),
        np.ones((n, 2)),
        np.array([[3.0]]),
        np.ones(n),
    )
    call = RowFunction(moved, {"x": 2, "y": 2, "k": 1}, (2, None)).bound((x, y, k), (x, first))
    start = x.copy()
    for i in range(1, 4):
        call()
        assert (first == start[:, 0] + 3.0 * (i - 1)).all()
        assert (x == start + 3.0 * i).all()
    k[:] = -9.0
    call()
    assert (x == start).all()
