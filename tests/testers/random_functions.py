"""Functions of users made at random, beside Python: what a scene runs, what it refuses.

``functions``: conditions, early returns, helpers, writes in place, aliases, containers, methods,
tables. ``values``: what a function refers to changes between making a scene and running it, also
for copies, pickles, subsets and plans. ``impure``: functions that give another value at each call or
write outside. A case is followed, called or refused; any other number than Python's is an error.
"""

from __future__ import annotations

import copy
import dataclasses
import linecache
import math
import pickle
import random

import numpy as np

import fastatt as fa
from fastatt.tracing.user import user_function

HEAD = """import math, random, time, datetime, itertools
import numpy as np
LIMIT, GAIN, CFG = 0.7, 1.3, {"gain": 0.8, "lim": 2.0, "deep": {"k": 1.5}}
TABLE = np.array([0.1, 0.4, -0.3, 0.9, 1.7]); ROWS = np.arange(12.0).reshape(4, 3) * 0.1
XS, YS = np.linspace(-2.0, 3.0, 6), np.array([0.3, -1.0, 2.0, 0.1, 0.5, -0.7])
LIST, NESTED = [0.5, -0.25, 2.0], [[1.0, 2.0], [3.0, 4.0]]
class Box:
    kind = 0.6
    def __init__(self):
        self.gain, self.m, self.n, self.last, self.log = 0.9, np.diag([1.0, 2.0, 3.0]), 2, 0.0, []
    def scaled(self, x): return self.gain * x + self.kind
    def cut(self, u, x):
        if x > self.gain: return u
        u[0] = x
        return u
    @property
    def twice(self): return 2.0 * self.gain
BOX = Box()
"""


class Writer:
    """Writes a random function."""

    def __init__(self, seed: int) -> None:
        self.r = random.Random(seed)
        self.lines: list[str] = []
        self.n = 0

    def pick(self, *options):
        return self.r.choice(options)()

    def name(self, letter: str) -> str:
        self.n += 1
        return f"{letter}{self.n}"

    # expressions

    def constant(self) -> str:
        return self.r.choice(
            ["0.0", "1.0", "0.5", "-0.3", "2", "2.5", "1", "LIMIT", "GAIN", "-1.0", "0.1"]
        )

    def number(self, depth: int = 0) -> str:
        r, v = self.r, self.names
        if depth > 2 or r.random() < 0.35:
            options = [*v["x"], *v["x"], self.constant(), "t", f"w[{r.randrange(3)}]"]
            return r.choice([*options, f"q[{r.randrange(4)}]", f"p[{r.randrange(2)}]"])
        a, b = (self.number(depth + 1) for _ in range(2))
        options = [
            f"({a} + {b})", f"({a} - {b})", f"{a} * {b}", f"-{a}", f"abs({a})", f"{a} / (1.5 + {b} * {b})",
            f"math.sin({a})", f"math.sqrt(abs({a}))", f"min({a}, {b})", f"max({a}, {b}, 0.1)",
            f"math.tanh({a})", f"{a} % 1.7", f"({a}) // 0.9", f"float({a})", f"({a}) ** 2", f"np.sign({a})",
            f"math.hypot({a}, {b})", f"math.atan2({a}, 0.5 + abs({b}))", f"math.copysign({a}, {b} + 0.3)",
            f"({a} if {self.condition(depth + 1)} else {b})", f"round({a})", f"math.floor({a})",
            f"CFG['gain'] * {a}", "CFG['deep']['k']", f"BOX.scaled({a})", "BOX.twice", "LIST[1]",
            f"TABLE[int(abs({a})) % 5]", f"TABLE[int({a})]", f"np.interp({a}, XS, YS)", f"np.clip({a}, -1.0, {b})",
            f"math.fmod({a}, 0.7)", f"(({self.condition(depth + 1)}) * {a})", f"pow({a}, 3)", f"divmod({a}, 0.8)[1]",
            "NESTED[1][0]", f"ROWS[int(abs({a})) % 4, 1]", f"[{a}, {b}][{self.r.randrange(2)}]",
        ]  # fmt: skip
        if v["u"]:
            u = r.choice(v["u"])
            options += [
                f"{u}[{r.randrange(3)}]", f"np.linalg.norm({u})", f"np.dot({u}, w)", f"{u}.sum()",
                f"sum({u})", f"np.max({u})", f"sum(x * x for x in {u})",
            ]  # fmt: skip
        if v["l"]:
            x = r.choice(v["l"])
            options += [
                f"{x}[{r.randrange(3)}]", f"sum({x})", f"max({x})", f"float(len({x}))",
                f"sorted({x})[0]",
            ]  # fmt: skip
        if v["d"]:
            options += [f"{r.choice(v['d'])}['k']"] * 2
        if v["n"]:
            n = r.choice(v["n"])
            options += [n, f"(1.0, 2.0, -3.0, 4.0)[{n} % 4]", f"float({n})", f"1 / (1 + {n} * {n})"]
        return r.choice(options)

    def condition(self, depth: int = 0) -> str:
        r, v = self.r, self.names
        a, b = self.number(depth + 1), self.number(depth + 1)
        simple = f"{a} {r.choice(['<', '>', '<=', '>='])} {r.choice([b, self.constant()])}"
        options = [simple] * 5
        if depth < 2:
            options += [
                f"({simple} and {self.condition(depth + 1)})",
                f"({simple} or {self.condition(depth + 1)})", f"not ({simple})",
                f"-1.0 < {a} < {b}",
            ]  # fmt: skip
        if v["f"]:
            f = r.choice(v["f"])
            options += [f, f"not {f}", f"{f} == 1", f"({f} and {simple})"]
        if v["m"]:
            options += [f"{r.choice(v['m'])} == 'a'"] * 2
        if v["n"]:
            options += [f"{r.choice(v['n'])} > 1"]
        return r.choice(options)

    def vector(self) -> str:
        r = self.r
        a = [self.number(1) for _ in range(3)]
        options = [
            "np.array(w)", f"np.array([{', '.join(a)}])", "np.zeros(3)", "np.array(q[1:])",
            f"np.full(3, {self.constant()})", "-0.5 * np.array(w)",
        ]  # fmt: skip
        if self.names["u"]:
            u, v = (r.choice(self.names["u"]) for _ in range(2))
            options += [
                f"{u} * {a[0]}", f"{u} + {v}", f"np.cross({u}, {v})", f"{u}.copy()",
                f"np.where({u} > {a[0]}, {v}, {a[1]})", f"np.clip({u}, -1.0, 1.0)", f"BOX.m @ {u}",
                f"np.abs({u})", f"np.sign({u})", f"np.minimum({u}, {a[0]})", f"ROWS[1] + {u}",
                f"np.concatenate([{u}[:1], {v}[1:]])",
            ]  # fmt: skip
        return r.choice(options)

    # statements

    def block(self, depth: int, count: int) -> None:
        kept = {k: list(x) for k, x in self.names.items()}
        before = len(self.lines)
        for _ in range(count):
            self.statement(depth)
        if len(self.lines) == before:
            self.put(depth, "pass")
        if depth > 1:
            self.names = kept

    def put(self, depth: int, text: str) -> None:
        self.lines.append("    " * depth + text)

    def statement(self, depth: int) -> None:
        r, v = self.r, self.names
        ways = [
            "number", "number", "vector", "list", "flag", "change", "change", "if", "if", "loop",
            "count", "dict", "mode", "helper", "method",
        ]  # fmt: skip
        way = r.choice(ways)
        if way == "number":
            x = r.choice(v["x"]) if v["x"] and r.random() < 0.4 else self.name("x")
            self.put(
                depth,
                f"{x} {r.choice(['=', '=', '+=', '*=']) if x in v['x'] else '='} {self.number()}",
            )
            v["x"].append(x)
        elif way == "vector":
            u = self.name("u")
            self.put(
                depth, f"{u} = {r.choice(v['u']) if v['u'] and r.random() < 0.3 else self.vector()}"
            )
            v["u"].append(u)
        elif way == "list":
            x = self.name("l")
            text = f"[{', '.join(self.number(1) for _ in range(3))}]"
            if v["l"] and r.random() < 0.4:
                text = r.choice(
                    [r.choice(v["l"]), f"[y * 0.5 for y in {r.choice(v['l'])}]", "list(w)"]
                )
            self.put(depth, f"{x} = {text}")
            v["l"].append(x)
        elif way == "flag":
            f = self.name("f")
            self.put(depth, f"{f} = {self.condition()}")
            v["f"].append(f)
        elif way == "mode":
            m = self.name("m")
            self.put(depth, f"{m} = 'a' if {self.condition()} else 'b'")
            v["m"].append(m)
        elif way == "dict":
            d = self.name("d")
            self.put(depth, f"{d} = {{'k': {self.number(1)}}}")
            v["d"].append(d)
        elif way == "count":
            if v["n"] and r.random() < 0.6:
                self.put(depth, f"{r.choice(v['n'])} += 1")
            else:
                n = self.name("n")
                self.put(depth, f"{n} = {r.choice(['0', '1', '2', 'int(abs(w[0])) % 3'])}")
                v["n"].append(n)
        elif way == "change":
            self.change(depth)
        elif way == "if" and depth < 4:
            self.put(depth, f"if {self.condition()}:")
            self.block(depth + 1, r.randrange(1, 3))
            if r.random() < 0.15:
                ends = [f"return {self.result()}", f"return {self.result()}"]
                self.put(depth + 1, r.choice([*ends, "raise ValueError('far')"]))
            if r.random() < 0.25:
                self.put(depth, f"elif {self.condition()}:")
                self.block(depth + 1, 1)
            if r.random() < 0.4:
                self.put(depth, "else:")
                self.block(depth + 1, r.randrange(1, 3))
        elif way == "loop" and depth < 3:
            i = self.name("i")
            self.put(depth, f"for {i} in range(3):")
            if v["u"] and r.random() < 0.6:
                u = r.choice(v["u"])
                self.put(depth + 1, f"if {u}[{i}] > {self.number(1)}: {u}[{i}] = {self.number(1)}")
            self.block(depth + 1, 1)
            if r.random() < 0.2:
                self.put(depth + 1, f"if {self.condition()}: break")
        elif way == "helper":
            x = self.name("x")
            u = r.choice(v["u"]) if v["u"] else "np.array(w)"
            self.put(depth, f"{x} = {r.choice(self.helpers)}({u}, {self.number(1)})")
            v["x"].append(x)
        elif way == "method" and v["u"]:
            u = self.name("u")
            self.put(depth, f"{u} = BOX.cut({r.choice(v['u'])}, {self.number(1)})")
            v["u"].append(u)

    def change(self, depth: int) -> None:
        r, v = self.r, self.names
        if v["u"] and r.random() < 0.7:
            u, a = r.choice(v["u"]), self.number(1)
            k, n = r.randrange(3), r.randrange(3)
            ways = [f"{u}[{k}] = {a}", f"{u} *= {a}", f"{u} += np.array(w)", f"{u}[1:] -= {a}"]
            ways += [f"{u}[{n}] += {a}", f"{u}[:] = {a}", f"{u}[{u} > 0.5] = {a}"]
            self.put(depth, r.choice(ways))
        elif v["l"]:
            x = r.choice(v["l"])
            ways = [f"{x}[{r.randrange(3)}] = {self.number(1)}", f"{x} += [1.0]"]
            self.put(depth, r.choice([*ways, f"{x}.append({self.number(1)})", f"{x}.reverse()"]))
        elif v["d"]:
            self.put(depth, f"{r.choice(v['d'])}['k'] = {self.number(1)}")

    def result(self) -> str:
        r, v = self.r, self.names
        a = ", ".join(self.number(1) for _ in range(3))
        options = [f"({a})", f"[{a}]", f"np.array([{a}])"]
        if v["u"]:
            options += [r.choice(v["u"])] * 3
        if v["l"]:
            options += [f"{r.choice(v['l'])}[:3]"]
        return r.choice(options)

    def fresh(self, numbers=(), vectors=()) -> None:
        self.names = {k: [] for k in "xulfdnm"}
        self.names["x"], self.names["u"] = list(numbers), list(vectors)

    def function(self) -> str:
        self.helpers = []
        self.fresh()
        for k in range(2):
            self.fresh(["x"], ["u"])
            self.put(
                0,
                f"def h{k}(u, x, t=0.5, w=(0.1, -0.2, 0.3), q=(1.0, 0.0, 0.0, 0.0), p=(0.5, 0.25)):",
            )
            if not self.helpers:
                self.helpers = ["BOX_"]
            self.helpers = [x for x in self.helpers if x != "BOX_"] or ["h_plain"]
            self.block(1, self.r.randrange(1, 4))
            self.put(1, f"return {self.number(1)}")
            self.helpers.append(f"h{k}")
        self.helpers = ["h0", "h1"]
        self.fresh()
        self.put(0, "def torque(t, q, w, p):")
        self.block(1, self.r.randrange(3, 8))
        self.put(1, f"return {self.result()}")
        plain = "def h_plain(u, x):\n    u[0] = x\n    return x + u[1]\n"
        return HEAD + plain + "\n".join(self.lines) + "\n"


def module_of(text: str, name: str) -> dict:
    """A module's names, from its text."""
    linecache.cache[name] = len(text), None, text.splitlines(keepends=True), name
    scope: dict = {"__name__": "__main__"}
    exec(compile(text, name, "exec"), scope)
    return scope


def points(seed: int, n: int = 24) -> list:
    """Arguments of many sizes."""
    r = np.random.default_rng(1000 + seed)
    found = []
    for _ in range(n):
        q = r.normal(size=4)
        w, p = (r.normal(size=k) * 10.0 ** r.uniform(-2.0, 2.0) for k in (3, 2))
        t = float(r.choice([0.0, r.uniform(0.0, 3.0), r.uniform(0.0, 100.0)]))
        found.append(
            (t, tuple((q / np.linalg.norm(q)).tolist()), tuple(w.tolist()), tuple(p.tolist()))
        )
    return found


def values_of(made, point) -> np.ndarray:
    """What the library gives."""
    t, q, w, p = point
    row = [t, *q, *w, *p]
    return np.array(made.recording.replay(row) if made.followed else made(*row), float)


def asked(function, point):
    """What Python gives: numbers, or an error."""
    with np.errstate(all="ignore"):
        return np.array([float(x) for x in function(*copy.deepcopy(point))])


def agrees(function, made, point) -> bool | None:
    """Whether the library gives what Python gives; None where a rounding decides."""
    found = values_of(made, point)
    try:
        true = asked(function, point)
    except (ArithmeticError, ValueError) as error:
        return None if str(error) != "far" else not np.isfinite(found).all()
    except Exception:  # noqa: BLE001
        return not np.isfinite(found).all()
    if _close(true, found):
        return True
    t, q, w, p = point
    scope, moves = function.__globals__, (1.0 - 3e-12, 1.0 + 3e-12, 1.0 - 1e-9)
    for k, way in [(k, None) for k in moves] + [(1.0, -math.inf), (1.0, math.inf)]:
        moved = t * k, q, tuple(x * k for x in w), tuple(x * k for x in p)
        scope["math"] = math if way is None else Ulps(way)
        try:
            other = asked(function, moved)
        except Exception:  # noqa: BLE001
            return None
        finally:
            scope["math"] = math
        if not _close(true, other, 1e-11) and not _close(true, other, 1e-7):
            return None
    return False


class Ulps:
    """``math``, whose functions are right to an ulp only."""

    def __init__(self, way: float) -> None:
        self.way = way

    def __getattr__(self, name: str):
        function = getattr(math, name)
        near = name in ("sin", "tanh", "sqrt", "hypot", "atan2")
        return (lambda *x: math.nextafter(function(*x), self.way)) if near else function


def _close(a, b, tolerance: float = 1e-7) -> bool:
    if len(a) != len(b):
        return False
    size = np.abs(a[np.isfinite(a)]).max(initial=1e-12)
    return bool(np.allclose(a, b, rtol=tolerance, atol=tolerance * size, equal_nan=True))


def of_functions(seed: int) -> tuple[str, str]:
    """(followed, called, refused or an error, what is wrong)."""
    text = Writer(seed).function()
    scope = module_of(text, f"<random {seed}>")
    box = pickle.dumps(scope["BOX"].__dict__)
    try:
        made = user_function(scope["torque"], "torque", 2)
    except TypeError as error:
        return "refused", str(error)
    except Exception as error:  # noqa: BLE001
        return "error", f"{type(error).__name__}: {error}\n{text[len(HEAD) :]}"
    if pickle.dumps(scope["BOX"].__dict__) != box or scope["LIST"] != [0.5, -0.25, 2.0]:
        return "error", f"objects changed\n{text[len(HEAD) :]}"
    for point in points(seed):
        if agrees(scope["torque"], made, point) is False:
            try:
                true = asked(scope["torque"], point)
            except Exception as error:  # noqa: BLE001
                true = repr(error)
            return (
                "error",
                f"{made}\n{point}\n{true}\n{values_of(made, point)}\n{text[len(HEAD) :]}",
            )
    return ("followed" if made.followed else "called"), made.reason


# values that change

HOLDERS = {
    "K": ("K = 0.5", "K", "K = 0.9"),
    "list": ("L = [0.5]", "L[0]", "L[0] = 0.9"),
    "nested list": ("L = [[0.5]]", "L[0][0]", "L[0][0] = 0.9"),
    "dict": ("D = {'k': 0.5}", "D['k']", "D['k'] = 0.9"),
    "nested dict": ("D = {'a': {'k': 0.5}}", "D['a']['k']", "D['a']['k'] = 0.9"),
    "array": ("A = np.array([0.5])", "A[0]", "A[0] = 0.9"),
    "array of an object": ("class O: pass\nO1 = O(); O1.a = np.array([0.5])", "O1.a[0]", "O1.a[0] = 0.9"),
    "attribute": ("class O: pass\nO1 = O(); O1.k = 0.5", "O1.k", "O1.k = 0.9"),
    "class attribute": ("class O: k = 0.5", "O.k", "O.k = 0.9"),
    "class attribute of an object": ("class O: k = 0.5\nO1 = O()", "O1.k", "O.k = 0.9"),
    "property": ("class O:\n    g = 0.25\n    @property\n    def k(self): return 2 * self.g\nO1 = O()", "O1.k", "O.g = 0.45"),
    "method": ("class O:\n    def __init__(self): self.g = 0.5\n    def k(self): return self.g\nO1 = O()", "O1.k()", "O1.g = 0.9"),
    "callable": ("class O:\n    def __init__(self): self.g = 0.5\n    def __call__(self): return self.g\nO1 = O()", "O1()", "O1.g = 0.9"),
    "slots": ("class O:\n    __slots__ = 'k',\nO1 = O(); O1.k = 0.5", "O1.k", "O1.k = 0.9"),
    "default": ("D = [0.5]\ndef h(x=D): return x[0]", "h()", "D[0] = 0.9"),
    "keyword default": ("def h(*, x=0.5): return x", "h()", "h.__kwdefaults__['x'] = 0.9"),
    "helper": ("def h(): return 0.5", "h()", "def h(): return 0.9"),
    "helper of a helper": ("K = 0.5\ndef g(): return K\ndef h(): return g()", "h()", "K = 0.9"),
    "closure": ("def make():\n    k = 0.5\n    def h(): return k\n    def put(x):\n        nonlocal k\n        k = x\n    return h, put\nh, put = make()", "h()", "put(0.9)"),
    "closure on a list": ("def make(l):\n    def h(): return l[0]\n    return h\nL = [0.5]; h = make(L)", "h()", "L[0] = 0.9"),
    "partial": ("import functools\nL = [0.5]\ndef g(l): return l[0]\nh = functools.partial(g, L)", "h()", "L[0] = 0.9"),
    "jitted": ("from numba import njit\nK = 0.5\n@njit\ndef h(): return K", "h()", "K = 0.9"),
    "module": ("import types\nM = types.ModuleType('M'); M.k = 0.5", "M.k", "M.k = 0.9"),
    "named tuple": ("import collections\nT = collections.namedtuple('T', 'a')([0.5])", "T.a[0]", "T.a[0] = 0.9"),
    "data class": ("import dataclasses\n@dataclasses.dataclass\nclass O:\n    k: float = 0.5\nO1 = O()", "O1.k", "O1.k = 0.9"),
    "method of a class": ("class O:\n    def k(self): return 0.5\nO1 = O()", "O1.k()", "O.k = lambda self: 0.9"),
    "lambda": ("h = lambda: 0.5", "h()", "h = lambda: 0.9"),
    "code": ("def h(): return 0.5", "h()", "h.__code__ = (lambda: 0.9).__code__"),
}  # fmt: skip
BODIES = {
    "followed": "return {v} * p[0], 0.0, 0.0",
    "branch": "if t > 50.0: return 0.0, 0.0, 0.0\n    return {v} * p[0], 0.0, 0.0",
    "called": "n = 0\n    while n < t: n += 1\n    return {v} * p[0], 0.0, 0.0",
}
COPIES = {
    "itself": lambda s: s, "copy": copy.copy, "deepcopy": copy.deepcopy,
    "pickle": lambda s: pickle.loads(pickle.dumps(s)), "replace": dataclasses.replace,
    "other params": lambda s: dataclasses.replace(s, params=s.params),
}  # fmt: skip


def of_values(seed: int) -> tuple[str, str]:
    """A scene is made, a value changes, a copy runs."""
    r = random.Random(seed)
    holder, body, how = r.choice(list(HOLDERS)), r.choice(list(BODIES)), r.choice(list(COPIES))
    first, value, change = HOLDERS[holder]
    about = f"{holder}, {body}, {how}"
    text = f"import numpy as np\n{first}\ndef rate(t, p):\n    {BODIES[body].format(v=value)}\ndef change():\n"
    scope = module_of(text + "    pass\n", f"<values {seed}>")
    rows = r.random() < 0.5
    scope["__name__"] = "values"
    try:
        scene = fa.Scene(rate=scope["rate"], params=[[1.0], [1.0]] if rows else (1.0,))
    except TypeError as error:
        return "refused", f"{about}: {error}"
    late = r.random() < 0.5
    scene = scene if late else COPIES[how](scene)
    exec(change, scope)
    scene = COPIES[how](scene) if late else scene
    if rows and r.random() < 0.5:
        scene = scene[1]
    (made,) = scene.functions
    if not made.followed:
        found = made(1.0, 1.0)[0]
    elif seed % 20 == 0:
        n = scene.rows or 1
        found = fa.propagate(scene, np.tile([1.0, 0, 0, 0], (n, 1)), dt=1.0, n_steps=0, t0=1.0).w[
            -1, -1, 0
        ]
    else:
        found = made.recording.replay([1.0, 1.0])[0]
    try:
        other = fa.Scene(rate=scope["rate"], params=scene.params)
        (new,) = other.functions
        again = new.recording.replay([1.0, 1.0])[0] if new.followed else new(1.0, 1.0)[0]
    except TypeError as error:
        return "error", f"{about}: a new scene is refused: {error}"
    if abs(found - 0.5) > 1e-12 or abs(again - 0.9) > 1e-12 or scene == other:
        return "error", f"{about}: {found}, then {again}, equal {scene == other}"
    return ("followed" if made.followed else "called"), made.reason


# impure ones

IMPURE = [
    ("R = np.random.default_rng(1)", "R.normal()"), ("", "np.random.normal()"), ("", "random.random()"),
    ("", "time.time()"), ("", "time.perf_counter() * 1e-9"), ("", "float(datetime.datetime.now().second)"),
    ("C = itertools.count()", "float(next(C))"), ("G = (x for x in range(9))", "float(next(G))"),
    ("N = [0.0]", "N.append(1.0) or float(len(N))"), ("N = [1.0, 2.0]", "N.pop()"),
    ("N = {}", "N.setdefault(len(N), 1.0)"), ("O = Box()", "O.__setattr__('last', 1.0) or O.last"),
    ("from random import gauss", "gauss(0.0, 1.0)"), ("from time import time as clock", "clock()"),
    ("import os", "float(os.getpid())"), ("", "float(id(p))"), ("", "float(hash('a') % 7)"),
    ("NORMAL = np.random.normal", "NORMAL()"), ("N = np.zeros(3)", "N.__setitem__(0, 1.0) or N[0]"),
    ("def h(l=[]):\n    l.append(1.0)\n    return float(len(l))", "h()"),
    ("K = 0.0\ndef h():\n    global K\n    K += 1.0\n    return K", "h()"),
    ("def make():\n    k = 0.0\n    def h():\n        nonlocal k\n        k += 1.0\n        return k\n    return h\nh = make()", "h()"),
    ("class C:\n    k = 0.0\n    def up(self):\n        self.k += 1.0\n        return self.k\nC1 = C()", "C1.up()"),
    ("class C: k = 0.0\ndef h():\n    C.k += 1.0\n    return C.k", "h()"),
    ("N = np.zeros(3)\ndef h():\n    N[0] += 1.0\n    return N[0]", "h()"),
    ("N = np.zeros(3)\ndef h():\n    v = N[:2]\n    v += 1.0\n    return N[0]", "h()"),
    ("N = [0.0]\ndef h():\n    v = N\n    v[0] += 1.0\n    return N[0]", "h()"),
    ("M = {'a': 0.0}\ndef h():\n    M['a'] += 1.0\n    return M['a']", "h()"),
    ("", "float(str(t)[:3])"), ("", "float(f'{t:.2f}')"), ("", "float(len(repr(w[0])))"),
    ("import secrets", "float(secrets.randbelow(9))"), ("import threading", "float(threading.get_ident())"),
    ("IT = iter([1.0] * 99)", "next(IT)"), ("class O: n = 0\nO1 = O()", "(setattr(O1, 'n', O1.n + 1), float(O1.n))[1]"),
    ("def h(x):\n    h.n = x\n    return x", "h(t)"), ("S = set()", "S.add(1) or 1.0"),
]  # fmt: skip


PLACES = [
    "return {v}, 0.0, 0.0", "x = 0.5\n    if t > 1.0: x = {v}\n    return x, 0.0, 0.0",
    "n = 0\n    while n < t: n += 1\n    return {v}, 0.0, 0.0", "return [{v} * k for k in w]",
    "def inner(): return {v}\n    return inner(), 0.0, 0.0", "return (lambda: {v})(), w[0], 0.0",
]  # fmt: skip


def of_impure(seed: int) -> tuple[str, str]:
    """A function that is not the same at each call, or that writes outside."""
    r = random.Random(seed)
    return impure(*r.choice(IMPURE), r.choice(PLACES))


def impure(first: str, value: str, body: str) -> tuple[str, str]:
    """The function that is written with a value at a place."""
    text = f"{HEAD}{first}\ndef torque(t, q, w, p):\n    {body.format(v=value)}\n"
    scope = module_of(text, "<impure>")
    about = f"{first}; {value}; {body}"
    before = repr({k: x for k, x in scope.items() if k in ("N", "M", "K", "S")})
    try:
        made = user_function(scope["torque"], "torque", 2)
    except TypeError as error:
        after = repr({k: x for k, x in scope.items() if k in ("N", "M", "K", "S")})
        placed = "<impure>:" in str(error) or ".py:" in str(error)
        return ("refused", "") if after == before and placed else ("error", f"{about}: {error}")
    return "error", f"{about}: accepted as {made}"
