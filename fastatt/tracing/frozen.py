"""Functions of users, frozen: what they refer to is read when a scene is made, and never written.

A frozen function has the code of the user's, with copies of globals, closures, defaults, containers
and attributes. Sources of other values at each call (random numbers, clocks, counters) and writes
to what is outside the function are refused.
"""

from __future__ import annotations

import builtins
import contextlib
import dis
import enum
import functools
import inspect
import linecache
import math
import sys
import types
from collections.abc import Callable, Iterator
from typing import Any, NoReturn

import numpy as np
from numba.extending import is_jitted

from fastatt._numba import SEEN
from fastatt.tracing.nodes import RefusedError, TraceError
from fastatt.tracing.unknown import Unknown, is_number

_SOURCES = frozenset((
    "random numpy.random _random time datetime os posix secrets uuid threading _thread io _io "
    "socket subprocess gc weakref"
).split())  # fmt: skip
_READING = frozenset((
    "id hash input open print globals locals vars eval exec compile setattr delattr breakpoint"
).split())  # fmt: skip
#: Python's builtins that a frozen function finds as they are
ALLOWED: dict[str, Any] = {
    k: x for k, x in vars(builtins).items() if isinstance(x, type) and issubclass(x, BaseException)
} | {
    k: getattr(builtins, k) for k in (
        "abs all any bool callable dict divmod enumerate filter frozenset getattr hasattr iter len "
        "list map next range reversed set slice sorted sum tuple zip repr format"
    ).split()
}  # fmt: skip
SAME = (
    "accepted: a function that gives the same for the same arguments, since a step evaluates it "
    "several times; a fastatt.TimeSeries or params hold numbers that are made before the run"
)
OUTSIDE = "accepted: a function that changes nothing outside it; states hold what a step carries on"


def refuse(what: str, why: str, file: str, line: int) -> NoReturn:
    """Refuse a function, with the line."""
    raise RefusedError(f"{what} ({place(file, line)}); {why}")


def placed(text: str, file: str, line: int) -> TraceError:
    """The error, with the line."""
    error = TraceError(f"{text} ({place(file, line)})")
    error.where = f"{file}:{line}"
    return error


def place(file: str, line: int) -> str:
    """A line of code: ``file:line: text``."""
    text = linecache.getline(file, line).strip()
    return f"{file}:{line}{f': {text}' if text else ''}"


def plain(function: Any) -> Any:
    """The function, and of a jitted one that which Numba compiles."""
    # of an object that computes its attributes, ``__class__`` too
    is_known = _function_in(type(function), "__getattribute__") is None
    return function.py_func if is_known and is_jitted(function) else function


def inner_of(function: Any) -> Any:
    """The Python function of a partial, a method, a jitted function or an object with __call__."""
    function = plain(function)
    if isinstance(function, functools.partial):
        return inner_of(function.func)
    if isinstance(function, types.MethodType):
        return inner_of(function.__func__)
    call = inspect.getattr_static(type(function), "__call__", None)
    return call if isinstance(call, types.FunctionType) else function


def signature_of(function: Any) -> inspect.Signature:
    """The arguments of a function; none of one that does not tell them."""
    bound = types.MethodType(inner_of(function), function) if _computes(function) else function
    try:
        return inspect.signature(plain(bound))
    except (TypeError, ValueError):
        return inspect.Signature()


def name_of(function: Any) -> str:
    """The name of a function, also of a partial or an object."""
    named = inner_of(function) if _computes(function) else function
    return str(getattr(named, "__name__", getattr(inner_of(function), "__name__", "function")))


def codes_of(code: types.CodeType) -> Iterator[types.CodeType]:
    """The code, and that of functions within it."""
    yield code
    for x in code.co_consts:
        if isinstance(x, types.CodeType):
            yield from codes_of(x)


def names_of(code: types.CodeType) -> set[str]:
    """Names of globals in code."""
    return {name for op, name, _ in _instructions(code) if op in ("LOAD_GLOBAL", "LOAD_NAME")}


# what a function's code does, without running it


_LOADS = ("LOAD_GLOBAL", "LOAD_NAME", "LOAD_DEREF")
_CATCHES = ("POP_EXCEPT", "CHECK_EXC_MATCH", "WITH_EXCEPT_START")
_TEXTS = ("str", "repr", "format", "ascii")
_MAKES_TEXT = ("FORMAT_VALUE", "FORMAT_SIMPLE", "FORMAT_WITH_SPEC")
#: by instructions; {} is the name that they are about
_WRITES = {
    **dict.fromkeys(("STORE_ATTR", "DELETE_ATTR"), "the attribute {}, which changes"),
    **dict.fromkeys(("STORE_GLOBAL", "DELETE_GLOBAL"), "the statement global"),
    **dict.fromkeys(("STORE_DEREF", "DELETE_DEREF"), "the statement nonlocal"),
    "IMPORT_NAME": "the statement import",
    "LOAD_BUILD_CLASS": "the statement class",
}
#: the newest Python whose instructions are known: others than these do no harm
_NEWEST = SEEN["Python"]


@functools.lru_cache(maxsize=4096)
def _instructions(code: types.CodeType) -> list[tuple[str, Any, int]]:
    """(instruction, what it is about, line) of code, and of functions within it."""
    instructions: list[tuple[str, Any, int]] = []
    for part in codes_of(code):
        line = part.co_firstlineno
        for x in dis.get_instructions(part):
            line = (x.positions and x.positions.lineno) or line
            instructions.append((x.opname, x.argval, line))
    return instructions


def check(function: types.FunctionType, *, texts: bool) -> None:
    """Refuse a function whose code reads what differs between calls, or writes outside it.

    With ``texts`` those that make texts are refused too; without, ``TraceError`` is raised for one
    that catches errors.
    """
    code, values, before = function.__code__, dict(function.__globals__), None
    if sys.version_info[:2] > _NEWEST:
        newest = ".".join(map(str, _NEWEST))
        what = f"the instructions of Python {sys.version.split()[0]}, which are not known"
        refuse(what, f"accepted: Python 3.11 to {newest}", code.co_filename, code.co_firstlineno)
    for name, cell in zip(code.co_freevars, function.__closure__ or (), strict=True):
        with contextlib.suppress(ValueError):  # a name without a value
            values[name] = cell.cell_contents
    for op, name, line in _instructions(code):
        where, builtin = (code.co_filename, line), op in _LOADS and name not in values
        is_math = op == "IMPORT_NAME" and name.partition(".")[0] in ("math", "numpy")
        is_own = op.endswith("_DEREF") and name not in code.co_freevars
        if op in _WRITES and not is_math and not is_own:
            refuse(_WRITES[op].format(name), OUTSIDE, *where)
        if (builtin and name in _READING) or (op in _LOADS and is_source(values.get(name))):
            refuse(f"{name}, which may differ from call to call", SAME, *where)
        if op in ("LOAD_ATTR", "LOAD_METHOD") and name == "random":
            refuse("random, which may differ from call to call", SAME, *where)
        if op == "IS_OP" and isinstance(before, bool):
            refuse("`is` with True or False, which depends on the type", SAME, *where)
        if texts and (op in _MAKES_TEXT or (builtin and name in _TEXTS)):
            refuse("the text of a number", SAME, *where)
        if op in _CATCHES and not texts:
            raise placed(f"{function.__name__} catches errors", *where)
        before = name if op == "LOAD_CONST" else None


def is_source(value: Any) -> bool:
    """Whether it gives other values at each call: a generator, a clock, an iterator."""
    if isinstance(value, types.ModuleType):
        return value.__name__ in _SOURCES
    of = () if _computes(value) or not callable(value) else (getattr(value, "__self__", None),)
    where = {x.__module__ if isinstance(x, type) else type(x).__module__ for x in (value, *of)}
    where.update(str(getattr(value, "__module__", "") or "") for _ in of)
    of_source = any(x in _SOURCES or x.startswith("numpy.random") for x in where)
    return of_source or hasattr(type(value), "__next__")


def _function_in(cls: type, name: str) -> types.FunctionType | None:
    """A Python function of a class, None if there is none of that name."""
    attribute = inspect.getattr_static(cls, name, None)
    return attribute if isinstance(attribute, types.FunctionType) else None


def _computes(value: Any) -> bool:
    """Whether functions of the user's give its attributes."""
    return any(_function_in(type(value), x) for x in ("__getattr__", "__getattribute__"))


# values that are read and not written


_NOTHING = object()


def _unwritten(cls: type, names: str) -> None:
    """Let functions of a class refuse to change it; in messages it has its base's name."""
    cls.__name__ = cls.__mro__[1].__name__

    def no(*_: Any, **__: Any) -> NoReturn:
        raise RefusedError(f"a {cls.__name__} from outside the function that it changes")

    for name in names.split():
        setattr(cls, name, no)


class _LIST(list[Any]):
    pass


class _DICT(dict[Any, Any]):
    """A dictionary whose keys are compared one by one with a number that records."""

    def _key(self, key: Any, *, has_it: bool = False) -> Any:
        if not isinstance(key, Unknown):
            return key
        *others, last = [k for k in self if is_number(k)] or [math.nan]
        for k in others:
            if k == key:
                return k
        if has_it:
            key.recorder.guard("==", key, last, KeyError)
        return last if has_it or last == key else _NOTHING

    def __getitem__(self, key: Any) -> Any:
        return super().__getitem__(self._key(key, has_it=True))

    def __contains__(self, key: Any) -> bool:
        return super().__contains__(self._key(key))

    def get(self, key: Any, other: Any = None) -> Any:
        """The value of a key, or another."""
        return super().get(self._key(key), other)


_unwritten(
    _LIST,
    "append extend insert pop remove clear sort reverse __setitem__ __delitem__ __iadd__ __imul__",
)
_unwritten(_DICT, "update setdefault pop popitem clear __setitem__ __delitem__ __ior__")


class Held:
    """An object, class or module as it is now: it is read, but not written."""

    __slots__ = ("_freezer", "of")

    def __init__(self, of: Any, freezer: Freezer) -> None:
        object.__setattr__(self, "of", of)
        object.__setattr__(self, "_freezer", freezer)

    def __getattr__(self, name: str) -> Any:
        of, freezer, cls = self.of, self._freezer, type(self.of)
        of_class, attribute = (inspect.getattr_static(x, name, _NOTHING) for x in (cls, of))
        is_of_class = attribute is of_class
        if _function_in(cls, "__getattribute__"):
            raise TraceError(f"an attribute of a {cls.__name__}, which has __getattribute__")
        if attribute is _NOTHING and (get := _function_in(cls, "__getattr__")):
            return freezer.function(get)(self, name)
        if is_of_class and isinstance(attribute, types.FunctionType):
            return types.MethodType(freezer.function(attribute), self)
        if is_of_class and isinstance(attribute, (property, types.DynamicClassAttribute)):
            return freezer.function(attribute.fget)(self)
        if is_of_class and isinstance(attribute, functools.cached_property):
            return freezer.function(attribute.func)(self)
        get = _function_in(type(attribute), "__get__")
        is_known = isinstance(attribute, enum.property) or is_jitted(attribute)
        if get and not is_known and (is_of_class or isinstance(of, type)):
            owner = (self, freezer(cls)) if is_of_class else (None, self)
            return freezer.function(get)(freezer(attribute), *owner)
        value = getattr(of, name)
        is_plain = not callable(value) and not isinstance(value, types.ModuleType)
        if attribute is _NOTHING and is_plain:
            raise TraceError(f"{name}, which a function of a {cls.__name__} gives")
        return freezer(value)

    def __call__(self, *args: Any, **named: Any) -> Any:
        """Call it; an object is not made."""
        if isinstance(self.of, type):
            raise TraceError(f"it makes a {self.of.__name__}")
        return self.__getattr__("__call__")(*args, **named)


Held.__name__ = "object"  # in messages


def _special(name: str) -> Callable[..., Any]:
    def call(self: Held, *args: Any) -> Any:
        if inspect.getattr_static(type(self.of), name, _NOTHING) is _NOTHING:
            raise TypeError(f"a {type(self.of).__name__} has no {name}")
        return self.__getattr__(name)(*args)

    return call


def _written(*_: Any) -> NoReturn:
    raise RefusedError("an object from outside the function that it changes")


for _name in ("getitem", "len", "iter", "contains", "matmul", "add", "sub", "mul"):
    setattr(Held, f"__{_name}__", _special(f"__{_name}__"))
for _name in ("setitem", "delitem", "setattr", "delattr"):
    setattr(Held, f"__{_name}__", _written)


def _held_as(base: type) -> type:
    """Numbers or texts of a class of the user's, whose further attributes are those of ``Held``."""
    return type(base.__name__, (base,), {
        "__getattr__": Held.__getattr__, "__setattr__": _written, "__delattr__": _written,
    })  # fmt: skip


_HELD_AS: dict[Any, Any] = {x: _held_as(x) for x in (int, float, complex, str, tuple)}


class Freezer:
    """Makes frozen values; one object stays one.

    ``known`` replaces values of libraries, ``scope`` are names of all frozen functions, and
    ``code`` gives the code of a function.
    """

    def __init__(self, known: Callable[..., Any], scope: Any, code: Callable[..., Any]) -> None:
        self._known, self._scope, self._code = known, scope, code
        #: (frozen, value) by the identity of the value, which is kept alive
        self._pairs: dict[int, tuple[Any, Any]] = {}

    def __call__(self, value: Any) -> Any:
        """The frozen value."""
        if value is None or type(value) in _CONSTANTS:
            return value
        if id(value) not in self._pairs:
            self._pairs[id(value)] = self._frozen(value), value
        return self._pairs[id(value)][0]

    def _frozen(self, value: Any) -> Any:
        if is_source(value):
            raise RefusedError(f"{value!r:.60}, which may differ from call to call")
        if (known := self._known(value)) is not None:
            return known
        if isinstance(plain(value), types.FunctionType):
            return self.function(plain(value))
        if isinstance(value, np.generic):
            return value.item()
        if isinstance(value, enum.Flag) and not _has_functions(type(value)):
            return value
        if isinstance(value, tuple):
            parts = tuple(map(self, value))
            is_plain = hasattr(type(value), "_fields") and not _has_functions(type(value))
            if is_plain or type(value) is tuple:
                return type(value)(*parts) if is_plain else parts
            return self._held_as(value, parts)
        if isinstance(value, (int, float, complex, str)):
            return self._held_as(value, value)
        if isinstance(value, list):
            return _LIST(map(self, value))
        if isinstance(value, dict):
            return _DICT((self(k), self(x)) for k, x in value.items())
        if isinstance(value, (set, frozenset)):
            return frozenset(map(self, value))
        if isinstance(value, functools.partial):
            named = {k: self(x) for k, x in value.keywords.items()}
            return functools.partial(self(value.func), *map(self, value.args), **named)
        if isinstance(value, types.MethodType):
            return types.MethodType(self(value.__func__), self(value.__self__))
        if isinstance(value, type(_instructions)):  # one that keeps its results
            return self(value.__wrapped__)
        is_plain = isinstance(value, type) and issubclass(value, (BaseException, tuple, np.generic))
        if (is_plain and not _has_functions(value)) or any(value is x for x in _CLASSES):
            return self._scope["__builtins__"].get(value.__name__, value)
        return unknown(value) if isinstance(value, _OF_C) else Held(value, self)

    def _held_as(self, value: Any, plain: Any) -> Any:
        base, cls = next((x, cls) for x, cls in _HELD_AS.items() if isinstance(value, x))
        held: Any = base.__new__(cls, plain)
        held.__dict__.update(of=value, _freezer=self)
        return held

    def function(self, function: types.FunctionType) -> Any:
        """The function with frozen globals, closure and defaults."""
        if _is_library(function):
            return unknown(function)
        if id(function) in self._pairs:
            return self._pairs[id(function)][0]
        scope = {**self._scope, "__name__": function.__module__}
        cells = tuple(types.CellType() for _ in function.__code__.co_freevars)
        frozen = types.FunctionType(self._code(function), scope, function.__name__, None, cells)
        self._pairs[id(function)] = frozen, function
        values = function.__globals__
        names = names_of(function.__code__)
        scope.update((k, self(values[k])) for k in names if k in values)
        for cell, old in zip(cells, function.__closure__ or (), strict=True):
            try:
                cell.cell_contents = self(old.cell_contents)
            except ValueError:  # the name has no value yet
                continue
        frozen.__defaults__ = function.__defaults__ and tuple(map(self, function.__defaults__))
        frozen.__kwdefaults__ = {k: self(x) for k, x in (function.__kwdefaults__ or {}).items()}
        for name, value in vars(function).items():
            before = dict(self._pairs)
            try:
                setattr(frozen, name, self(value))
            except (RefusedError, TraceError):  # it may never be read
                self._pairs = before
        return frozen


def in_python(function: Any) -> Any:
    """The user's own function, of which jitted functions run in Python; other values stay."""
    kinds = (types.FunctionType, types.MethodType, types.ModuleType, functools.partial)

    def known(value: Any) -> Any:
        return None if isinstance(plain(value), kinds) and not _is_library(value) else value

    return Freezer(known, {"__builtins__": builtins}, lambda x: x.__code__)(function)


def _is_library(value: Any) -> bool:
    name = value.__name__ if isinstance(value, types.ModuleType) else value.__module__
    return str(name).partition(".")[0] in ("numpy", "numba", "scipy")


def _has_functions(cls: type) -> bool:
    """Whether a class has functions that its author wrote, such as methods of a named tuple."""
    bases = (base for base in cls.__mro__ if base.__module__ != "enum")
    attributes = ((x, base) for base in bases for x in vars(base).values())
    written = ((getattr(x, "fget", getattr(x, "__func__", x)), base) for x, base in attributes)
    return any(
        isinstance(x, types.FunctionType) and x.__module__ == base.__module__ for x, base in written
    )


_OF_C = (types.BuiltinFunctionType, types.MethodWrapperType)
_CONSTANTS = (bool, int, float, complex, str, bytes, range, slice, type(...))
_CLASSES = (bool, int, float, complex, str, list, tuple, dict, set, frozenset, np.ndarray, object)


def unknown(function: Any) -> Callable[..., NoReturn]:
    """A function that raises in place of one that is not known."""

    def call(*_: Any, **__: Any) -> NoReturn:
        name = function.__name__
        raise TraceError(f"{name}, which is not among the functions that are known here")

    return call


# errors in frozen functions


def guarded(function: Any, run: Callable[[], Any]) -> Any:
    """What it gives; errors name the line of the user's code."""
    try:
        return run()
    except Exception as error:
        text = str(error)
        if getattr(error, "where", "") or (isinstance(error, RefusedError) and "; acc" in text):
            raise
        file, line = _place_of(error.__cause__ or error, inner_of(function).__code__)
        if isinstance(error, RefusedError):
            refuse(text, OUTSIDE if "change" in text else SAME, file, line)
        if not isinstance(error, TraceError):
            text = f"{type(error).__name__}: {text}"
        raise placed(text, file, line) from error


def _place_of(error: BaseException, code: types.CodeType) -> tuple[str, int]:
    """(file, line) of the innermost frame of a frozen function, or of the whole code."""
    where, step = (code.co_filename, code.co_firstlineno), error.__traceback__
    while step is not None:
        if "__choose__" in step.tb_frame.f_globals:
            where = step.tb_frame.f_code.co_filename, step.tb_lineno
        step = step.tb_next
    return where
