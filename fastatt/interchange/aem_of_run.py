"""Attitude ephemeris messages of runs."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fastatt import checks
from fastatt.interchange import epochs
from fastatt.interchange.aem import FIXED, RATES_ALONG, TYPES, Aem, AemSegment, one_line
from fastatt.interchange.tables import check_run

if TYPE_CHECKING:
    from fastatt.propagation.trajectory import Trajectory

# s; longer than any run, and Unix time was past it in 1973
_LONG = 1e8
# before that day UTC had no leap seconds; local times of the Unix epoch are in 1969 or 1970
_FIRST_LEAPS = "1972"


def aem_of(
    run: Trajectory,
    *,
    epoch: str | datetime,
    frame: str,
    body_frame: str = "SC_BODY_1",
    body: int | None = None,
    version: str = "2.0",
    attitude_type: str | None = None,
    metadata: Mapping[str, str] | None = None,
    header: Mapping[str, str] | None = None,
) -> Aem:
    """The attitude ephemeris message of one body of a run.

    Parameters
    ----------
    run : Trajectory
        A run with saves at rising times.
    epoch : str or datetime
        Date and time of t = 0 of the run, in the TIME_SYSTEM of the metadata, which is UTC by
        default: a ``datetime``, or text such as "2026-01-01T00:00:00". From this epoch t counts
        every second, leap seconds of UTC included. "unix" states that t is Unix time, which skips
        leap seconds.
    frame : str
        Name of the inertial frame in the standard, such as "EME2000" or "ICRF".
    body_frame : str, default "SC_BODY_1"
        Name of the body frame in the standard.
    body : int, optional
        Index of the body. It is required for an ensemble, since a message describes one object.
    version : {"2.0", "1.0"}, default "2.0"
        "1.0" (CCSDS 504.0-B-1) or "2.0" (504.0-B-2).
    attitude_type : str, optional
        "QUATERNION", "QUATERNION/DERIVATIVE", "QUATERNION/RATE" in version 1.0 or
        "QUATERNION/ANGVEL" in 2.0. The default is
        "QUATERNION/RATE" in version 1.0 and "QUATERNION/ANGVEL" in 2.0, with the angular velocity.
    metadata : mapping of str to str, optional
        Further keywords, such as ``{"OBJECT_NAME": "SAT-1"}``. OBJECT_NAME and OBJECT_ID are
        "UNKNOWN" if they are not given.
    header : mapping of str to str, optional
        Further keywords of the header.

    Returns
    -------
    Aem
        A message with one segment.

    Raises
    ------
    ValueError
        If an argument does not fit, ``body`` is missing for an ensemble, an attitude is not finite,
        or times are beyond 1e8 s from an epoch before 1972, such as 1970, which Unix time and
        elapsed seconds interpret differently.
    TypeError
        If an argument has the wrong type.

    Examples
    --------
    >>> import fastatt as fa
    >>> scene = fa.Scene(rate=fa.rates.Constant((0.0, 0.0, 0.1)))
    >>> run = fa.propagate(scene, [1, 0, 0, 0], dt=1.0, n_steps=2, save_every=1, t0=1.7e9)
    >>> aem = fa.interchange.aem_of(run, epoch="unix", frame="ICRF")
    >>> aem.segments[0].epoch, aem.segments[0].t
    ('2023-11-14T22:13:20', array([0., 1., 2.]))
    """
    check_run(run)
    types = list(TYPES[checks.choice("version", version, TYPES)])
    default = types[-1] if attitude_type is None else attitude_type
    kind = checks.choice("attitude_type", default, types)
    said: dict[str, str] = {
        "OBJECT_NAME": "UNKNOWN",
        "OBJECT_ID": "UNKNOWN",
        "REF_FRAME_A": one_line("frame", frame),
        "REF_FRAME_B": one_line("body_frame", body_frame),
        "TIME_SYSTEM": "UTC",
        "ATTITUDE_TYPE": kind,
    }
    if version == "1.0":
        said |= FIXED
    if kind == types[-1]:
        said[RATES_ALONG[version]] = "REF_FRAME_B" if version == "1.0" else body_frame
    said |= _keywords("metadata", metadata)
    begin, t = _times(epoch, run.t, said["TIME_SYSTEM"])
    q, w = (np.asarray(x, dtype=np.float64) for x in _of_body(run, body))
    now = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%S")
    first = {"CREATION_DATE": now, "ORIGINATOR": "FASTATT", **_keywords("header", header)}
    direction, order = ({**FIXED, **said}[key] for key in FIXED)
    comment = f"quaternions: scalar {order.lower()}, {direction} of REF_FRAME_A and REF_FRAME_B"
    return Aem(version, first, (AemSegment(begin, t, q, w, said, (comment,)),))


def _keywords(name: str, given: Mapping[str, str] | None) -> Mapping[str, str]:
    found = {} if given is None else given
    if not isinstance(found, Mapping):
        raise TypeError(f"{name}: found {checks.brief(found)}; accepted: a mapping of str to str")
    for key, value in found.items():
        one_line(f"{name} {one_line(f'{name}: a keyword', key)}", value)
    return found


def _of_body(run: Trajectory, body: int | None) -> list[NDArray[Any]]:
    """Attitudes and angular velocities of one body."""
    n = run.status.size
    if body is None and n > 1:
        raise ValueError(
            f"body: is missing, the run has {n} bodies; accepted: 0 to {n - 1}, since a message is "
            "of one object"
        )
    if body is not None and checks.whole("body", body, 0) >= n:
        raise ValueError(f"body: found {body}; accepted: 0 to {n - 1}")
    return [x if run.one_body else x[:, body or 0] for x in (run.q, run.w)]


def _times(
    epoch: str | datetime, t: NDArray[np.float64], system: str
) -> tuple[str, NDArray[np.float64]]:
    """(time tag, seconds since then, leap seconds counted) of a run's times."""
    if isinstance(epoch, str) and epoch == "unix":
        if system.upper() != "UTC":
            raise ValueError(
                f'epoch: found "unix" with TIME_SYSTEM {system}; accepted: with UTC, or a time'
            )
        tags = epochs.tags("1970-01-01T00:00:00", t, leaps=False)
        return tags[0], epochs.seconds_since(tags[0], tags, leaps=True)
    tag = epochs.tag_of(epoch, system)
    if tag < _FIRST_LEAPS and np.abs(t).max() > _LONG:
        raise ValueError(
            f"epoch: found {tag} with t up to {t[-1]:.10g} s, in which leap seconds count; "
            'accepted: "unix" where t is Unix time, or a time near the run, t counted from it'
        )
    return tag, t
