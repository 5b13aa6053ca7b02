"""The meaning of column names: sensors, axes, time, units, and formats that define them."""

from __future__ import annotations

import math
import re
from collections import Counter
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
#: units of angle increments, in rad
ANGLES = {name.removesuffix("/s"): scale for name, scale in UNITS.items() if name.endswith("/s")}
# number of each in a second; Xsens counts tenths of a millisecond, Windows 100 ns
TIME_UNITS = {"s": 1.0, "ms": 1e3, "100us": 1e4, "us": 1e6, "100ns": 1e7, "ns": 1e9}
# in m/s²; g by CGPM 1901
ACCEL_UNITS = {
    "m/s²": 1.0, "cm/s²": 1e-2, "mm/s²": 1e-3, "g": 9.80665, "mg": 9.80665e-3, "-g": -9.80665,
}  # fmt: skip


class Format(NamedTuple):
    """A format that defines the unit of its gyro, rad/s or rad, and those of its time stamps.

    Names of columns are regular expressions. ``file`` is that of the file, and ``known_by`` a
    column that such a file has, where the names of the gyro's columns do not tell.
    """

    gyro: str
    clocks: Mapping[str, str]  # the unit of each column of time stamps, the best one first
    accel: str = "(?!)"
    file: str = ".*"
    known_by: str = ""
    values: str = "samples"

    @property
    def unit(self) -> str:
        """The unit of the gyro's numbers."""
        return "rad" if self.values == "increments" else "rad/s"


class Sensor(NamedTuple):
    """Columns x, y, z of a sensor, [] for none, the unit of its numbers, and what is said of it."""

    columns: list[int]
    scale: float = 1.0
    said: str = ""


FORMATS = (
    # PX4, sensor_combined: uORB's time stamps are microseconds
    # and the rates are means over the interval before (its message definition)
    Format(gyro=r"gyro_rad\[[012]\]", clocks={"timestamp": "us"}, values="means"),
    # PX4, vehicle_imu
    Format(gyro=r"delta_angle\[[012]\]", clocks={"timestamp": "us"}, values="increments"),
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

# words next to that of a sensor: devices, their places on a body, and what was done to samples
_PLACES = (
    r"left|right|[lrsb]|upper|lower|fore|front|rear|back|head|neck|trunk|torso|chest|sternum|waist"
    r"|pelvis|hip|lumbar|sacrum|thigh|shank|shin|knee|ankle|foot|toe|heel|arm|wrist|hand|helmet"
    r"|phone|watch|primary|main"
)
_BESIDE = (
    rf"{_PLACES}|imu|sensors?|device|dev|data|adc|cal(ib(rated)?)?|(un)?filt(ered)?|lpf|smooth(ed)?"
    r"|values?|meas(ured|urements?)?|scaled|sync(ed)?|input|rs|xyz|\d++"
    r"|(mpu|icm|bm[ix]|bno|lsm|adis|itg|l3g|mti|xsens|vn|stim)\d*+[a-z]{0,2}\d*+"
)
_MOVING = "|motion|body|corr(ected)?|comp(ensated)?|ib"  # of rates alone: "body acceleration"
_TURNS = (
    r"gyr(o(s|scopes?)?)?(rotations?|rates?)?|omegas?|rates?(ofturn|gyro)?"
    r"|(ang(ular)?|rot(ation(al)?)?|body|turn)(velocity|velocities|vel|rate|speed)s?"
    r"|(gyro?)?(?P<is_increment>(delta|d)(ang(le)?s?|theta)|angles?|inc(rement)?s?)"
)
# names of three-axis sensors, without axis, blanks, dashes and underscores, by all that they say:
# a word that is not here may mean another frame, a reference, a statistic or an error; of words
# without a limit to their number, a search for those of a long name would not end
_SENSORS = {
    "gyro": rf"({_BESIDE}{_MOVING}){{0,6}}({_TURNS})({_BESIDE}{_MOVING}){{0,6}}|wrss|w|g",
    # specific force: "linear", "user" and "motion" leave out gravity
    "accel": rf"({_BESIDE}){{0,6}}(acc|accels?|acc?eleration|(accelerometer)s?(acceleration)?"
    rf"|specificforce)({_BESIDE}){{0,6}}|arss|a",
    "mag": rf"({_BESIDE}|motion){{0,6}}(magn?|magnetometer|mag(netic)?field|compass)"
    rf"({_BESIDE}){{0,6}}|m",
    "like accel": r"(?!.*(ang|gyr)).*acc.*|a",
    "like mag": r".*mag.*|m",
    "unnamed": "",
}
_WORDS = {"accel": "accelerometer", "mag": "magnetometer"}
# units of numbers that are no rates, whatever an argument says of them
_NO_RATES = re.compile(r"lsbs?|counts?|raw|digits?|adc|bits?|ticks?|m?g|m/s.*|.*volts?|m?v")
_IN_BRACKETS = re.compile(r"(?<![ _,])[ _,]*[\[(](?P<unit>[^\[\]()]*)[\])]$")
_UNIT_AT_END = re.compile(
    r"(?<![ _,])[ _,]+([mkuµμ]?(deg|rad|°|dps|rp[ms]|hz)|m?g$|[mnuµμ]?(t|tesla|gauss)$"
    r"|[cm]?m[ _/p]*s).*$",
    re.IGNORECASE,
)
_AXIS = re.compile(r"(?P<before>.*)(?P<axis>[\[(][012xyz][\])]|[xyz])", re.IGNORECASE)
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
    r"|(?<!\d)hz|arcsec(s|onds?)?|rev(s|olutions?)?|turns)"
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
    "rev": "rev(s|olutions?)|turns",
    "Hz": "hz",
}
_METRES = re.compile(r"(?<![a-z])([cm]?)m[ _]*[/p.*·]?[ _]*s(ec)?[ _]*(\^?-?2|⁻?²|/s)(?![a-z\d])")
_IN_G = re.compile(r"(?<=[\[( _])(m?)g[\])]?$")
_FIELD = re.compile(r"[\[( _](?P<unit>[mnuµμ]?(t|teslas?|g|gauss))[\])]?$", re.IGNORECASE)


def printable(name: object) -> str:
    """A name of a column as a message prints it, at most 200 letters."""
    text = " ".join(str(name).split())[:200]
    return "".join(c if c.isprintable() else "?" for c in text)


def listed(names: Iterable[str]) -> str:
    """Names for a message."""
    some = [repr(n[:60]) for n in names]
    return ", ".join(some[:20]) + (f" and {len(some) - 20} more" if len(some) > 20 else "")


def triples(names: Sequence[str], sensor: str) -> list[list[int]]:
    """Columns x, y, z of every sensor of a kind, such as "gyro"."""
    sensors: dict[str, list[tuple[str, int]]] = {}
    for i, name in enumerate(names):
        stem, axis, whole = _stem(name)
        if axis and re.fullmatch(_SENSORS[sensor], stem):
            sensors.setdefault(whole, []).append((axis, i))
    sets = [sorted(axes) for axes in sensors.values()]
    return [[i for _, i in axes] for axes in sets if "".join(a for a, _ in axes) in ("xyz", "012")]


def repeated(names: Sequence[str]) -> list[int]:
    """The columns of gyros, and of times, by names that occur twice."""
    times = Counter(names)
    twice = [i for i, name in enumerate(names) if times[name] > 1]
    of_gyros = [re.fullmatch(_SENSORS["gyro"], _stem(names[i])[0]) for i in twice]
    return [i for i, fits in zip(twice, of_gyros, strict=True) if fits or _time(names[i])]


def _stem(name: str) -> tuple[str, str, str]:
    """The name of a sensor in that of a column; its axis, empty for none; and all before it."""
    text = bare(name)[0]
    match = _AXIS.fullmatch(_UNIT_AT_END.sub("", text)) or _AXIS.fullmatch(text)
    if match is None:
        return "", "", ""
    whole = match["before"].rstrip(" _.,-/").lower()
    stem = _UNIT_AT_END.sub("", re.split(r"[./]", whole)[-1])
    return re.sub(r"[ _,\-]", "", stem), match["axis"].strip("[]()").lower(), whole


def format_of(names: Sequence[str], axes: Sequence[str], file: str) -> Format | None:
    """The format that defines columns of a gyro with these axes; None if none does."""
    for known in FORMATS:
        named = all(re.fullmatch(known.gyro, axis) for axis in axes)
        if named and re.fullmatch(known.file, Path(file).name, re.IGNORECASE):
            return known if known.known_by in ("", *names) else None
    return None


def gyros(names: Sequence[str], file: str) -> list[list[int]]:
    """The columns of every gyro.

    Axes of a sensor without a name are those of a gyro in a format alone.
    """
    unnamed = triples(names, "unnamed")[:1]
    defined = [axes for axes in unnamed if format_of(names, [names[i] for i in axes], file)]
    return triples(names, "gyro") or defined


def other_sensor(names: Sequence[str], sensor: str, known: Format | None) -> Sensor:
    """The "accel", in m/s², or "mag", whose names and unit say so."""
    named, word = triples(names, sensor), _WORDS[sensor]
    if known and sensor == "accel":
        named += [x for x in triples(names, "like accel") if re.fullmatch(known.accel, names[x[0]])]
    units = [unit_of_other(sensor, names[axes[0]], known) for axes in named]
    fit = [(axes, unit) for axes, unit in zip(named, units, strict=True) if unit]
    if len(fit) == 1:
        axes, unit = fit[0]
        said = f"{word} in {unit}: {names[axes[0]]} ..."
        return Sensor(axes, ACCEL_UNITS[unit] if sensor == "accel" else 1.0, said)
    why = "one of several" if fit else "without a unit" if named else "of another quantity"
    like = named or triples(names, f"like {sensor}")
    return Sensor([], said=f"no {word}: {names[like[0][0]][:60]} ... is {why}" if like else "")


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


def rate_unit(
    names: Sequence[str], unit: str | None, values: str, known: Format | None
) -> str | None:
    """The unit of a gyro's numbers: as given, by a format, or in the names of columns; or None.

    Raises ``GyroLogError`` if these differ, or are no rates, or no increments.
    """
    units = ANGLES if values == "increments" else UNITS
    rates = {m[0]: _unit(m) for name in names for m in _RATE.finditer(name.lower())}
    words = {u: u for u in (bare(name)[1] for name in names) if u}
    said = {known.unit: known.unit} if known else rates or words
    one = next(iter(said.values())) if len(set(said.values())) == 1 else None
    # a word in brackets may be no unit, and revolutions and radians both begin with r
    is_open = said and (
        one == "rps" or (not rates and not any(_NO_RATES.fullmatch(u.lower()) for u in words))
    )
    if said and one not in units and not (unit and is_open):
        more = "" if one not in ANGLES else ' (values="increments" reads angle increments)'
        raise GyroLogError(
            f"found the unit {', '.join(said)[:60]} in the names of columns; accepted: one for "
            f"all of {', '.join(units)}{more}; if the names are wrong, rename them"
        )
    if unit is not None and unit not in units:
        raise GyroLogError(f"unit: found {unit!r}; accepted: {', '.join(units)}, of {values}")
    if unit and one in units and unit != one:
        raise GyroLogError(f"unit: found {unit!r}; accepted: {one}, as the columns say, or none")
    if values != "increments" and any(_is_increment(name) for name in names):
        raise GyroLogError(f'{names[0][:60]} is an angle; accepted: values="increments"')
    return unit or one


def is_unit(text: str) -> bool:
    """Whether a text is an angle per time, or an angle."""
    return _RATE.fullmatch(text.strip("[( )]").lower()) is not None


def _is_increment(name: str) -> bool:
    match = re.fullmatch(_SENSORS["gyro"], _stem(name)[0])
    return bool(match and match["is_increment"])


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
