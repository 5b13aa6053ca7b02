"""Attitude ephemeris messages (AEM) of the CCSDS, as text.

CCSDS 504.0-B-1 (2008), version 1.0, and 504.0-B-2 (2024), version 2.0. Time systems and frames are
not converted; their names are kept as they are given.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt import checks
from fastatt.arrays import normalised, quat_rotate, quat_rotate_inverse
from fastatt.files import writing
from fastatt.interchange import epochs
from fastatt.interchange.run_tables import check_run

# numbers in a data line after its time, by version and type; the last type has angular velocities
_TYPES = {
    "1.0": {"QUATERNION": 4, "QUATERNION/RATE": 7},
    "2.0": {"QUATERNION": 4, "QUATERNION/ANGVEL": 7},
}
_RATES_ALONG = {"1.0": "RATE_FRAME", "2.0": "ANGVEL_FRAME"}
# properties that are fixed in version 2.0 and have keywords in 1.0
_FIXED = {"ATTITUDE_DIR": "A2B", "QUATERNION_TYPE": "LAST"}
_HEADER = ("CLASSIFICATION", "CREATION_DATE", "ORIGINATOR", "MESSAGE_ID")
_REQUIRED = (
    "OBJECT_NAME", "OBJECT_ID", "REF_FRAME_A", "REF_FRAME_B", "TIME_SYSTEM", "START_TIME",
    "STOP_TIME", "ATTITUDE_TYPE",
)  # fmt: skip
# in the standard's order
_METADATA = (
    "OBJECT_NAME", "OBJECT_ID", "CENTER_NAME", "REF_FRAME_A", "REF_FRAME_B", "ATTITUDE_DIR",
    "TIME_SYSTEM", "START_TIME", "USEABLE_START_TIME", "USEABLE_STOP_TIME", "STOP_TIME",
    "ATTITUDE_TYPE", "QUATERNION_TYPE", "EULER_ROT_SEQ", "RATE_FRAME", "ANGVEL_FRAME",
    "INTERPOLATION_METHOD", "INTERPOLATION_DEGREE",
)  # fmt: skip
# first parts of names of spacecraft frames: annex A of B-1, SANA's registry of B-2
_CARRIED = (
    "ACC", "ACTUATOR", "AST", "CSS", "DSS", "ESA", "GYRO", "IMU", "INSTRUMENT", "MTA", "RW", "SA_",
    "SC_BODY", "SENSOR", "STARTRACKER", "TAM",
)  # fmt: skip
# the frames of SANA's registries that rotate with the Earth, another body or an orbit
_ROTATES = re.compile(
    r"(ITRF|GTOD|TDR|GRC|EFG|WGS|ECEF|ECF|PEF|TIRS|IAU_|FIXED_|LVLH|VVLH|RSW|RTN|RIC|QSW|TNW|NTW|VNC"
    r"|SEZ)(?!.*INERTIAL)"
)
# s; START_TIME and STOP_TIME may be rounded to ms
_ROUNDED_TIME = 0.0005
# range of |q| for a file's numbers, which are rounded to a few digits
_ROUNDED = 0.01
_MARKS = ("META_START", "META_STOP", "DATA_START", "DATA_STOP")
#: lines with their numbers
_Lines = list[tuple[int, str]]


@dataclass(frozen=True, eq=False)
class AemSegment:
    """A block of a message: attitudes of one object over a span of time.

    Parameters
    ----------
    epoch : str
        Time tag at which ``t`` is 0.
    t : ndarray of shape (S,)
        Times after the epoch, s.
    q : ndarray of shape (S, 4)
        Quaternions, scalar first, from the spacecraft's frame to the other one (from REF_FRAME_B to
        REF_FRAME_A if both or neither are a spacecraft's), with the digits of the file.
    w : ndarray of shape (S, 3), or None
        Angular velocities along the spacecraft's frame, rad/s.
    metadata : mapping of str to str
        Values by the keywords of the standard.
    """

    epoch: str
    t: NDArray[np.float64]
    q: NDArray[np.float64]
    w: NDArray[np.float64] | None
    metadata: Mapping[str, str]


@dataclass(frozen=True, eq=False)
class Aem:
    """An attitude ephemeris message.

    Parameters
    ----------
    version : {"1.0", "2.0"}
        Version of the standard.
    header : mapping of str to str
        Values by the keywords of the standard.
    segments : tuple of AemSegment
        The blocks of the message.
    """

    version: str
    header: Mapping[str, str]
    segments: tuple[AemSegment, ...]

    def text(self) -> str:
        """Return the message as text.

        Returns
        -------
        str
            A text from which :func:`read_aem` reads the same times and attitudes, bit for bit.
            Angular velocities are in deg/s there, which rounds them to 4e-16 of their size. Numbers
            have up to 17 digits, as double precision needs, one more than the standard's 16.

        Raises
        ------
        ValueError
            If this is not a valid message, for example if times do not rise.
        """
        checks.choice("version", self.version, _TYPES)
        segments = checks.several("segments", self.segments, "AemSegment")
        if not segments or not all(isinstance(x, AemSegment) for x in segments):
            raise ValueError(
                f"segments: found {checks.brief(segments)}; accepted: one AemSegment or several"
            )
        lines = [f"CCSDS_AEM_VERS = {self.version}"]
        lines += _assignments(_keywords("header", self.header, _HEADER))
        for k, segment in enumerate(segments):
            lines += ["", *_block(segment, self.version, f"segments[{k}]")]
        return "\n".join(lines) + "\n"

    def write(self, path: str | Path) -> None:
        """Write the message to a file.

        Parameters
        ----------
        path : str or Path
            The file.

        Raises
        ------
        ValueError
            If this is not a valid message, as in :meth:`text`, or the path is a directory.
        """
        text = self.text()
        with writing("path", path, text="ascii") as file:
            file.write(text)


def read_aem(path: str | Path) -> Aem:
    """Read an attitude ephemeris message, version 1.0 or 2.0.

    Accepted types are QUATERNION and, with rates, QUATERNION/RATE or QUATERNION/ANGVEL.
    The ``epoch`` of a segment is the time tag of its first line. ATTITUDE_DIR and QUATERNION_TYPE
    are taken into account in version 2.0 too, where the standard fixes them.

    Parameters
    ----------
    path : str or Path
        The file.

    Returns
    -------
    Aem
        The message with its segments.

    Raises
    ------
    ValueError
        If the file is not such a message, or can be read in two ways: an unknown order of a
        quaternion's numbers, rates along an unknown frame, Euler rates, data outside START_TIME and
        STOP_TIME by more than half a millisecond. The message names the line.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import fastatt as fa
    >>> from fastatt import interchange
    >>> scene = fa.Scene(rate=fa.rates.Constant((0.0, 0.0, 0.1)))
    >>> run = fa.propagate(scene, [1, 0, 0, 0], dt=1.0, n_steps=2, save_every=1, t0=1.7e9)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "attitude.aem"
    ...     run.to_aem(path, epoch="unix", frame="ICRF")
    ...     aem = interchange.read_aem(path)
    >>> aem.segments[0].q.shape
    (3, 4)
    """
    try:
        text = checks.path("path", path).read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        text = ""
    lines = [(k, line.strip()) for k, line in enumerate(text.splitlines(), 1) if line.strip()]
    if not lines:
        raise ValueError(f"{path}: found no text in ASCII or UTF-8; accepted: a message")
    with _prefixed(f"line {lines[0][0]}"):
        key, version = _assignment(lines[0][1])
        if key != "CCSDS_AEM_VERS" or version not in _TYPES:
            raise ValueError(f"found {key} = {version}; accepted: CCSDS_AEM_VERS = 1.0 or 2.0")
    sections = _sections(lines)
    header = _values(next(sections))
    segments = tuple(_segment(*block, version) for block in zip(sections, sections, strict=True))
    return Aem(version, header, segments)


@contextmanager
def _prefixed(place: str) -> Iterator[None]:
    """Prefix errors that are raised within the context with a place."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{place}: {error}") from None


def _sections(lines: _Lines) -> Iterator[_Lines]:
    """The lines of the header, then of each block's metadata and its data, without comments."""
    marks = cycle(_MARKS)
    mark, inside = next(marks), True
    section: _Lines = []
    for k, line in lines[1:]:
        if line == mark:
            if inside:
                yield section
            section, inside, mark = [], mark.endswith("START"), next(marks)
        elif not inside or line in _MARKS:
            raise ValueError(f"line {k}: found {line}; accepted: {mark}")
        elif not line.startswith("COMMENT"):
            section.append((k, line))
    if inside or mark != _MARKS[0]:
        raise ValueError(f"line {lines[-1][0]}: the message ends before a block does")


def _assignment(line: str) -> tuple[str, str]:
    """Keyword and value of a line."""
    key, _, value = (x.strip() for x in line.partition("="))
    if not (key and value):
        raise ValueError(f"found {line}; accepted: KEYWORD = value")
    return key, value


def _values(section: _Lines) -> dict[str, str]:
    """Values by keyword."""
    values: dict[str, str] = {}
    for k, line in section:
        with _prefixed(f"line {k}"):
            key, value = _assignment(line)
            if key in values:
                raise ValueError(f"{key} is there twice")
            values[key] = value
    return values


def _segment(about: _Lines, data: _Lines, version: str) -> AemSegment:
    metadata = _values(about)
    with _prefixed(f"metadata up to line {about[-1][0] if about else 0}"):
        layout = _Layout(metadata, version)
        if not data:
            raise ValueError("found no data line; accepted: one or more")
    tags, rows = [], []
    for k, line in data:
        tag, *numbers = line.split()
        try:
            row = np.array(numbers, dtype=np.float64)
        except ValueError:
            row = np.empty(0)
        is_unit = abs(float(np.linalg.norm(row[:4])) - 1.0) <= _ROUNDED
        if row.size != layout.count or not is_unit or not np.isfinite(row).all():
            raise ValueError(
                f"line {k}: found {line}; accepted: a time and {layout.count} numbers, "
                f"{layout.attitude_type}, the quaternion of length 1"
            )
        tags.append(tag)
        rows.append(row)
    with _prefixed(f"data up to line {data[-1][0]}"):
        t = _checked_times(tags, metadata)
    q, w = layout.read(np.array(rows))
    return AemSegment(tags[0], t, q, w, metadata)


def _checked_times(tags: list[str], metadata: Mapping[str, str]) -> NDArray[np.float64]:
    """Seconds since the first of a block's time tags, which rise within the block's span."""
    span = [metadata["START_TIME"], metadata["STOP_TIME"]]
    times = epochs.seconds_since(tags[0], [*tags, *span], leaps=epochs.has_leaps(metadata))
    t, (start, stop) = times[:-2], times[-2:]
    falls = np.flatnonzero(np.diff(t) <= 0.0)
    if falls.size:
        raise ValueError(f"time {tags[falls[0] + 1]} does not rise; accepted: rising times")
    if t[0] < start - _ROUNDED_TIME or t[-1] > stop + _ROUNDED_TIME:
        raise ValueError(
            f"found times from {tags[0]} to {tags[-1]}; accepted: within START_TIME and STOP_TIME, "
            f"{span[0]} to {span[1]}"
        )
    return t


def _block(segment: AemSegment, version: str, name: str) -> Iterator[str]:
    """Lines of a segment."""
    t = checks.array(f"{name}.t", segment.t, "(S,)").astype(np.float64)
    q = checks.attitudes(f"{name}.q", segment.q, f"({t.size}, 4)")
    tags = epochs.tags(segment.epoch, t, leaps=epochs.has_leaps(segment.metadata))
    metadata = {"START_TIME": tags[0], "STOP_TIME": tags[-1], **segment.metadata}
    metadata = _keywords(f"{name}.metadata", metadata, _METADATA)
    with _prefixed(f"{name}.metadata"):
        layout = _Layout(metadata, version)
    rates: Any = [] if segment.w is None else segment.w
    w = checks.array(f"{name}.w", rates, f"({t.size}, 3)") if layout.count > 4 else None
    with _prefixed(f"{name}.t"):
        _checked_times(tags, metadata)
    yield "META_START"
    yield f"COMMENT {layout}"
    yield from _assignments(metadata)
    yield from ("META_STOP", "", "DATA_START")
    with np.errstate(over="ignore"):
        rows = layout.written(q, w)
    checks.finite(f"{name}.w in degrees", rows[:, 4:])
    for tag, row in zip(tags, rows.tolist(), strict=True):
        yield " ".join([tag, *map(_number, row)])
    yield "DATA_STOP"


class _Layout:
    """How the data lines of a block are to be read, from its metadata.

    B-2, annex F: the quaternion from frame A to frame B is the rotation that takes A's axes to B's,
    so it maps components along B to components along A. ATTITUDE_DIR may be B2A.

    Raises ``ValueError`` for metadata that can be read in two ways.
    """

    def __init__(self, metadata: Mapping[str, str], version: str) -> None:
        missing = [key for key in _REQUIRED if key not in metadata]
        if missing:
            raise ValueError(f"metadata without {', '.join(missing)}")
        said = {} if version == "1.0" else dict(_FIXED)
        said |= {key: value.upper() for key, value in metadata.items()}
        self.attitude_type = checks.choice("ATTITUDE_TYPE", said["ATTITUDE_TYPE"], _TYPES[version])
        self.count = _TYPES[version][self.attitude_type]
        order = checks.choice("QUATERNION_TYPE", said.get("QUATERNION_TYPE"), ("FIRST", "LAST"))
        direction = checks.choice("ATTITUDE_DIR", said.get("ATTITUDE_DIR"), ("A2B", "B2A"))
        self.order, self.direction = order, direction
        a, b = said["REF_FRAME_A"], said["REF_FRAME_B"]
        swapped = a.startswith(_CARRIED) and not b.startswith(_CARRIED)
        self.turn = -1 if order == "LAST" else 0
        back = (direction == "B2A") != swapped
        self.signs = np.array([1.0, -1.0, -1.0, -1.0] if back else [1.0] * 4, dtype=np.float64)
        self.sign = -1.0 if swapped else 1.0
        self.in_body = True
        if self.count == 7:
            if direction == "B2A" or "EULER_ROT_SEQ" in metadata:
                raise ValueError(
                    f"{self.attitude_type} with ATTITUDE_DIR B2A or EULER_ROT_SEQ can be read in "
                    "two ways; accepted: A2B without it, or QUATERNION"
                )
            key, frames = _RATES_ALONG[version], ("REF_FRAME_A", "REF_FRAME_B", a, b)
            along = checks.choice(key, said.get(key), frames)
            self.in_body = along in (("REF_FRAME_A", a) if swapped else ("REF_FRAME_B", b))

    def __str__(self) -> str:
        return (
            f"quaternions: scalar {self.order.lower()}, {self.direction} of REF_FRAME_A and "
            "REF_FRAME_B"
        )

    def read(self, rows: NDArray[np.float64]) -> tuple[NDArray[Any], NDArray[Any] | None]:
        """(q, w) from the numbers of data lines."""
        q = np.roll(rows[:, :4], -self.turn, axis=1) * self.signs
        if self.count == 4:
            return q, None
        w = self.sign * np.radians(rows[:, 4:])
        return q, w if self.in_body else quat_rotate_inverse(normalised(q), w)

    def written(self, q: NDArray[Any], w: NDArray[Any] | None) -> NDArray[np.float64]:
        """The numbers of data lines from (q, w)."""
        numbers = np.roll(q * self.signs, self.turn, axis=1)
        if w is None:
            return numbers
        along = w if self.in_body else quat_rotate(normalised(q), w)
        return np.concatenate([numbers, self.sign * np.degrees(along)], axis=1)


def _keywords(name: str, values: Any, known: tuple[str, ...]) -> dict[str, str]:
    """Values by keyword in the standard's order."""
    if not isinstance(values, Mapping):
        raise TypeError(f"{name}: found {checks.brief(values)}; accepted: a mapping of str to str")
    unknown = [str(key) for key in values if key not in known]
    if unknown:
        raise ValueError(f"{name}: found {', '.join(unknown)}; accepted: {', '.join(known)}")
    return {key: _one_line(f"{name} {key}", values[key]) for key in known if key in values}


def _one_line(name: str, value: Any) -> str:
    """A value that is one line of ASCII."""
    if isinstance(value, str) and value.strip() and value.isascii() and value.isprintable():
        return value
    raise ValueError(f"{name}: found {checks.brief(value)}; accepted: a line of ASCII text")


def _assignments(values: Mapping[str, str]) -> list[str]:
    return [f"{key} = {value}" for key, value in values.items()]


def _number(x: float) -> str:
    """The shortest text that gives the same number, with a decimal point in its mantissa."""
    text = repr(x + 0.0)  # the standard has no −0
    mantissa, e, power = text.partition("e")
    return text if "." in mantissa or not e else f"{mantissa}.0e{power}"


def to_aem(
    run: Any,
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
    """The message of one body of a run, as :meth:`fastatt.Trajectory.to_aem` writes it."""
    check_run(run)
    types = list(_TYPES[checks.choice("version", version, _TYPES)])
    written_type = checks.choice("attitude_type", attitude_type or types[-1], types)
    said = {
        **dict.fromkeys(("OBJECT_NAME", "OBJECT_ID"), "UNKNOWN"),
        "REF_FRAME_A": _one_line("frame", frame),
        "REF_FRAME_B": _one_line("body_frame", body_frame),
        "TIME_SYSTEM": "UTC",
        "ATTITUDE_TYPE": written_type,
        **(_FIXED if version == "1.0" else {}),
    }
    if written_type == types[-1]:
        said[_RATES_ALONG[version]] = "REF_FRAME_B" if version == "1.0" else body_frame
    said |= _keywords("metadata", metadata or {}, _METADATA)
    a, b = said["REF_FRAME_A"].upper(), said["REF_FRAME_B"].upper()
    if _ROTATES.match(a) or a == b:
        raise ValueError(
            f"frame: found {a}, with {b} for the body; accepted: an inertial frame such "
            "as EME2000 or ICRF, from which a run has its attitudes and rates"
        )
    n = run.status.size
    k = 0 if body is None else checks.whole("body", body, 0)
    if k >= n or (body is None and n > 1):
        raise ValueError(
            f"body: found {body}; accepted: 0 to {n - 1}, since a message is of one object"
        )
    q, w = ((x if run.one_body else x[:, k]).astype(np.float64) for x in (run.q, run.w))
    begin, t = epochs.of_run(epoch, run.t, said["TIME_SYSTEM"])
    first = {"CREATION_DATE": datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%S")}
    first |= {"ORIGINATOR": "FASTATT", **_keywords("header", header or {}, _HEADER)}
    return Aem(version, first, (AemSegment(begin, t, q, w, said),))
