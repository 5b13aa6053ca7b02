"""Tables of runs, with a row for each save and body."""

from __future__ import annotations

from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fastatt import checks, files

if TYPE_CHECKING:
    from fastatt.propagation.trajectory import Trajectory

# rows that are converted to text at a time
_ROWS = 1 << 16


def check_run(run: Any) -> None:
    """Refuse anything but a run, whose class is in a layer above."""
    if not hasattr(run, "one_body"):
        raise TypeError(f"run: found {checks.brief(run)}; accepted: a Trajectory")


def columns(run: Trajectory) -> dict[str, NDArray[Any]]:
    """The columns of a run by name, each (S,) for one body or (S, N).

    ``t`` s; ``body`` for an ensemble; ``q0`` to ``q3``, body to inertial, scalar first; ``wx``,
    ``wy``, ``wz`` rad/s along body axes; if the scene has them, ``vx`` to ``vz`` m/s along body
    axes, ``rx`` to ``rz`` m along inertial axes, and states ``s0``, ``s1`` …, or ``wheels0``,
    ``wheels1`` … of a term with the name ``wheels``; ``status`` of the whole run.
    """
    check_run(run)
    q = run.q
    shape = q.shape[:-1]
    # read-only views, so that shared values are not copied
    t = run.t.reshape(-1, *[1] * (q.ndim - 2))
    values: dict[str, NDArray[Any]] = {"t": np.broadcast_to(t, shape)}
    if not run.one_body:
        values["body"] = np.broadcast_to(np.arange(shape[1]), shape)
    values |= {f"q{k}": q[..., k] for k in range(4)}
    for name in ("w", "v", "r"):
        if name == "w" or name in run.carried:
            vector = getattr(run, name)
            values |= {f"{name}{axis}": vector[..., k] for k, axis in enumerate("xyz")}
    if "s" in run.carried:
        names = [f"s{k}" for k in range(run.s.shape[-1])]
        for name, part in run.parts.items():
            names[part] = [f"{name}{k}" for k in range(part.stop - part.start)]
        # a name may be that of another column
        values |= {
            f"s_{name}" if name in values else name: run.s[..., k] for k, name in enumerate(names)
        }
    status = run.status[0] if run.one_body else run.status
    values["status"] = np.broadcast_to(status, shape)
    return values


def write_csv(run: Trajectory, path: str | Path) -> None:
    """Write a run as CSV with a row for each save and body, without rounding any number.

    The columns are t (s), body (for an ensemble), q0 to q3, wx to wz (rad/s), and as far as the
    scene has them vx to vz (m/s), rx to rz (m) and states s0, s1, ..., then status. States of a
    term with a name, such as wheels, are wheels0, wheels1, ....

    Parameters
    ----------
    run : Trajectory
        The run.
    path : str or Path
        The file.

    Raises
    ------
    TypeError
        If ``run`` is not a run, or ``path`` is not a path.
    ValueError
        If the path is a directory.
    OSError
        If the file can't be written.
    """
    table = columns(run)
    saves = max(1, _ROWS // run.status.size)
    parts = (
        zip(*(x[a : a + saves].ravel().tolist() for x in table.values()), strict=True)
        for a in range(0, len(run.t), saves)
    )
    files.write_csv("path", path, table, chain.from_iterable(parts))


def dataframe(run: Trajectory) -> Any:
    """Return a run as a pandas DataFrame with a row for each save and body.

    Parameters
    ----------
    run : Trajectory
        The run.

    Returns
    -------
    pandas.DataFrame
        A table with the columns of :func:`write_csv`.

    Raises
    ------
    ImportError
        If pandas is not installed.
    """
    pandas = checks.optional("to_dataframe", "pandas", "fastatt[logs]")
    return pandas.DataFrame({name: x.ravel() for name, x in columns(run).items()})
