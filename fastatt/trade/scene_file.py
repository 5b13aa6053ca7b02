"""Scenes and initial states from text: options of the command line, JSON or TOML files."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt import checks
from fastatt.scene import rates, torques
from fastatt.scene.scene import Scene

_KEYS = ("inertia", "rate", "torque", "frame", "allow_unphysical")
_MODULES = {"rate": rates, "torque": torques}
# models of functions or of other models can't be given as text
_WORDLESS = ("Custom", "Sum")


def read_scene(path: Path) -> Scene:
    """Read the scene in a ``.json`` or ``.toml`` file.

    Keys are ``inertia``, ``frame``, ``allow_unphysical``, and ``rate`` or ``torque``: a table, or a
    list of tables that are summed, with the name of the ``model`` and its numbers.

    Raises ``ValueError`` for anything else, naming the key; ``OSError`` if the file can't be read.
    """
    text = path.read_text(encoding="utf-8")
    if path.suffix not in (".json", ".toml"):
        raise ValueError(f"{path}: found the ending {path.suffix!r}; accepted: .json and .toml")
    try:
        found = json.loads(text) if path.suffix == ".json" else tomllib.loads(text)
    except ValueError as error:  # of either parser
        raise ValueError(f"{path}: {error}") from None
    for key in found if isinstance(found, dict) else [found]:
        checks.choice(str(path), key, _KEYS)
    for key in found.keys() & _MODULES.keys():
        several = found[key] if isinstance(found[key], list) else [found[key]]
        found[key] = _summed(key, [_of_table(key, item) for item in several])
    return Scene(**found)


def _of_table(kind: str, table: Any) -> Any:
    if not isinstance(table, dict) or "model" not in table:
        raise ValueError(f'{kind}: found {checks.brief(table)}; accepted: a table with a "model"')
    numbers = dict(table)
    return model(kind, str(numbers.pop("model")), numbers)


def _summed(kind: str, models: Sequence[Any]) -> Any:
    return models[0] if len(models) == 1 else _MODULES[kind].Sum(tuple(models))


def from_words(kind: str, words: Sequence[Sequence[str]]) -> Any:
    """The sum of models that are given as words, such as ``["Damping", "coefficient=0.02"]``."""
    found = []
    for name, *settings in words:
        numbers = {}
        for setting in settings:
            key, equals, value = setting.partition("=")
            if not equals:
                raise ValueError(f"--{kind}: found {setting!r}; accepted: name=number,number")
            numbers[key] = _numbers(f"--{kind} {name} {key}", value)
        found.append(model(kind, name, numbers))
    return _summed(kind, found)


def _numbers(name: str, text: str) -> Any:
    try:
        found = [float(part) for part in text.split(",")]
    except ValueError:
        raise ValueError(f"{name}: found {text!r}; accepted: numbers") from None
    return found if len(found) > 1 else found[0]


def model(kind: str, name: str, numbers: Mapping[str, Any]) -> Any:
    """A model of ``fastatt.rates`` or ``fastatt.torques`` by its name.

    Raises ``ValueError`` for an unknown name or number, and if one is missing.
    """
    module = _MODULES[kind]
    names = [n for n in module.__all__ if n not in _WORDLESS]
    cls = getattr(module, checks.choice(kind, name, names))
    for key in numbers:
        checks.choice(f"{kind} {name}", key, [field.name for field in fields(cls)])
    missing = [f.name for f in fields(cls) if f.name not in numbers and f.default is MISSING]
    if missing:
        raise ValueError(f"{kind} {name}: {', '.join(missing)} is missing")
    return cls(**numbers)


def read_rows(option: str, path: Path, columns: int) -> NDArray[np.float64]:
    """Rows of numbers from a ``.npy`` file or a text table with commas.

    Raises ``ValueError`` for another shape; ``OSError`` if the file can't be read.
    """
    if path.suffix not in (".csv", ".npy"):
        raise ValueError(f"{option}: found the ending {path.suffix!r}; accepted: .csv and .npy")
    try:
        found = np.load(path) if path.suffix == ".npy" else np.loadtxt(path, delimiter=",", ndmin=2)
    except ValueError as error:
        raise ValueError(f"{option}: {path}: {error}") from None
    shapes = f"({columns},) or (N, {columns})"
    return checks.array(option, found, shapes).astype(np.float64)
