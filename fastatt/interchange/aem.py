"""Attitude ephemeris messages (AEM) of the CCSDS, as text.

CCSDS 504.0-B-1 (2008), version 1.0, and 504.0-B-2 (2024), version 2.0. Time systems and frames are
not converted; their names are kept as they are given.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt import checks
from fastatt.arrays import normalised, quat_multiply, quat_rotate, quat_rotate_inverse
from fastatt.interchange import epochs
from fastatt.interchange.conventions import from_scalar_last, to_passive, to_scalar_last

_DERIVATIVE = "QUATERNION/DERIVATIVE"
# numbers in a data line after its time, by version and type; the last type has angular velocities
TYPES = {
    "1.0": {"QUATERNION": 4, _DERIVATIVE: 8, "QUATERNION/RATE": 7},
    "2.0": {"QUATERNION": 4, _DERIVATIVE: 8, "QUATERNION/ANGVEL": 7},
}
RATES_ALONG = {"1.0": "RATE_FRAME", "2.0": "ANGVEL_FRAME"}
# properties that are fixed in version 2.0 and have keywords in 1.0
FIXED = {"ATTITUDE_DIR": "A2B", "QUATERNION_TYPE": "LAST"}
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
# range of |q| for a file's numbers, which are rounded to a few digits
_ROUNDED = 0.01
_MARKS = ("META_START", "META_STOP", "DATA_START", "DATA_STOP")
#: a line and its number
_Numbered = tuple[int, str]


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
    comments : tuple of str, default ()
        Comment lines.
    """

    epoch: str
    t: NDArray[np.float64]
    q: NDArray[np.float64]
    w: NDArray[np.float64] | None
    metadata: Mapping[str, str]
    comments: tuple[str, ...] = ()


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
    comments : tuple of str, default ()
        Comment lines of the header.
    """

    version: str
    header: Mapping[str, str]
    segments: tuple[AemSegment, ...]
    comments: tuple[str, ...] = field(default=())

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
        checks.choice("version", self.version, TYPES)
        if not self.segments:
            raise ValueError("segments: found none; accepted: one or more")
        lines = [f"CCSDS_AEM_VERS = {self.version}", *_comments(self.comments)]
        lines += _assignments("header", self.header, _HEADER)
        for k, segment in enumerate(self.segments):
            lines += ["", *_block(segment, self.version, f"segments[{k}]")]
        return "\n".join(lines) + "\n"

    def write(self, path: str | Path) -> None:
        """Write the message to a file.

        Parameters
        ----------
        path : str or Path
            The file.
        """
        checks.path("path", path).write_text(self.text(), encoding="ascii")


def read_aem(path: str | Path) -> Aem:
    """Read an attitude ephemeris message, version 1.0 or 2.0.

    Accepted types are QUATERNION, QUATERNION/DERIVATIVE and QUATERNION/RATE or QUATERNION/ANGVEL.
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
        STOP_TIME. The message names the line.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import fastatt as fa
    >>> scene = fa.Scene(rate=fa.rates.Constant((0.0, 0.0, 0.1)))
    >>> run = fa.propagate(scene, [1, 0, 0, 0], dt=1.0, n_steps=2, save_every=1, t0=1.7e9)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "attitude.aem"
    ...     run.to_aem(path, epoch="unix", frame="ICRF")
    ...     aem = fa.interchange.read_aem(path)
    >>> aem.segments[0].q.shape
    (3, 4)
    """
    try:
        text = checks.path("path", path).read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise ValueError(
            f"{path}: found bytes that are no text in ASCII or UTF-8 (UTF-16, or a binary file); "
            "accepted: a message as text"
        ) from None
    lines = [(k, line.strip()) for k, line in enumerate(text.splitlines(), 1) if line.strip()]
    if not lines:
        raise ValueError(f"{path}: is empty; accepted: a message, from CCSDS_AEM_VERS on")
    with _prefixed(f"line {lines[0][0]}"):
        key, version = _assignment(lines[0][1])
        if key != "CCSDS_AEM_VERS" or version not in TYPES:
            raise ValueError(f"found {key} = {version}; accepted: CCSDS_AEM_VERS = 1.0 or 2.0")
    sections = _sections(lines)
    header, comments = _values(next(sections))
    segments = tuple(_segment(*block, version) for block in zip(sections, sections, strict=True))
    return Aem(version, header, segments, comments)


@contextmanager
def _prefixed(place: str) -> Iterator[None]:
    """Prefix errors that are raised within the context with a place."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{place}: {error}") from None


def _sections(lines: list[_Numbered]) -> Iterator[list[_Numbered]]:
    """Lines of the header, then of each block those of its metadata and those of its data."""
    marks = cycle(_MARKS)
    mark, inside = next(marks), True
    section: list[_Numbered] = []
    for k, line in lines[1:]:
        if line == mark:
            if inside:
                yield section
            section, inside, mark = [], mark.endswith("START"), next(marks)
        elif not inside or line in _MARKS:
            raise ValueError(f"line {k}: found {line}; accepted: {mark}")
        else:
            section.append((k, line))
    if inside or mark != _MARKS[0]:
        raise ValueError(f"line {lines[-1][0]}: the message ends before a block does")


def _assignment(line: str) -> tuple[str, str]:
    """Keyword and value of a line."""
    key, _, value = (x.strip() for x in line.partition("="))
    if not (key and value):
        raise ValueError(f"found {line}; accepted: KEYWORD = value")
    return key, value


def _values(section: list[_Numbered]) -> tuple[dict[str, str], tuple[str, ...]]:
    """Values by keyword, and the comments between them."""
    found: dict[str, str] = {}
    comments = []
    for k, line in section:
        with _prefixed(f"line {k}"):
            if line.startswith("COMMENT"):
                comments.append(line[7:].strip())
                continue
            key, value = _assignment(line)
            if key in found:
                raise ValueError(f"{key} is there twice")
            found[key] = value
    return found, tuple(comments)


def _segment(about: list[_Numbered], data: list[_Numbered], version: str) -> AemSegment:
    metadata, comments = _values(about)
    with _prefixed(f"metadata up to line {about[-1][0] if about else 0}"):
        layout = _Layout(metadata, version)
    comments += tuple(line[7:].strip() for _, line in data if line.startswith("COMMENT"))
    tags, rows = [], []
    for k, line in data:
        if line.startswith("COMMENT"):
            continue
        tag, *numbers = line.split()
        try:
            row = np.array(numbers, dtype=np.float64)
        except ValueError:
            row = np.empty(0)
        if row.size != layout.count or not np.isfinite(row).all():
            raise ValueError(
                f"line {k}: found {line}; accepted: a time and {layout.count} numbers, "
                f"{layout.kind}"
            )
        tags.append(tag)
        rows.append(row)
    with _prefixed(f"data up to line {data[-1][0] if data else about[-1][0]}"):
        if not tags:
            raise ValueError("found no data line; accepted: one or more")
        t = _checked_times(tags, metadata)
        q, w = layout.read(np.array(rows))
        size = np.linalg.norm(q, axis=1)
        if (np.abs(size - 1.0) > _ROUNDED).any():
            k = int(np.argmax(np.abs(size - 1.0)))
            raise ValueError(f"quaternion at {tags[k]} has length {size[k]:.3g}; accepted: 1")
    return AemSegment(tags[0], t, q, w, metadata, comments)


def _checked_times(tags: list[str], metadata: Mapping[str, str]) -> NDArray[np.float64]:
    """Seconds since the first of a block's time tags, which rise within the block's span."""
    span = [metadata["START_TIME"], metadata["STOP_TIME"]]
    found = epochs.seconds_since(tags[0], [*tags, *span], leaps=_has_leaps(metadata))
    t, (start, stop) = found[:-2], found[-2:]
    falls = np.flatnonzero(np.diff(t) <= 0.0)
    if falls.size:
        raise ValueError(f"time {tags[falls[0] + 1]} does not rise; accepted: rising times")
    if not start <= t[0] <= t[-1] <= stop:
        raise ValueError(
            f"found times from {tags[0]} to {tags[-1]}; accepted: within START_TIME and STOP_TIME, "
            f"{span[0]} to {span[1]}"
        )
    return t


def _has_leaps(metadata: Mapping[str, str]) -> bool:
    """Whether a block's time system has leap seconds."""
    return metadata["TIME_SYSTEM"].upper() == "UTC"


def _block(segment: AemSegment, version: str, name: str) -> Iterator[str]:
    """Lines of a segment."""
    metadata = {"START_TIME": "", "STOP_TIME": "", **segment.metadata}
    t = checks.array(f"{name}.t", segment.t, "(S,)").astype(np.float64)
    q = checks.attitudes(f"{name}.q", segment.q, f"({t.size}, 4)")
    with _prefixed(f"{name}.metadata"):
        layout = _Layout(metadata, version)
    w = None
    if layout.count > 4:
        if segment.w is None:
            raise ValueError(f"{name}.w: is missing; {layout.kind} needs (S, 3), rad/s")
        w = checks.array(f"{name}.w", segment.w, f"({t.size}, 3)")
    tags = epochs.tags(segment.epoch, t, leaps=_has_leaps(metadata))
    metadata["START_TIME"] = metadata["START_TIME"] or tags[0]
    metadata["STOP_TIME"] = metadata["STOP_TIME"] or tags[-1]
    with _prefixed(f"{name}.t"):
        _checked_times(tags, metadata)
    yield "META_START"
    yield from _comments(segment.comments)
    yield from _assignments(f"{name}.metadata", metadata, _METADATA)
    yield from ("META_STOP", "", "DATA_START")
    for tag, row in zip(tags, layout.written(q, w).tolist(), strict=True):
        yield " ".join([tag, *map(_number, row)])
    yield "DATA_STOP"


class _Layout:
    """How the data lines of a block are to be read, from its metadata.

    B-2, annex F: the quaternion from frame A to frame B is the rotation that takes A's axes to B's,
    so it maps components along B to components along A. ATTITUDE_DIR may be B2A.

    Raises ``ValueError`` for metadata that can be read in two ways.
    """

    def __init__(self, metadata: Mapping[str, str], version: str) -> None:
        said = metadata if version == "1.0" else {**FIXED, **metadata}

        def choice(key: str, accepted: Iterable[str]) -> str:
            found = said.get(key, "").upper()
            if found not in accepted:
                start = f"found {key} = {found}" if found else f"{key} is missing"
                raise ValueError(f"{start}; accepted: {', '.join(accepted)}")
            return found

        missing = [key for key in _REQUIRED if key not in metadata]
        if missing:
            raise ValueError(f"metadata without {', '.join(missing)}")
        self.kind = choice("ATTITUDE_TYPE", TYPES[version])
        self.count = TYPES[version][self.kind]
        self.scalar_first = choice("QUATERNION_TYPE", ("FIRST", "LAST")) == "FIRST"
        backward = choice("ATTITUDE_DIR", ("A2B", "B2A")) == "B2A"
        a, b = (metadata[f"REF_FRAME_{x}"].upper() for x in "AB")
        swapped = a.startswith(_CARRIED) and not b.startswith(_CARRIED)
        self.reverse = backward != swapped
        self.sign = -1.0 if swapped else 1.0
        self.in_body = True
        if self.count == 7:
            if backward or "EULER_ROT_SEQ" in metadata:
                raise ValueError(
                    f"{self.kind} with ATTITUDE_DIR B2A or EULER_ROT_SEQ can be read in two ways; "
                    f"accepted: A2B without it, or {_DERIVATIVE}"
                )
            names = dict.fromkeys(("REF_FRAME_A", "REF_FRAME_B", a, b))
            along = choice(RATES_ALONG[version], names)
            self.in_body = along in (("REF_FRAME_A", a) if swapped else ("REF_FRAME_B", b))

    def read(self, rows: NDArray[np.float64]) -> tuple[NDArray[Any], NDArray[Any] | None]:
        """(q, w) from the numbers of data lines."""
        q = self._read_quaternions(rows[:, :4])
        if self.count == 4:
            return q, None
        if self.kind == _DERIVATIVE:
            # w = 2 q*∘q̇, of unit q
            rate = 2.0 * quat_multiply(to_passive(q), self._read_quaternions(rows[:, 4:]))[:, 1:]
            return q, rate / (q * q).sum(axis=1, keepdims=True)
        w = self.sign * np.radians(rows[:, 4:])
        return q, w if self.in_body else quat_rotate_inverse(normalised(q), w)

    def _read_quaternions(self, numbers: NDArray[np.float64]) -> NDArray[np.float64]:
        """Quaternions, scalar first, from the spacecraft's frame to the other one."""
        p = numbers if self.scalar_first else from_scalar_last(numbers)
        return to_passive(p) if self.reverse else p

    def written(self, q: NDArray[Any], w: NDArray[Any] | None) -> NDArray[np.float64]:
        """The numbers of data lines from (q, w)."""
        parts = [q]
        if w is not None and self.kind == _DERIVATIVE:
            parts.append(0.5 * quat_multiply(q, np.concatenate([0.0 * w[:, :1], w], axis=1)))
        parts = [to_passive(p) if self.reverse else p for p in parts]
        parts = [p if self.scalar_first else to_scalar_last(p) for p in parts]
        if w is not None and self.kind != _DERIVATIVE:
            parts.append(
                self.sign * np.degrees(w if self.in_body else quat_rotate(normalised(q), w))
            )
        return np.concatenate(parts, axis=1)


def _comments(comments: tuple[str, ...]) -> list[str]:
    return [f"COMMENT {one_line('comments', x)}" for x in comments]


def one_line(name: str, value: Any) -> str:
    """A value that is one line of ASCII."""
    if isinstance(value, str) and value.strip() and value.isascii() and value.isprintable():
        return value
    raise ValueError(f"{name}: found {checks.brief(value)}; accepted: a line of ASCII text")


def _assignments(name: str, values: Mapping[str, str], known: tuple[str, ...]) -> Iterator[str]:
    """Lines in the standard's order."""
    unknown = [key for key in values if key not in known]
    if unknown:
        raise ValueError(f"{name}: found {', '.join(unknown)}; accepted: {', '.join(known)}")
    for key in known:
        if key in values:
            yield f"{key} = {one_line(f'{name} {key}', values[key])}"


def _number(x: float) -> str:
    """The shortest text that gives the same number, with a decimal point in its mantissa."""
    text = repr(x + 0.0)  # the standard has no −0
    mantissa, e, power = text.partition("e")
    return text if "." in mantissa or not e else f"{mantissa}.0e{power}"
