"""The meaning of column names: the axes of the gyro, the time, and their units."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence


class GyroLogError(ValueError):
    """A log can't be read; the message says why in one line."""


class GyroLogWarning(UserWarning):
    """Warns of a unit inferred from the size of numbers, or of many rows left out or moved."""


_DEGREE = math.pi / 180.0
UNITS = {
    "rad/s": 1.0, "deg/s": _DEGREE, "mrad/s": 1e-3, "mdeg/s": 1e-3 * _DEGREE,
    "deg/min": _DEGREE / 60.0, "deg/h": _DEGREE / 3600.0, "arcsec/s": _DEGREE / 3600.0,
    "rev/s": 2.0 * math.pi, "rpm": math.pi / 30.0, "Hz": 2.0 * math.pi,
}  # fmt: skip
# number of each in a second; Xsens counts tenths of a millisecond
TIME_UNITS = {"s": 1.0, "ms": 1e3, "100us": 1e4, "us": 1e6, "ns": 1e9}
STANDARD_GRAVITY = 9.80665  # m/s², CGPM 1901

# names of three-axis sensors, without axis, blanks, dashes and underscores
_SENSORS = {
    "gyro": re.compile(
        r".*gyr.*|omega|w|g|wrss|.*(ang(ular)?|rotation|body)(velocity|vel|rate|speed)s?|rates?"
        r"|rateofturn"
    ),
    "accel": re.compile(r"(?!.*(ang|user|grav)).*acc.*|a|arss|alpha"),
    "mag": re.compile(r".*mag(?!nitude).*|m"),
    "unnamed": re.compile(r"|xyz"),
}
_QUAT = re.compile(
    r"(?P<stem>(.*[./])?((\w*quat\w*?|orientation|q|q_rs)[ _.\[(/-]*)?)(?P<axis>[wxyz])[\])]?"
    r"|(?P<numbered>q|quat)[\[_]?(?P<number>[0-3])\]?",
    re.IGNORECASE,
)
# columns of a gyro that are not rates
_NOT_RATES = re.compile(r"bias|cov|std|var|noise|temp|offset|err|sigma|integral|uncal|raw")
_IN_BRACKETS = re.compile(r"[ _]*[\[(](?P<unit>[^\[\]()]*)[\])]$")
_UNIT_AT_END = re.compile(
    r"[ _]+([mkuµμ]?(deg|rad|°|dps|rp[ms]|hz)|m?g$|[mnuµμ]?(t|tesla|gauss)$|m[ _/p]*s).*$",
    re.IGNORECASE,
)
_AXIS = re.compile(
    r"(?P<stem>.*?)[ _.\-/]*(?P<axis>[\[(][012xyz][\])]|[xyz])", re.IGNORECASE | re.DOTALL
)
_ABOUT_RATES = re.compile(r"gyr|ang(ular)?[ _]?(vel|rate)|rotation[ _]?rate", re.IGNORECASE)
_TIME = re.compile(
    r"(_*times?|timestamps?|ts?|stamps?|datetime|date|elapsed(time)?|seconds(?P<elapsed>elapsed)?"
    r"|timesincestart|unixtime(stamp)?|epoch|clock|\w*timestampunix|loggingtime|logtime"
    r"|sampletimefine)(in)?"
    r"(?P<unit>s|sec|secs|seconds?|ms|msec|milli(second)?s|us|µs|μs|usec|micro(second)?s"
    r"|ns|nsec|nano(second)?s)?"
)
_STAMP = re.compile(r"(.*[./])?header[./]stamp", re.IGNORECASE)
# whole seconds of ROS, next to a column of nanoseconds
_STAMP_SECONDS = re.compile(r"((?:.*[./])?stamp[./_])secs?", re.IGNORECASE)
_UNIT = re.compile(
    r"(?<![a-z])(?P<scale>milli|micro|[mkuµμ])?(?P<angle>deg(rees?|s)?|°|dps|rad(ians?|s)?|rp[ms]"
    r"|(?<!\d)hz|arcsec(s|onds?)?|rev(s|olutions?)?)"
    r"([ _]*(/|per|p)[ _]*(?P<per>[a-z]*)|[ _.*·]*(?P<time>s|sec|min|h|hr|hours?)(?![a-z]))?"
    r"(?![a-z])"
)
_SECOND = ("s", "sec", "secs", "second", "seconds")
# ROS has rad/s (REP 103), Betaflight's flight recorder deg/s
_BY_CONVENTION = {"rad/s": re.compile(r"angular_velocity[./]"), "deg/s": re.compile("gyroadc")}


def printable(name: object) -> str:
    """A name of a column as a message prints it."""
    return "".join(c if c.isprintable() else "?" for c in " ".join(str(name).split()))


def listed(names: Iterable[str]) -> str:
    """Names for a message."""
    some = [repr(n[:60]) for n in names]
    return ", ".join(some[:20]) + (f" and {len(some) - 20} more" if len(some) > 20 else "")


def triples(names: Sequence[str], sensor: str) -> list[list[int]]:
    """Columns x, y, z of every "gyro", "accel", "mag" or "unnamed" sensor."""
    found: dict[str, list[tuple[str, int]]] = {}
    for i, name in enumerate(names):
        text = bare(name)[0]
        match = _AXIS.fullmatch(_UNIT_AT_END.sub("", text)) or _AXIS.fullmatch(text)
        if match is None:
            continue
        stem = re.sub(r"[ _\-]", "", re.split(r"[./]", match["stem"])[-1]).lower()
        if _SENSORS[sensor].fullmatch(stem) and not _NOT_RATES.search(stem):
            axis = match["axis"].strip("[]()").lower()
            found.setdefault(match["stem"].lower(), []).append((axis, i))
    sets = [sorted(axes) for axes in found.values()]
    return [[i for _, i in axes] for axes in sets if "".join(a for a, _ in axes) in ("xyz", "012")]


def gyro(names: Sequence[str], about: str) -> list[int] | None:
    """The gyro's columns, None if there are none; ``about`` describes the contents of the table.

    Raises ``GyroLogError`` for more than one gyro, and for axes of a sensor without a name.
    """
    found = triples(names, "gyro")
    words = [bare(name)[0].lower() for name in names]
    if not found and all(words.count(word) == 1 for word in "pqr"):
        return [words.index(word) for word in "pqr"]
    if not found and (unnamed := triples(names, "unnamed")):
        if not _ABOUT_RATES.search(about):
            axes = listed(names[i] for i in unnamed[0])
            raise GyroLogError(
                f"found no three columns named like gyro x, y, z: {axes} do not name their sensor; "
                "accepted: the name that their logger gives a gyro's file (Gyroscope.csv of Sensor "
                "Logger, *_vehicle_angular_velocity_0.csv of PX4), or columns, to say which"
            )
        found = unnamed
    if len(found) > 1:
        first = listed(names[i] for axes in found for i in axes)
        raise GyroLogError(f"found more than one gyro ({first}); say which with columns")
    return found[0] if found else None


def quaternion(names: Sequence[str]) -> list[int] | None:
    """Columns w, x, y, z of the only attitude; None if there is none."""
    found: dict[str, list[tuple[str, int]]] = {}
    for i, name in enumerate(names):
        match = _QUAT.fullmatch(bare(name)[0])
        if match and match["axis"]:
            found.setdefault(match["stem"].lower(), []).append((match["axis"].lower(), i))
        elif match:  # scalar first
            found.setdefault("0", []).append(("wxyz"[int(match["number"])], i))
    sets = [dict(axes) for axes in found.values() if "".join(sorted(dict(axes))) == "wxyz"]
    only = len(sets) == 1 and sum(len(x) == 4 for x in found.values()) == 1
    return [sets[0][axis] for axis in "wxyz"] if only else None


def clock(names: Sequence[str]) -> list[int]:
    """The column of time stamps: a sensor's, else one with a unit, else any; [] if there is none.

    Columns of whole seconds and of nanoseconds are both returned.

    Raises ``GyroLogError`` for more than one.
    """
    found: dict[int, list[int]] = {}
    for i, name in enumerate(names):
        if _STAMP.fullmatch(bare(name)[0]):
            found.setdefault(0, []).append(i)
        elif _time(name):
            found.setdefault(1 if time_unit(name) else 2, []).append(i)
    best = found[min(found)] if found else []
    if len(best) > 1:
        two = listed(names[i] for i in best)
        raise GyroLogError(f"found more than one time column ({two}); say which with time_column")
    return best or _seconds_and_nanoseconds(names)


def _seconds_and_nanoseconds(names: Sequence[str]) -> list[int]:
    words = [name.lower() for name in names]
    pairs = []
    for i, word in enumerate(words):
        match = _STAMP_SECONDS.fullmatch(word)
        beside = [match[1] + end for end in ("nanosec", "nsecs", "nsec")] if match else []
        pairs += [[i, words.index(name)] for name in beside if name in words]
    return min(pairs, key=lambda pair: "header" not in words[pair[0]], default=[])


def time_unit(name: str) -> str | None:
    """The unit in the name of a column of time stamps, known or not; None if there is none."""
    match = _time(name)
    if match is None:
        return None
    unit = (match["unit"] or bare(name)[1] or ("s" if match["elapsed"] else "")).lower()
    for short, start in (("ms", "m(s|illi)"), ("us", "([uµμ]s|micro)"), ("ns", "n(s|ano)")):
        if re.match(start, unit):
            return short
    return "s" if unit in _SECOND else unit or None


def rate_unit(names: Sequence[str]) -> str | None:
    """The unit, of ``UNITS``, in the names of a gyro's columns; None if there is none."""
    found = {m[0]: _unit(m) for name in names for m in _UNIT.finditer(name.lower())}
    found |= {u: "" for u in (bare(name)[1] for name in names) if not found and "/" in u}
    units = set(found.values())
    if not units <= UNITS.keys() or len(units) > 1:
        raise GyroLogError(
            f"found the unit {', '.join(found)[:60]} in the names of columns; accepted: one for "
            f"all of {', '.join(UNITS)}, or unit, to say which it is"
        )
    for unit, pattern in _BY_CONVENTION.items():
        if not units and all(pattern.search(name.lower()) for name in names):
            return unit
    return units.pop() if units else None


def _unit(match: re.Match[str]) -> str:
    """A unit in the spelling of ``UNITS``, known or not."""
    scale, angle, per = match["scale"] or "", match["angle"], match["per"] or match["time"]
    scale = "m" if scale == "milli" else scale
    if angle.startswith(("rp", "hz")):
        return scale + angle.replace("hz", "Hz") + (f"/{per}" if per else "")
    for short, others in (("deg", ("°", "dps")), ("rad", ()), ("arcsec", ()), ("rev", ())):
        angle = short if angle.startswith((short, *others)) else angle
    per = "s" if per is None or per in _SECOND else ("h" if per.startswith("h") else per)
    return f"{scale}{angle}/{per}"


def accel_unit(name: str) -> float | None:
    """The unit in the name of an accelerometer's column, in m/s²; None if there is none."""
    text = name.lower()
    if re.search(r"m[ _]*[/p _.*·]?[ _]*s", text):
        return 1.0
    match = re.search(r"(?<=[\[( _])(m?)g[\])]?$", text)
    return match and (STANDARD_GRAVITY * (1e-3 if match[1] else 1.0))


def is_unit(text: str) -> bool:
    """Whether a cell in a second line of names is a unit."""
    return not text or _UNIT.fullmatch(text.lower()) is not None or len(text) <= 8


def bare(name: str) -> tuple[str, str]:
    """A name without its unit in brackets and without comment signs; and the unit."""
    text = re.sub(r"_cal(?=$|[ \[(])", "", name.strip("#% "), flags=re.IGNORECASE)
    match = _IN_BRACKETS.search(text)
    if match and match["unit"].strip().lower() not in ("0", "1", "2", "x", "y", "z"):
        return text[: match.start()], match["unit"].strip()
    return text, ""


def _time(name: str) -> re.Match[str] | None:
    word = re.split(r"[./]", bare(name)[0])[-1]
    word = re.sub("[ _]s$", "seconds", word.lower())
    return _TIME.fullmatch(re.sub(r"(?<=.)[ _\-]", "", word))
