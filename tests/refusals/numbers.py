"""Of conversions, angles, Euler sequences, messages and pictures."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from functools import cache, partial

import numpy as np
import pandas as pd

import fastatt as fa
from fastatt import interchange as ic
from fastatt import plots
from fastatt.interchange.aem import to_aem

ONE, Q = [1, 0, 0, 0], np.array([[0.6, 0.8, 0.0, 0.0], [0.6, 0.0, 0.8, 0.0], [1.0, 0.0, 0.0, 0.0]])
T, W = np.array([0.0, 0.5, 1.0]), np.full((3, 3), 0.1)
SKEWED = np.eye(3) + np.eye(3, k=1) * 0.011
NEW = {
    "OBJECT_NAME": "SAT", "OBJECT_ID": "2026-001A", "REF_FRAME_A": "EME2000",
    "REF_FRAME_B": "SC_BODY_1", "TIME_SYSTEM": "UTC",
}  # fmt: skip
ANGVEL = {"ATTITUDE_TYPE": "QUATERNION/ANGVEL", "ANGVEL_FRAME": "SC_BODY_1"}
SEGMENT = ic.AemSegment("2016-12-31T23:59:58.25", T, Q, W, NEW | ANGVEL)
INERTIAL = "an inertial frame such as"
MAPPING = "metadata: found …; accepted: a mapping of str"
BODY, CONING = fa.Scene(inertia=(3.0, 2.0, 1.0)), fa.Scene(rate=fa.rates.Coning(0.1, 1.0))


@cache
def spun(bodies=1, t0=0.0):
    scene = fa.Scene(rate=fa.rates.Constant((0.0, 0.0, 0.1)))
    q0 = [ONE] * bodies if bodies > 1 else ONE
    return fa.propagate(scene, q0, dt=0.5, n_steps=2, save_every=1, t0=t0)


@cache
def tumbling(**options):
    return fa.propagate(BODY, ONE, [0.1, 1.0, 0.0], dt=0.1, n_steps=2, method="rk4", **options)


def message(bodies=1, t0=0.0, **options):
    given = {"epoch": "2026-01-01T00:00:00", "frame": "ICRF"} | options
    return lambda: to_aem(spun(bodies, t0), **given)


def segment(**changes):
    return lambda: ic.Aem("2.0", {}, (replace(SEGMENT, **changes),)).text()


def euler(sequence):
    return partial(fa.euler_to_quat, W, sequence), partial(fa.quat_to_euler, Q, sequence)


def drawn(draw, run, scene=None):
    return lambda: draw(run(), path="a.png", scene=scene)


def flagged():
    run = tumbling(save_every=1)
    return replace(run, status=run.status | 1)


TOO_LARGE = [[0.0, 0.0, 0.0], [0.0, 0.0, -1e51]]
OF_ANGLES = [
    ("u", fa.rotation_vector_to_quat),
    ("angles", fa.euler313_to_quat),
    ("angles", fa.euler_to_quat, "ZYX"),
]

REFUSED = [
    ("a: has shape (3,)", partial(fa.angle_between, [1, 0, 0], ONE)),
    ("b: has shape (2, 4), a (3", partial(fa.angle_between, Q, Q[:2])),
    ("a: found", partial(fa.angle_between, ["a"] * 4, ONE), TypeError),
    ("a: found the det", partial(fa.angle_between, 2.0 * np.eye(3), ONE)),
    ("q: has shape (3,); accepted: (..., 4", partial(fa.quat_to_dcm, np.zeros(3))),
    ("q: found", partial(fa.quat_to_euler313, [1j, 0, 0, 0]), TypeError),
    ("angles: has shape (2,)", partial(fa.euler313_to_quat, [1, 2])),
    ("u: has shape ()", partial(fa.rotation_vector_to_quat, 1.0)),
    ("C: has shape (4, 4); accepted", partial(fa.dcm_to_quat, np.eye(4))),
    ("C: found the determinant 0", partial(fa.dcm_to_quat, np.zeros((3, 3)))),
    ("C: …identity by 0.0", partial(fa.dcm_to_quat, SKEWED)),
    ("C[1]: found the determinant 8, and CᵀC off",
     partial(fa.dcm_to_quat, [np.eye(3), 2.0 * np.eye(3)])),
    *[(f"{name}[1, 2] is …; accepted: up to 1e+50", partial(function, TOO_LARGE, *more))
      for name, function, *more in OF_ANGLES],
    *[("sequence: found …; accepted: three of x, y, z", call)
     for x in ("xyX", "xxy", "xy", "ZYXZ", "zyw", 313, None, ["x", "y", "z"]) for call in euler(x)],
    *[("…has shape (2, 5); accepted: (..., 4)", partial(function, np.ones((2, 5))))
     for function in (ic.to_scalar_last, ic.from_scalar_last)],
    *[("…accepted: real numbers", partial(function, "north"), TypeError)
     for function in (ic.to_scalar_last, ic.from_scalar_last)],
    *[("q", partial(ic.to_scipy, x)) for x in ([0.0] * 4, [np.nan, 0.0, 0.0, 1.0])],
    ("rotation: found ndarray; …from_scalar_last", partial(ic.from_scipy, Q), TypeError),
    # messages
    ("body: found 2; accepted: 0 to 1", message(2, body=2)),
    ("body: found None; accepted: 0 to 1, since a message is of one", message(2)),
    ("version: found '3.0'; accepted: 1.0, 2.0", message(version="3.0")),
    ("attitude_type: found 'SPIN'; accepted: QUATERNION, QUAT", message(attitude_type="SPIN")),
    *[("frame: found …; accepted: a line", message(frame=x)) for x in ("", "A\nB", "é")],
    *[(f"…frame: found …; accepted: {INERTIAL}", message(**frames))
     for frames in (*({"frame": x}
     for x in ("ITRF-93", "itrf2000", "LVLH", "RSW_ROTATING", "IAU_MARS", "SC_BODY_1")),
     {"body_frame": "icrf"}, {"metadata": {"REF_FRAME_A": "LVLH"}},
     {"metadata": {"REF_FRAME_B": "ICRF"}})],
    ("frame: found None; accepted: a line of ASCII text", message(frame=None)),
    ("body_frame: found 5; accepted: a line of ASCII text", message(body_frame=5)),
    (MAPPING, message(metadata=5), TypeError),
    (MAPPING, message(metadata=[("OBJECT_NAME", "A")]), TypeError),
    ("metadata TIME_SYSTEM: found 5; accepted: a line", message(metadata={"TIME_SYSTEM": 5})),
    ("header: found 5; accepted: CLASSIFICATION, CREATION_DATE", message(header={5: "A"})),
    ("header: found 'A'; accepted: a mapping of str to str", message(header="A"), TypeError),
    ("epoch: found NaT; accepted: a datetime", message(epoch=pd.NaT), TypeError),
    ('epoch: found 5; accepted: a datetime, "unix", or text such as YYYY-MM-DD', message(epoch=5),
     TypeError),
    ("epoch: found 'soon'; accepted: a datetime", message(epoch="soon")),
    ("epoch: …with an offset from UTC, and TIME_SYSTEM TAI",
     message(epoch=datetime(2026, 1, 1, tzinfo=UTC), metadata={"TIME_SYSTEM": "TAI"})),
    *[('epoch: found "unix" with TIME_SYSTEM …; accepted',
     message(epoch="unix", metadata={"TIME_SYSTEM": x})) for x in ("TAI", "GPS")],
    # the Unix epoch, as local time too, and any day without leap seconds
    *[('epoch: found …19…accepted: "unix" where t is Unix time, or a time near the run',
     message(t0=1.7e9, epoch=x))
     for x in ("1970-001T00:00:00", datetime.fromisoformat("1970-01-01"), "1969-12-31T19:00:00",
     "1970-01-01T00:00:00+01:00", "1971-12-31")],
    ("run: found …; accepted: a Trajectory",
     partial(to_aem, {"q": Q, "t": T}, epoch="2026-01-01", frame="ICRF"), TypeError),
    *[("segments: found …; accepted: one AemSegment or", lambda x=x: ic.Aem("2.0", {}, x).text())
     for x in ((), [1e200])],
    ("header: found None; accepted: a mapping", lambda: ic.Aem("2.0", None, (SEGMENT,)).text(),
     TypeError),
    ("to_aem() got an unexpected keyword",
     lambda: spun().to_aem("a.aem", epoch="unix", frame="ICRF", unknown=1), TypeError),
    ("segments[0].t: time 2016-12-31T23:… does not rise", segment(t=T[::-1])),
    ("segments[0].w: has shape (0,) and is empty; accepted: (3, 3)", segment(w=None)),
    ("segments[0].q[0, 0] is nan", segment(q=Q * np.nan)),
    ("…time: found yesterday; accepted: YYYY-MM-DD", segment(epoch="yesterday")),
    ("…metadata: found COLOUR; accepted: OBJ", segment(metadata=NEW | ANGVEL | {"COLOUR": "RED"})),
    ("…without ATTITUDE_TYPE", segment(metadata=NEW)),
    ("…found times from … accepted: within START_TIME and STOP_TIME",
     segment(metadata=NEW | ANGVEL | {"STOP_TIME": "2017-01-01T00:00:00",
     "START_TIME": "2016-12-31T23:59:59"})),
    # pictures
    ("run: has 1 save; accepted: two or more", drawn(plots.history, tumbling)),
    ("run: found flags of all bodies", drawn(plots.polhode, flagged, BODY)),
    ("scene: found a rate; accepted: a scene with inertia",
     drawn(plots.polhode, partial(tumbling, save_every=1), CONING)),
    ("run: found 'run.csv'; accepted: a Trajectory", drawn(plots.history, lambda: "run.csv"),
     TypeError),
]  # fmt: skip
