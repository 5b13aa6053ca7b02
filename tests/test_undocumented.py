"""What the package uses of Numba and llvmlite beyond their documentation, and without it."""

import ast
import functools
import json
import os
import re
import runpy
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path

import numba
import numpy as np
import pytest

import fastatt
from fastatt import _numba

PACKAGE = Path(fastatt.__file__).parent
# documented: llvmlite's layer of instructions, and Numba's functions for extensions
DOCUMENTED = {"numba", "numba.extending", "numba.types", "llvmlite", "llvmlite.ir"}


def process(code, *arguments, **env):
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments],
        env=os.environ | env, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_kernels_are_kept_for_each_stamp(tmp_path, monkeypatch):
    file = tmp_path / "kept_function.py"
    file.write_text("from numba import njit\n@njit\ndef add(x, y):\n    return x + y\n")
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "kept"))
    for stamp, hits, files in (("1", 0, 2), ("1", 1, 2), ("2", 0, 4), ("1", 1, 4)):
        add = runpy.run_path(str(file))["add"]
        _numba.keep(add, stamp)
        add(1.0, 2.0)
        kept = list(Path(add.stats.cache_path).iterdir())
        assert (sum(add.stats.cache_hits.values()), len(kept)) == (hits, files)


def test_no_other_file_uses_what_is_not_documented():
    found = []
    for file in PACKAGE.rglob("*.py"):
        if file.name == "_numba.py":
            continue
        source = file.read_text()
        for node in ast.walk(ast.parse(source)):
            modules = [x.name for x in node.names] if isinstance(node, ast.Import) else []
            modules += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            of = [x for x in modules if x.partition(".")[0] in ("numba", "llvmlite")]
            found += [(file.name, x) for x in of if x not in DOCUMENTED]
        assert not re.search(r"\.pointee|\._insert|\.make_(array|tuple)|\.overloads", source)
    assert found == []


# interfaces taken away, in a release that was not seen

AMPUTATED = '''
import json, math, sys, warnings
from contextlib import suppress
import llvmlite.ir, numba
import numpy as np
from numba.core import (
    analysis, base, codegen, compiler, cpu, dispatcher, imputils, ir_utils, typed_passes
)

interface, way = sys.argv[1:]
numba.__version__ = "0.99.0"


numba.njit(lambda: 0)()  # Numba has read its own modules


def broken(*args, **named):
    raise RuntimeError("broken")


def is_ours():
    return sys._getframe(2).f_globals["__name__"].startswith("fastatt")


def taken(name, silent):
    if way == "deleted":
        raise AttributeError(name)
    return broken() if way == "raising" else silent


class Gone:
    """An attribute of a class that is as before for Numba alone."""

    def __init__(self, cls, name, silent):
        self.was, self.name, self.silent = getattr(cls, name, None), name, silent
        setattr(cls, name, self)

    def __get__(self, instance, cls):
        if is_ours():
            return taken(self.name, self.silent)
        if instance is not None and self.name in getattr(instance, "__dict__", ()):
            return instance.__dict__[self.name]
        return self.was.__get__(instance, cls)

    def __set__(self, instance, value):
        if self.name != "compile":  # which Numba would call by another name
            instance.__dict__[self.name] = value


def of_module(module, name, silent):
    class Taken(type(module)):
        pass

    Taken.__getattribute__ = lambda self, x: (
        taken(x, silent) if x == name and is_ours() else super(Taken, self).__getattribute__(x)
    )
    module.__class__ = Taken


def of_option(name):
    (cls,) = (x for x in cpu.CPUTargetOptions.__mro__ if name in vars(x))
    if way == "deleted":
        delattr(cls, name)
    else:
        apply = broken if way == "raising" else lambda x: True
        setattr(cls, name, cls.Mapping("nrt", apply) if hasattr(cls, "Mapping")
                else cpu.CPUTargetOptions.Mapping("nrt", apply))


def nothing(*args, **named):
    pass


class Loops:
    loops = dict


TAKEN = {
    "none": nothing,
    "_nrt": lambda: of_option("_nrt"),
    "overloads": lambda: Gone(dispatcher.Dispatcher, "overloads", {}),
    "entry_point": lambda: Gone(compiler.CompileResult, "entry_point", None),
    "enable_caching": lambda: Gone(dispatcher.Dispatcher, "enable_caching", nothing),
    "compile": lambda: Gone(dispatcher.Dispatcher, "compile", nothing),
    "mk_unique_var": lambda: of_module(ir_utils, "mk_unique_var", nothing),
    "compute_cfg_from_blocks": lambda: of_module(
        analysis, "compute_cfg_from_blocks", lambda blocks: Loops
    ),
    "PreLowerStripPhis": lambda: of_module(typed_passes, "PreLowerStripPhis", None),
    "lower_constant": lambda: of_module(imputils, "lower_constant", lambda ty: lambda f: f),
    "make_array": lambda: Gone(base.BaseContext, "make_array", nothing),
    "make_tuple": lambda: Gone(base.BaseContext, "make_tuple", nothing),
    "_insert": lambda: Gone(llvmlite.ir.IRBuilder, "_insert", nothing),
    "numba.dynamic.globals": lambda: setattr(
        codegen.CodeLibrary, "has_dynamic_globals", broken if way == "raising" else False
    ),
}
TAKEN[interface]()
told = warnings.catch_warnings(record=True).__enter__()
warnings.simplefilter("always")
import fastatt as fa

body = fa.Scene(inertia=(2.0, 1.0, 0.7))
start = [1.0, 0.0, 0.0, 0.0], [0.1, 0.2, 0.3]
found = {}


def smoke(f):
    try:
        found[f.__name__] = np.ravel(f()).tolist()
    except Exception as error:
        found[f.__name__] = str(error)


@smoke
def propagate():
    """A torque that is followed."""
    scene = fa.Scene(inertia=(2.0, 1.0, 0.7), torque=lambda t, q, w, p: (0.1 * q[1], -w[0], 0.0))
    return fa.propagate(scene, *start, dt=0.1, n_steps=7, method="rk4").q[-1]


free = fa.propagate(body, *start, dt=0.1, n_steps=7, method="rk4")


@smoke
def single_precision():
    return fa.propagate(body, *start, dt=2.0, n_steps=7, method="strang2", dtype="float32").q[-1]


@smoke
def plan():
    return fa.plan(body, 1, dt=0.1, n_steps=7, method="rk4")(*start).q[-1]


@smoke
def logs():
    rates = np.linspace(0.0, 1.0, 33).reshape(11, 3)
    return fa.integrate_rates(rates, 0.1, method="coning2")[-1]


@smoke
def filters():
    mekf = fa.estimation.MEKF(start[0], 0.01 * np.eye(6), angle_noise=1e-3, bias_noise=1e-5)
    mekf.predict((0.0, 0.0, 0.1), 0.01)
    mekf.update_vector((0.0, 0.1, 1.0), (0.0, 0.0, 1.0), sigma=0.01)
    return mekf.q


@smoke
def kernel():
    return fa.kernels.quat.mul((0.6, 0.8, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0))


@smoke
def core_is_alone():
    return "fastatt.codegen.written" in sys.modules


@smoke
def called():
    """A function that is compiled by Numba."""
    def rate(t, p):
        return 0.1, 0.2, math.gamma(1.5 + t)
    return fa.propagate(fa.Scene(rate=rate), start[0], dt=0.1, n_steps=7).q[-1]


@smoke
def powers():
    """One that would overflow."""
    def rate(t, p):
        n = int(math.gamma(25.0 + t))
        return 0.1, 0.2, float(n**3)
    return fa.propagate(fa.Scene(rate=rate), start[0], dt=0.1, n_steps=7).status


@smoke
def single_step():
    stepper = fa.single_step(body, method="rk4")
    step, x = stepper.step, stepper.state(*start)
    @numba.njit(fastmath=True)
    def run(x, p):
        for _ in range(7):
            x = step(0.0, 0.1, x, p)
        return x
    return np.subtract(run(x, stepper.params)[:4], free.q[-1])


@smoke
def integers():
    """They are refused, or the package tells that they are not."""
    with suppress(numba.TypingError):
        fa.kernels.quat.mul((1, 0, 0, 0), (0, 1, 0, 0))
        return [x for x in told if "integers" in str(x.message)] == []
    return False


@smoke
def versions():
    """One warning says which are newer."""
    return [str(x.message) for x in told if "versions" in str(x.message)] == [
        "versions: found Numba 0.99.0 (seen: up to 0.68); "
        "interfaces that may differ are tried before they are used"
    ]


print(json.dumps(found))
'''

NAMES = re.findall(r'^    "(?!none)(\S+)": lambda', AMPUTATED, re.MULTILINE)
#: what may be refused, and how
REFUSED = {
    "called": "(functions that are followed)",
    "powers": "(functions that are followed)",
    "single_step": "(all but single steps in jitted code, which alone use it)",
}
TOLD = "numba: found Numba 0.99.0, llvmlite .*, Python .*, where this differs: .*; accepted: "


@pytest.fixture(scope="module")
def amputated(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cache")

    @functools.cache
    def found(interface, way):
        # programs do not depend on what is taken away, but for the option with which they are made
        cache = str(folder / interface if interface == "_nrt" else folder)
        return json.loads(process(AMPUTATED, interface, way, FASTATT_CACHE=cache))

    return found


WAYS = ("deleted", "raising", "silent")
#: a process takes ten seconds: of each interface one way a day, and all of them by `make fuzz`
TODAY = {(x, WAYS[(datetime.now(UTC).toordinal() + i) % 3]) for i, x in enumerate(NAMES)}
TODAY |= {(x, "deleted") for x in ("overloads", "compile", "mk_unique_var")}
EVERY = {(x, way) for x in NAMES for way in WAYS}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("interface", "way"), sorted(EVERY if "FASTATT_MINUTES" in os.environ else TODAY)
)
def test_without_it_numbers_are_right_or_one_message_tells(amputated, interface, way):
    """Right is what it gives with all of them."""
    found, expected = amputated(interface, way), amputated("none", "")
    assert found.keys() == expected.keys()
    for name, value in found.items():
        if value != expected[name]:
            assert name in REFUSED
            assert re.search(TOLD + REFUSED[name], value), value
    assert np.abs(expected["single_step"]).max() < 1e-9
    assert expected["versions"] == [True]
