"""Every public name has a numpydoc docstring that fits its signature, with examples that run."""

import doctest
import enum
import importlib
import inspect
import pkgutil
import re
import types
from pathlib import Path

import griffe
from each import each

import fastatt as fa

#: modules whose functions and classes are public, in addition to the names of ``fastatt`` itself
MODULES = [
    "closed_form", "dask", "estimation", "forces", "gyro", "gyro_steps", "interchange", "plots",
    "rates", "torques",
]  # fmt: skip
#: methods that packages of the library call on each other's objects
INTERNAL = {
    "Event": {"frozen", "watch"},
    "Plan": {"equations", "events_key", "run", "width"},
    "Scene": {"carried", "dependence", "memo", "packed"},
    "TimeSeries": {"numbers_at", "traced_at"},
}  # fmt: skip
#: classes with fields for the library's own use
WITH_OTHERS = {"LazyTrajectory", "PerBodySteps", "Plan", "Recommendation", "Trajectory"}
#: examples that compile programs which no other test needs; pages show the same calls, and run them
SLOW = {
    "GyroIntegrator", "Trajectory", "check_convergence", "estimation.run_tangent", "event",
    "interchange.read_aem", "per_body_steps", "recommend", "torques.ReactionWheels",
    "work_precision",
}  # fmt: skip
OPTIONS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


def module_names(name, module):
    """Public functions and classes of a module."""
    for member in getattr(module, "__all__", None) or vars(module):
        found = getattr(module, member)
        defined = inspect.unwrap(getattr(found, "py_func", found))
        here = getattr(defined, "__module__", None) == module.__name__
        if not member.startswith("_") and (hasattr(module, "__all__") or here):
            yield f"{name}.{member}", found


def public_names():
    """Objects by their public names."""
    found = {name: getattr(fa, name) for name in fa.__all__}
    for name in MODULES:
        module = getattr(fa, name, None) or importlib.import_module(f"fastatt.{name}")
        found |= module_names(name, module)
    found |= module_names("estimation.preintegration", fa.estimation.preintegration)
    for name in fa.kernels.__all__:
        found |= module_names(f"kernels.{name}", getattr(fa.kernels, name))
    for page in (Path(fa.__file__).parent / "docs" / "reference").glob("*.md"):
        text = page.read_text(encoding="utf-8")
        for name in re.findall(r"^::: fastatt\.(\S+\.[A-Z]\w+)$", text, re.MULTILINE):
            found.setdefault(name, pkgutil.resolve_name(f"fastatt.{name}"))
    return {
        name: getattr(value, "py_func", value)
        for name, value in found.items()
        if callable(value) and not isinstance(value, types.GenericAlias)
    }


def members(name, value):
    """Public methods and properties of a class, its bases in the library included."""
    if not inspect.isclass(value) or issubclass(value, (enum.Enum, Exception, tuple)):
        return
    for base in value.__mro__:
        if base.__module__.startswith("fastatt"):
            for member, found in vars(base).items():
                function = getattr(found, "__func__", getattr(found, "func", found))
                hidden = member.startswith("_") or member in INTERNAL.get(value.__name__, ())
                is_member = callable(function) or isinstance(found, property)
                if is_member and not hidden and not is_model(value) and in_source(base, member):
                    yield f"{name}.{member}", found


def is_model(value):
    """Whether a class is a rate, torque or force, whose methods are for other models."""
    from fastatt.scene.models import Model

    return issubclass(value, Model)


def in_source(base, name):
    """Whether a name is defined as a function, not as the default value of a field."""
    return f"def {name}(" in inspect.getsource(base)


PUBLIC = public_names()
FUNCTIONS = {name: f for name, f in PUBLIC.items() if not inspect.isclass(f)}
CLASSES = {name: c for name, c in PUBLIC.items() if inspect.isclass(c)}
MEMBERS = {k: v for name, value in CLASSES.items() for k, v in members(name, value)}
METHODS = {
    name: getattr(f, "__func__", f)
    for name, f in MEMBERS.items()
    if inspect.isfunction(getattr(f, "__func__", f))
}
PROPERTIES = {name: f for name, f in MEMBERS.items() if name not in METHODS}


def sections(value):
    """Sections of a docstring by their kinds."""
    text = inspect.getdoc(value)
    assert text, "has no docstring"
    parsed = griffe.Docstring(text).parse("numpy", warnings=False)
    return {section.kind.value: section.value for section in parsed}


def entries(documented):
    """Names with their types, of a section of parameters, attributes or results."""
    for entry in documented:
        assert entry.annotation, f"{entry.name}: has no type"
        assert entry.description, f"{entry.name}: has no description"
    return [entry.name.lstrip("*") for entry in documented]


def parameters(value):
    """Names of a function's or a class's parameters, as its signature has them."""
    return [name for name in inspect.signature(value).parameters if name not in ("self", "cls")]


def gives_something(value):
    """Whether a function returns a value; kernels have no annotations and always do."""
    return inspect.signature(value).return_annotation not in ("None", None)


@each("name, value", sorted((FUNCTIONS | METHODS).items()))
def test_functions(name, value):
    found = sections(value)
    assert entries(found.get("parameters", [])) == parameters(value)
    if gives_something(value):
        assert entries(found["returns"]) is not None
    else:
        assert "returns" not in found


def test_properties():
    assert [name for name, value in PROPERTIES.items() if not inspect.getdoc(value)] == []


@each("name", sorted(CLASSES))
def test_classes(name):
    """What users make has its parameters, what functions return its attributes."""
    value = CLASSES[name]
    found = sections(value)
    if issubclass(value, (Exception, enum.Enum)):
        return
    if "parameters" in found:
        assert entries(found["parameters"]) == parameters(value)
    else:
        documented = ", ".join(entries(found["attributes"])).split(", ")
        if value.__name__ not in WITH_OTHERS:
            fields = getattr(value, "__dataclass_fields__", getattr(value, "_fields", ()))
            assert set(fields) <= set(documented)


EXAMPLES = [name for name, value in PUBLIC.items() if ">>>" in (inspect.getdoc(value) or "")]


@each("name", sorted(set(EXAMPLES) - SLOW))
def test_examples(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = inspect.getdoc(PUBLIC[name]) or ""
    example = doctest.DocTestParser().get_doctest(text, {}, name.replace(".", "_"), None, 0)
    printed = []
    doctest.DocTestRunner(optionflags=OPTIONS).run(example, out=printed.append)
    assert not printed, "".join(printed)
