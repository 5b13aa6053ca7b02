"""The meaning of column names: sensors, axes, time, units, and formats that define them."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from fastatt.gyro.log import GyroLogError

_DEGREE = math.pi / 180.0
UNITS = {
    "rad/s": 1.0, "deg/s": _DEGREE, "mrad/s": 1e-3, "mdeg/s": 1e-3 * _DEGREE,
    "deg/min": _DEGREE / 60.0, "deg/h": _DEGREE / 3600.0, "arcsec/s": _DEGREE / 3600.0,
    "rev/s": 2.0 * math.pi, "rpm": math.pi / 30.0, "Hz": 2.0 * math.pi,
}  # fmt: skip
# number of each in a second; Xsens counts tenths of a millisecond
TIME_UNITS = {"s": 1.0, "ms": 1e3, "100us": 1e4, "us": 1e6, "ns": 1e9}
# in m/s²; g by CGPM 1901
ACCEL_UNITS = {
    "m/s²": 1.0, "cm/s²": 1e-2, "mm/s²": 1e-3, "g": 9.80665, "mg": 9.80665e-3, "-g": -9.80665,
}  # fmt: skip


class Format(NamedTuple):
    """A format that defines the unit of its gyro, rad/s, and those of its time stamps.

    Names of columns are regular expressions. ``file`` is that of the file, and ``known_by`` a
    column that such a file has, where the names of the gyro's columns do not tell.
    """

    gyro: str
    clocks: Mapping[str, str]  # the unit of each column of time stamps, the best one first
    accel: str = "(?!)"
    file: str = ".*"
    known_by: str = ""


FORMATS = (
    # PX4, sensor_combined: uORB's time stamps are microseconds
    Format(gyro=r"gyro_rad\[[012]\]", clocks={"timestamp": "us"}),
    # rostopic echo -p; sensor_msgs/Imu has rad/s and specific force (REP 103 and 145)
    Format(
        gyro=r"field\.angular_velocity\.[xyz]",
        clocks={r"field\.header\.stamp": "ns", "%?time": "ns"},
        accel=r"field\.linear_acceleration\.[xyz]",
    ),
    # the same messages by other tools, such as PlotJuggler
    Format(
        gyro=r"(.*[./])?angular_velocity[./][xyz]",
        clocks={"__time": "s"},
        accel=r"(.*[./])?linear_acceleration[./][xyz]",
    ),
    # Sensor Logger, a file for each sensor
    Format(
        gyro="[xyz]",
        clocks={"seconds_elapsed": "s", "time": "ns"},
        file=r"gyroscope\.csv(\.gz)?",
        known_by="seconds_elapsed",
    ),
)

# names of three-axis sensors, without axis, blanks, dashes and underscores
_SENSORS = {
    "gyro": r".*gyr.*|omega|w|g|wrss|.*(ang(ular)?|rotation|body)(velocity|vel|rate|speed)s?|rates?"
    r"|rateofturn",
    # specific force: without what leaves out gravity, or is gravity
    "accel": r"(?!.*(free|user|lin|grav|ang|gyr|world|earth|global|accur))(.*acc.*|a|arss)",
    "mag": r"(?!.*(geo|magnitude|rotation|vector))(.*mag.*|m)",
    "like accel": r"(?!.*(ang|gyr)).*acc.*|a",
    "like mag": r".*mag.*|m",
    "unnamed": "",
}
_WORDS = {"accel": "accelerometer", "mag": "magnetometer"}
# columns of a sensor that are not its samples
_NO_SAMPLES = re.compile(r"bias|cov|std|var|noise|temp|offset|err|sigma|integral|uncal|raw")
_IN_BRACKETS = re.compile(r"[ _]*[\[(](?P<unit>[^\[\]()]*)[\])]$")
_UNIT_AT_END = re.compile(
    r"[ _]+([mkuµμ]?(deg|rad|°|dps|rp[ms]|hz)|m?g$|[mnuµμ]?(t|tesla|gauss)$|[cm]?m[ _/p]*s).*$",
    re.IGNORECASE,
)
_AXIS = re.compile(
    r"(?P<stem>.*?)[ _.\-/]*(?P<axis>[\[(][012xyz][\])]|[xyz])", re.IGNORECASE | re.DOTALL
)
_TIME = re.compile(
    r"(_*times?|timestamps?|ts?|stamps?|datetime|date|elapsed(time)?|seconds(?P<elapsed>elapsed)?"
    r"|timesincestart|unixtime(stamp)?|epoch|clock|\w*timestampunix|loggingtime|logtime"
    r"|sampletimefine)(in)?"
    r"(?P<unit>s|sec|secs|seconds?|ms|msec|milli(second)?s|us|µs|μs|usec|micro(second)?s"
    r"|ns|nsec|nano(second)?s|min)?"
)
# whole seconds of ROS, next to a column of nanoseconds
_STAMP_SECONDS = re.compile(r"((?:.*[./])?stamp[./_])secs?", re.IGNORECASE)
_RATE = re.compile(
    r"(?<![a-z])(?P<scale>milli|micro|[mkuµμ])?(?P<angle>deg(rees?|s)?|°|dps|rad(ians?|s)?|rp[ms]"
    r"|(?<!\d)hz|arcsec(s|onds?)?|rev(s|olutions?)?)"
    r"([ _]*(/|per|p)[ _]*(?P<per>[a-z]+)|[ _.*·]*(?P<time>s|sec|min|h|hr|hours?)(?![a-z]))?"
    r"(?P<power>\^?-?\d+|⁻?[¹²³])?(?![a-z])"
)
_SPELLINGS = {
    "s": "secs?|seconds?",
    "ms": "m(s|illi).*",
    "us": "([uµμ]s|micro).*",
    "ns": "n(s|ano).*",
    "h": "hr|hours?",
    "deg": "deg(rees?|s)|°",
    "deg/s": "dps",
    "rad": "rad(ians?|s)",
    "arcsec": "arcsec(s|onds?)",
    "rev": "rev(s|olutions?)",
    "Hz": "hz",
}
_METRES = re.compile(r"(?<![a-z])([cm]?)m[ _]*[/p.*·]?[ _]*s(ec)?[ _]*(\^?-?2|⁻?²|/s)(?![a-z\d])")
_IN_G = re.compile(r"(?<=[\[( _])(m?)g[\])]?$")
_FIELD = re.compile(r"[\[( _](?P<unit>[mnuµμ]?(t|teslas?|g|gauss))[\])]?$", re.IGNORECASE)


def printable(name: object) -> str:
    """A name of a column as a message prints it."""
    return "".join(c if c.isprintable() else "?" for c in " ".join(str(name).split()))


def listed(names: Iterable[str]) -> str:
    """Names for a message."""
    some = [repr(n[:60]) for n in names]
    return ", ".join(some[:20]) + (f" and {len(some) - 20} more" if len(some) > 20 else "")


def triples(names: Sequence[str], sensor: str) -> list[list[int]]:
    """Columns x, y, z of every sensor of a kind, such as "gyro"."""
    found: dict[str, list[tuple[str, int]]] = {}
    for i, name in enumerate(names):
        text = bare(name)[0]
        match = _AXIS.fullmatch(_UNIT_AT_END.sub("", text)) or _AXIS.fullmatch(text)
        if match is None:
            continue
        stem = _UNIT_AT_END.sub("", re.split(r"[./]", match["stem"])[-1])
        stem = re.sub(r"[ _\-]", "", stem).lower()
        if re.fullmatch(_SENSORS[sensor], stem) and not _NO_SAMPLES.search(stem):
            axis = match["axis"].strip("[]()").lower()
            found.setdefault(match["stem"].lower(), []).append((axis, i))
    sets = [sorted(axes) for axes in found.values()]
    return [[i for _, i in axes] for axes in sets if "".join(a for a, _ in axes) in ("xyz", "012")]


def format_of(names: Sequence[str], axes: Sequence[str], file: str) -> Format | None:
    """The format that defines columns of a gyro with these axes; None if none does."""
    for known in FORMATS:
        named = all(re.fullmatch(known.gyro, axis) for axis in axes)
        if named and re.fullmatch(known.file, Path(file).name, re.IGNORECASE):
            return known if known.known_by in ("", *names) else None
    return None


def gyro(names: Sequence[str], file: str) -> list[int] | None:
    """The gyro's columns, None if there are none; raises ``GyroLogError`` for more than one gyro.

    Axes of a sensor without a name are those of a gyro in a format alone.
    """
    unnamed = triples(names, "unnamed")[:1]
    defined = [axes for axes in unnamed if format_of(names, [names[i] for i in axes], file)]
    found = triples(names, "gyro") or defined
    if len(found) > 1:
        first = listed(names[i] for axes in found for i in axes)
        raise GyroLogError(f"found more than one gyro ({first}); say which with columns")
    return found[0] if found else None


def other_sensor(
    names: Sequence[str], sensor: str, known: Format | None
) -> tuple[list[int], float, str]:
    """Columns of the "accel" or "mag" whose names and unit say so, [] for none; and their unit.

    The unit of an accelerometer is in m/s², that of a magnetometer is 1. Last is what was found.
    """
    named, word = triples(names, sensor), _WORDS[sensor]
    if known and sensor == "accel":
        named += [x for x in triples(names, "like accel") if re.fullmatch(known.accel, names[x[0]])]
    units = [unit_of_other(sensor, names[axes[0]], known) for axes in named]
    fit = [(axes, unit) for axes, unit in zip(named, units, strict=True) if unit]
    if len(fit) == 1:
        axes, unit = fit[0]
        scale = ACCEL_UNITS[unit] if sensor == "accel" else 1.0
        return axes, scale, f"{word} in {unit}: {names[axes[0]]} ..."
    why = "one of several" if fit else "without a unit" if named else "of another quantity"
    like = named or triples(names, f"like {sensor}")
    return [], 1.0, f"no {word}: {names[like[0][0]][:60]} ... is {why}" if like else ""


def unit_of_other(sensor: str, name: str, known: Format | None) -> str | None:
    """The unit of a column of an "accel" or "mag", by its name or a format; None if there is none.

    An accelerometer's is one of ``ACCEL_UNITS``.
    """
    text = name.lower()
    if sensor == "mag":
        return match["unit"] if (match := _FIELD.search(name)) else None
    if match := _METRES.search(text):
        return f"{match[1]}m/s²"
    if match := _IN_G.search(text):
        # iOS has the opposite sign (Core Motion, as SensorLog names it)
        return "-g" if "accelerometeracceleration" in text else f"{match[1]}g"
    return "m/s²" if known and re.fullmatch(known.accel, name) else None


def clock(names: Sequence[str], known: Format | None) -> list[int]:
    """The column of time stamps: a format's, else one with a unit, else any; [] if there is none.

    Columns of whole seconds and of nanoseconds are both returned.

    Raises ``GyroLogError`` for more than one.
    """
    for pattern in known.clocks if known else ():
        if defined := [i for i, name in enumerate(names) if re.fullmatch(pattern, name)]:
            return defined[:1]
    if pair := _seconds_and_nanoseconds(names):
        return pair
    timed = [i for i, name in enumerate(names) if _time(name)]
    best = [i for i in timed if time_unit(names[i], None)] or timed
    if len(best) > 1:
        two = listed(names[i] for i in best)
        raise GyroLogError(f"found more than one time column ({two}); say which with time_column")
    return best


def _seconds_and_nanoseconds(names: Sequence[str]) -> list[int]:
    words = [name.lower() for name in names]
    pairs = []
    for i, word in enumerate(words):
        match = _STAMP_SECONDS.fullmatch(word)
        fractions = [match[1] + end for end in ("nanosec", "nsecs", "nsec")] if match else []
        pairs += [[i, words.index(name)] for name in fractions if name in words]
    return min(pairs, key=lambda pair: "header" not in words[pair[0]], default=[])


def time_unit(name: str, known: Format | None) -> str | None:
    """The unit of a column of time stamps, by a format or its name; None if there is none."""
    for pattern, unit in known.clocks.items() if known else ():
        if re.fullmatch(pattern, name):
            return unit
    match = _time(name)
    if match is None:
        return None
    unit = (match["unit"] or bare(name)[1] or ("s" if match["elapsed"] else "")).lower()
    return _spelled(unit) or None


def rate_unit(names: Sequence[str]) -> str | None:
    """The unit, of ``UNITS``, in the names of a gyro's columns; None if there is none."""
    found = {m[0]: _unit(m) for name in names for m in _RATE.finditer(name.lower())}
    if not found:
        found = {unit: "" for unit in (bare(name)[1] for name in names) if unit}
    units = set(found.values())
    if not units <= UNITS.keys() or len(units) > 1:
        raise GyroLogError(
            f"found the unit {', '.join(found)[:60]} in the names of columns; accepted: one for "
            f"all of {', '.join(UNITS)}, or unit, to say which it is"
        )
    return units.pop() if units else None


def _unit(match: re.Match[str]) -> str:
    """A unit in the spelling of ``UNITS``, known or not."""
    power = (match["power"] or "").removeprefix("^")
    if power and (match["per"] or power not in ("-1", "⁻¹")):
        return match[0]
    scale, per = match["scale"] or "", match["per"] or match["time"]
    per = f"/{_spelled(per)}" if per else ""
    return f"{scale.removesuffix('illi')}{_spelled(match['angle'])}{per}"


def _spelled(word: str) -> str:
    """The usual spelling of a unit, or the word itself."""
    return next((unit for unit, known in _SPELLINGS.items() if re.fullmatch(known, word)), word)


def bare(name: str) -> tuple[str, str]:
    """A name without its unit in brackets and without comment signs; and the unit."""
    text = re.sub(r"_cal(?=$|[ \[(])", "", name.strip("#% "), flags=re.IGNORECASE)
    match = _IN_BRACKETS.search(text)
    if match and match["unit"].strip().lower() not in ("0", "1", "2", "x", "y", "z"):
        return text[: match.start()], match["unit"].strip()
    return text, ""


def _time(name: str) -> re.Match[str] | None:
    word, unit = bare(name)
    if word in ("T", "t") and not _TIME.fullmatch(f"t{unit.lower()}" if unit else word):
        return None  # a temperature
    word = re.sub("[ _]s$", "seconds", re.split(r"[./]", word)[-1].lower())
    return _TIME.fullmatch(re.sub(r"(?<=.)[ _\-]", "", word))
