"""Attitude ephemeris messages (AEM) of the CCSDS, as text.

CCSDS 504.0-B-1 (2008), version 1.0, and 504.0-B-2 (2024), version 2.0, whose order of a
quaternion's numbers, names of types and ways to say a direction differ. Nothing is converted
between time systems or frames: their names are kept as they are given.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fastatt import checks
from fastatt.arrays import normalised, quat_multiply, quat_rotate, quat_rotate_inverse
from fastatt.interchange import epochs
from fastatt.interchange.conventions import from_scalar_last, to_passive, to_scalar_last

if TYPE_CHECKING:
    from fastatt.propagation.trajectory import Trajectory

_DERIVATIVE = "QUATERNION/DERIVATIVE"
# by version: numbers of a data line after its time, by type; the keyword of the rates' frame
_TYPES = {
    "1.0": {"QUATERNION": 4, _DERIVATIVE: 8, "QUATERNION/RATE": 7},
    "2.0": {"QUATERNION": 4, _DERIVATIVE: 8, "QUATERNION/ANGVEL": 7},
}
_RATES_ALONG = {"1.0": "RATE_FRAME", "2.0": "ANGVEL_FRAME"}
_HEADER = ("CLASSIFICATION", "CREATION_DATE", "ORIGINATOR", "MESSAGE_ID")
_REQUIRED = (
    "OBJECT_NAME", "OBJECT_ID", "REF_FRAME_A", "REF_FRAME_B", "TIME_SYSTEM", "START_TIME",
    "STOP_TIME", "ATTITUDE_TYPE",
)  # fmt: skip
# in the standard's order; those of one version only are absent from the other's messages
_METADATA = (
    "OBJECT_NAME", "OBJECT_ID", "CENTER_NAME", "REF_FRAME_A", "REF_FRAME_B", "ATTITUDE_DIR",
    "TIME_SYSTEM", "START_TIME", "USEABLE_START_TIME", "USEABLE_STOP_TIME", "STOP_TIME",
    "ATTITUDE_TYPE", "QUATERNION_TYPE", "EULER_ROT_SEQ", "RATE_FRAME", "ANGVEL_FRAME",
    "INTERPOLATION_METHOD", "INTERPOLATION_DEGREE",
)  # fmt: skip
# frames that a spacecraft carries, as their names begin: annex A of B-1, SANA's registry of B-2
_CARRIED = (
    "ACC", "ACTUATOR", "AST", "CSS", "DSS", "ESA", "GYRO", "IMU", "INSTRUMENT", "MTA", "RW", "SA_",
    "SC_BODY", "SENSOR", "STARTRACKER", "TAM",
)  # fmt: skip
# |q| of a file's numbers, which are rounded to a few digits
_ROUNDED = 0.01


@dataclass(frozen=True, eq=False)
class AemSegment:
    """A block of a message: attitudes of one object over a span of time.

    ``epoch`` is the time tag at which ``t`` (S,), s, is 0; ``q`` (S, 4), scalar first, maps
    components along the spacecraft's frame to components along the other one, as everywhere here
    (along REF_FRAME_B to along REF_FRAME_A where both or neither are a spacecraft's); ``w`` (S, 3)
    rad/s along the spacecraft's frame, or None; ``metadata`` by the standard's keywords;
    ``comments`` line by line.

    Numbers of ``q`` are as the file has them: of unit length to the digits that it gives.
    """

    epoch: str
    t: NDArray[np.float64]
    q: NDArray[np.float64]
    w: NDArray[np.float64] | None
    metadata: Mapping[str, str]
    comments: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Aem:
    """An attitude ephemeris message: ``version`` "1.0" or "2.0", ``header``, ``segments``.

    ``header`` has the standard's keywords, ``comments`` its comment lines.
    """

    version: str
    header: Mapping[str, str]
    segments: tuple[AemSegment, ...]
    comments: tuple[str, ...] = field(default=())

    def text(self) -> str:
        """The message: :func:`read_aem` gives the same times and attitudes again, bit for bit.

        Rates are in deg/s there, which rounds them to 4e-16 of their size. Numbers have the digits
        that double precision needs, 17 at most, one more than the standard's 16.

        Raises ``ValueError`` for what is no message, such as times that do not rise.
        """
        checks.choice("version", self.version, _TYPES)
        lines = [f"CCSDS_AEM_VERS = {self.version}", *_comments(self.comments)]
        lines += _assigned("header", self.header, _HEADER)
        for k, segment in enumerate(self.segments):
            lines += ["", *_block(segment, self.version, f"segments[{k}]")]
        return "\n".join(lines) + "\n"

    def write(self, path: str | Path) -> None:
        """Write the message to a file."""
        Path(path).write_text(self.text(), encoding="ascii")


def aem_of(
    run: Trajectory,
    *,
    epoch: str,
    frame: str,
    body_frame: str = "SC_BODY_1",
    body: int = 0,
    version: str = "2.0",
    attitude_type: str | None = None,
    metadata: Mapping[str, str] | None = None,
    header: Mapping[str, str] | None = None,
) -> Aem:
    """The message of one body of a run.

    Parameters
    ----------
    run : with saves at rising times.
    epoch : time tag of the run's t = 0, "2026-01-01T00:00:00" or "2026-001T00:00:00", in the
        metadata's TIME_SYSTEM, UTC unless said otherwise; across UTC's leap seconds, t counts them.
    frame, body_frame : the standard's names of the inertial frame and of the body's.
    body : which of an ensemble.
    version : "1.0" (CCSDS 504.0-B-1) or "2.0" (504.0-B-2).
    attitude_type : None is QUATERNION with the angular velocity beside it, called QUATERNION/RATE
        in version 1.0 and QUATERNION/ANGVEL in 2.0; or "QUATERNION", "QUATERNION/DERIVATIVE".
    metadata, header : further keywords, such as ``{"OBJECT_NAME": "SAT-1"}``.

    Raises
    ------
    ValueError : an argument that does not fit; attitudes that are not numbers.
    """
    types = list(_TYPES[checks.choice("version", version, _TYPES)])
    wanted = checks.choice("attitude_type", attitude_type or types[-1], types)
    n = run.status.size
    if checks.whole("body", body, 0) >= n:
        raise ValueError(f"body: found {body}; accepted: 0 to {n - 1}")
    q, w = (x if run.one_body else x[:, body] for x in (run.q, run.w))
    said: dict[str, str] = {
        "OBJECT_NAME": "UNKNOWN",
        "OBJECT_ID": "UNKNOWN",
        "REF_FRAME_A": frame,
        "REF_FRAME_B": body_frame,
        "TIME_SYSTEM": "UTC",
        "ATTITUDE_TYPE": wanted,
    }
    if version == "1.0":
        said |= {"ATTITUDE_DIR": "A2B", "QUATERNION_TYPE": "LAST"}
    if wanted == types[-1]:
        said[_RATES_ALONG[version]] = "REF_FRAME_B" if version == "1.0" else body_frame
    said |= metadata or {}
    now = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%S")
    first = {"CREATION_DATE": now, "ORIGINATOR": "FASTATT", **(header or {})}
    q, w = (np.asarray(x, dtype=np.float64) for x in (q, w))
    return Aem(version, first, (AemSegment(_line("epoch", epoch), run.t, q, w, said),))


def read_aem(path: str | Path) -> Aem:
    """Read an attitude ephemeris message, version 1.0 or 2.0.

    Types are QUATERNION, QUATERNION/DERIVATIVE and QUATERNION/RATE or QUATERNION/ANGVEL; a
    segment's ``epoch`` is the time tag of its first line.

    Raises ``ValueError``, with the line, for what is no such message or can be read in two ways:
    an unknown order of a quaternion's numbers, rates along an unknown frame, Euler's rates.
    """
    lines = _Lines(Path(path).read_text(encoding="utf-8"))
    key, version = lines.assignment(lines.next())
    if key != "CCSDS_AEM_VERS" or version not in _TYPES:
        raise lines.wrong(f"found {key} = {version}; accepted: CCSDS_AEM_VERS = 1.0 or 2.0")
    header, comments = lines.assignments("META_START")
    segments = []
    while lines.left:
        segments.append(_segment(lines, version))
        if lines.left:
            lines.expect("META_START")
    return Aem(version, header, tuple(segments), comments)


def _segment(lines: _Lines, version: str) -> AemSegment:
    metadata, comments = lines.assignments("META_STOP")
    code = _Code(metadata, version, lines.wrong)
    lines.expect("DATA_START")
    more, tags, rows = [], [], []
    while (line := lines.next()) != "DATA_STOP":
        if line.startswith("COMMENT"):
            more.append(line[7:].strip())
            continue
        tag, *numbers = line.split()
        try:
            row = [float(x) for x in numbers]
        except ValueError:
            raise lines.wrong(f"found {line}; accepted: a time and numbers") from None
        if len(row) != code.count or not np.isfinite(row).all():
            raise lines.wrong(
                f"found {line}; accepted: a time and {code.count} numbers, {code.kind}"
            )
        tags.append(tag)
        rows.append(row)
    if not tags:
        raise lines.wrong("found no data line")
    try:
        t = epochs.seconds_since(tags[0], tags, leaps=metadata["TIME_SYSTEM"].upper() == "UTC")
    except ValueError as error:
        raise lines.wrong(str(error)) from None
    if (np.diff(t) <= 0.0).any():
        raise lines.wrong(f"time {tags[int(np.argmax(np.diff(t) <= 0.0)) + 1]} does not rise")
    q, w = code.read(np.array(rows))
    size = np.linalg.norm(q, axis=1)
    if (np.abs(size - 1.0) > _ROUNDED).any():
        k = int(np.argmax(np.abs(size - 1.0)))
        raise lines.wrong(f"quaternion at {tags[k]} has length {size[k]:.3g}; accepted: 1")
    return AemSegment(tags[0], t, q, w, metadata, (*comments, *more))


def _block(segment: AemSegment, version: str, name: str) -> Iterator[str]:
    """Lines of a segment."""
    metadata = {"START_TIME": "", "STOP_TIME": "", **segment.metadata}
    t = checks.array(f"{name}.t", segment.t, "(S,)").astype(np.float64)
    q = checks.attitudes(f"{name}.q", segment.q, f"({t.size}, 4)")
    if (np.diff(t) <= 0.0).any():
        raise ValueError(f"{name}.t: does not rise; accepted: rising times")

    def wrong(text: str) -> ValueError:
        return ValueError(f"{name}.metadata: {text}")

    code = _Code(metadata, version, wrong)
    w = None
    if code.count > 4:
        if segment.w is None:
            raise ValueError(f"{name}.w: is missing; {code.kind} needs (S, 3), rad/s")
        w = checks.array(f"{name}.w", segment.w, f"({t.size}, 3)")
    tags = epochs.tags(segment.epoch, t, leaps=metadata["TIME_SYSTEM"].upper() == "UTC")
    metadata["START_TIME"] = metadata["START_TIME"] or tags[0]
    metadata["STOP_TIME"] = metadata["STOP_TIME"] or tags[-1]
    yield "META_START"
    yield from _comments(segment.comments)
    yield from _assigned(f"{name}.metadata", metadata, _METADATA)
    yield from ("META_STOP", "", "DATA_START")
    for tag, row in zip(tags, code.written(q, w).tolist(), strict=True):
        yield " ".join([tag, *map(_number, row)])
    yield "DATA_STOP"


class _Code:
    """How a block's metadata says that its data lines are to be read.

    B-2, annex F: the quaternion from frame A to frame B is the rotation that takes A's axes to
    B's, so it maps components along B to components along A. B-1's ATTITUDE_DIR may be B2A.
    """

    def __init__(
        self, metadata: Mapping[str, str], version: str, wrong: Callable[[str], ValueError]
    ) -> None:
        def choice(key: str, accepted: Mapping[str, Any] | tuple[str, ...]) -> str:
            found = metadata.get(key, "").upper()
            if found not in accepted:
                said = f"found {key} = {found}" if found else f"{key} is missing"
                raise wrong(f"{said}; accepted: {', '.join(accepted)}")
            return found

        missing = [key for key in _REQUIRED if key not in metadata]
        if missing:
            raise wrong(f"metadata without {', '.join(missing)}")
        self.kind = choice("ATTITUDE_TYPE", _TYPES[version])
        self.count = _TYPES[version][self.kind]
        old = version == "1.0"
        self.first = old and choice("QUATERNION_TYPE", ("FIRST", "LAST")) == "FIRST"
        backward = old and choice("ATTITUDE_DIR", ("A2B", "B2A")) == "B2A"
        a, b = (metadata[f"REF_FRAME_{x}"] for x in "AB")
        swapped = a.upper().startswith(_CARRIED) and not b.upper().startswith(_CARRIED)
        self.reverse = backward != swapped
        self.sign = -1.0 if swapped else 1.0
        self.in_body = True
        if self.count == 7:
            if backward or "EULER_ROT_SEQ" in metadata:
                raise wrong(
                    f"{self.kind} with ATTITUDE_DIR B2A or EULER_ROT_SEQ can be read in two ways; "
                    f"accepted: A2B without it, or {_DERIVATIVE}"
                )
            names = dict.fromkeys(("REF_FRAME_A", "REF_FRAME_B", a.upper(), b.upper()))
            along = choice(_RATES_ALONG[version], tuple(names))
            body = ("REF_FRAME_A", a) if swapped else ("REF_FRAME_B", b)
            self.in_body = along in (body[0], body[1].upper())

    def read(self, rows: NDArray[np.float64]) -> tuple[NDArray[Any], NDArray[Any] | None]:
        """(q, w) of data lines' numbers."""
        q = self._turned(rows[:, :4])
        if self.count == 4:
            return q, None
        if self.kind == _DERIVATIVE:
            # w = 2 q*∘q̇, of unit q
            rate = 2.0 * quat_multiply(to_passive(q), self._turned(rows[:, 4:]))[:, 1:]
            return q, rate / (q * q).sum(axis=1, keepdims=True)
        w = self.sign * np.radians(rows[:, 4:])
        return q, w if self.in_body else quat_rotate_inverse(normalised(q), w)

    def _turned(self, numbers: NDArray[np.float64]) -> NDArray[np.float64]:
        """Scalar first, and in the other direction where that is ours."""
        p = numbers if self.first else from_scalar_last(numbers)
        return to_passive(p) if self.reverse else p

    def written(self, q: NDArray[Any], w: NDArray[Any] | None) -> NDArray[np.float64]:
        """Numbers of data lines, the way back."""
        parts = [q]
        if w is not None and self.kind == _DERIVATIVE:
            parts.append(0.5 * quat_multiply(q, np.concatenate([0.0 * w[:, :1], w], axis=1)))
        parts = [to_passive(p) if self.reverse else p for p in parts]
        parts = [p if self.first else to_scalar_last(p) for p in parts]
        if w is not None and self.kind != _DERIVATIVE:
            along = w if self.in_body else quat_rotate(normalised(q), w)
            parts.append(self.sign * np.degrees(along))
        return np.concatenate(parts, axis=1)


class _Lines:
    """Lines of a message that are not blank, one after the other."""

    def __init__(self, text: str) -> None:
        self._lines = [(k, x.strip()) for k, x in enumerate(text.splitlines(), 1) if x.strip()]
        self._at = 0

    @property
    def left(self) -> bool:
        """Whether there are more."""
        return self._at < len(self._lines)

    def next(self) -> str:
        """The next one."""
        if not self.left:
            last = self._lines[-1][0] if self._lines else 0
            raise ValueError(f"line {last}: the message ends before a block does")
        self._at += 1
        return self._lines[self._at - 1][1]

    def wrong(self, text: str) -> ValueError:
        """What to raise about the line that was read last."""
        return ValueError(f"line {self._lines[self._at - 1][0]}: {text}")

    def expect(self, word: str) -> None:
        """Pass a line that has to be there."""
        if (found := self.next()) != word:
            raise self.wrong(f"found {found}; accepted: {word}")

    def assignment(self, line: str) -> tuple[str, str]:
        """Keyword and value of the line that was read."""
        key, equals, value = (x.strip() for x in line.partition("="))
        if not (equals and key and value):
            raise self.wrong(f"found {line}; accepted: KEYWORD = value")
        return key, value

    def assignments(self, end: str) -> tuple[dict[str, str], tuple[str, ...]]:
        """Keywords with their values up to a line, and the comments among them."""
        found: dict[str, str] = {}
        comments = []
        while (line := self.next()) != end:
            if line.split()[0] == "COMMENT":
                comments.append(line[7:].strip())
                continue
            key, value = self.assignment(line)
            if key in found:
                raise self.wrong(f"{key} is there twice")
            found[key] = value
        return found, tuple(comments)


def _comments(comments: tuple[str, ...]) -> list[str]:
    return [f"COMMENT {_line('comments', x)}" for x in comments]


def _line(name: str, value: Any) -> str:
    """A value, which stands in one line of ASCII and is there."""
    if isinstance(value, str) and value.strip() and value.isascii() and value.isprintable():
        return value
    raise ValueError(f"{name}: found {checks.brief(value)}; accepted: a line of ASCII text")


def _assigned(name: str, values: Mapping[str, str], known: tuple[str, ...]) -> Iterator[str]:
    """Lines in the standard's order."""
    unknown = [key for key in values if key not in known]
    if unknown:
        raise ValueError(f"{name}: found {', '.join(unknown)}; accepted: {', '.join(known)}")
    for key in known:
        if key in values:
            yield f"{key} = {_line(f'{name} {key}', values[key])}"


def _number(x: float) -> str:
    """The shortest text that gives the number again, a decimal point in its mantissa."""
    text = repr(x + 0.0)  # the standard has no −0
    mantissa, e, power = text.partition("e")
    return text if "." in mantissa or not e else f"{mantissa}.0e{power}"
