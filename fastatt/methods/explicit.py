"""Explicit Runge-Kutta methods on the numbers of the state, which are defined by their tableaus.

Hairer, Nørsett and Wanner, *Solving Ordinary Differential Equations I* (1993), §II.2.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from fastatt.attitudes.attitude import FAMILIES
from fastatt.methods.method import BODIES, Method, Steps
from fastatt.tracing.formulas import Vector, axpy, largest, scale, weighted


class Tableau(NamedTuple):
    """The coefficients c, a and b of a method; a has a row for each stage but the first."""

    order: int
    c: tuple[float, ...]
    a: tuple[tuple[float, ...], ...]
    b: tuple[float, ...]

    @property
    def rows(self) -> tuple[tuple[float, ...], ...]:
        """A row of a for each stage."""
        return ((), *self.a)


def stepped(tableau: Tableau, *, first_turn: bool) -> Any:
    """The step of a tableau for any equations of motion.

    z is that of the fastest stage. ``first_turn`` uses the rotation of the body at the start of the
    step in place of that of the last stage.
    """

    def step(motion: Any, t: Any, h: Any, x: Vector) -> Any:
        start = motion.base(x)
        instants: dict[float, Any] = {}
        slopes: list[Vector] = []
        y = start
        for c, row in zip(tableau.c, tableau.rows, strict=True):
            if any(row):
                factor, sum_ = weighted(row, slopes)
                y = axpy(h * factor, sum_, start)
            if c not in instants:
                instants[c] = motion.at(t + c * h)
            slopes.append(motion.field(instants[c], y))
        # coordinates may be nearer to their pole at a stage than at the start of the step
        most = largest(slopes) if motion.attitude.has_poles else slopes[0]
        z = h * h * motion.speed_squared(instants[tableau.c[0]], most, start if first_turn else y)
        factor, sum_ = weighted(tableau.b, slopes)
        return motion.advanced(x, scale(h * factor, sum_)), z

    return step


def explicit_method(
    name: str,
    tableau: Tableau,
    of_quaternions: float,
    of_matrices: float,
    *,
    scenes: tuple[str, ...] = ("rate", *BODIES),
    first_turn: bool = False,
    **fields: Any,
) -> Method:
    """The record of a tableau, with its limits."""
    # modified Rodrigues parameters may pass from a rotation of π towards 2π within a step, where
    # they are infinite, and the rates of angles grow without bound near their poles
    of_mrp = min(0.8 * of_quaternions, 2.5)
    limits = dict(zip(FAMILIES, (of_quaternions, of_matrices, of_mrp, 0.3), strict=True))
    step = stepped(tableau, first_turn=first_turn)
    return Method(
        name=name,
        order=tableau.order,
        scenes=scenes,
        uses=("derivative",),
        rate_calls=len(set(tableau.c)) if "rate" in scenes else len(tableau.b),
        body_calls=len(tableau.b),
        compensates=True,
        couples=True,
        limits=limits,
        steps=Steps(rate=step if "rate" in scenes else None, body=step),
        **fields,
    )


RK4_TABLEAU = Tableau(
    order=4,
    c=(0.0, 0.5, 0.5, 1.0),
    a=((0.5,), (0.0, 0.5), (0.0, 0.0, 1.0)),
    b=(1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0),
)
RK4 = explicit_method(
    "rk4",
    RK4_TABLEAU,
    # stable up to 4√2 on quaternions and 2√2 on matrices, but inaccurate well below these
    of_quaternions=1.7,
    of_matrices=1.5,
    first_turn=True,
    damping_limit=1.7,
    summary="the classical method; its error in the norm is removed by renormalisation",
    source="Kutta, Z. Math. Phys. 46 (1901) 435; norm: Boyle, Adv. Appl. Clifford Alg. 27 (2017)",
)


# methods with 11 stages (Cooper and Verner, 1972) lose more accuracy than the stage saves
RK8_TABLEAU = Tableau(
    order=8,
    c=(
        0.0, 0.05260015195876773, 0.0789002279381516, 0.1183503419072274, 0.2816496580927726,
        0.3333333333333333, 0.25, 0.3076923076923077, 0.6512820512820513, 0.6,
        0.8571428571428571, 1.0,
    ),
    a=(
        (0.05260015195876773,),
        (0.0197250569845379, 0.0591751709536137),
        (0.02958758547680685, 0.0, 0.08876275643042054),
        (0.2413651341592667, 0.0, -0.8845494793282861, 0.924834003261792),
        (0.037037037037037035, 0.0, 0.0, 0.17082860872947386, 0.12546768756682242),
        (0.037109375, 0.0, 0.0, 0.17025221101954405, 0.06021653898045596, -0.017578125),
        (0.03709200011850479, 0.0, 0.0, 0.17038392571223998, 0.10726203044637328,
         -0.015319437748624402, 0.008273789163814023),
        (0.6241109587160757, 0.0, 0.0, -3.3608926294469414, -0.868219346841726, 27.59209969944671,
         20.154067550477894, -43.48988418106996),
        (0.47766253643826434, 0.0, 0.0, -2.4881146199716677, -0.590290826836843,
         21.230051448181193, 15.279233632882423, -33.28821096898486, -0.020331201708508627),
        (-0.9371424300859873, 0.0, 0.0, 5.186372428844064, 1.0914373489967295, -8.149787010746927,
         -18.52006565999696, 22.739487099350505, 2.4936055526796523, -3.0467644718982196),
        (2.273310147516538, 0.0, 0.0, -10.53449546673725, -2.0008720582248625, -17.9589318631188,
         27.94888452941996, -2.8589982771350235, -8.87285693353063, 12.360567175794303,
         0.6433927460157636),
    ),
    b=(
        0.054293734116568765, 0.0, 0.0, 0.0, 0.0, 4.450312892752409, 1.8915178993145003,
        -5.801203960010585, 0.3111643669578199, -0.1521609496625161, 0.20136540080403034,
        0.04471061572777259,
    ),
)  # fmt: skip
RK8 = explicit_method(
    "rk8",
    RK8_TABLEAU,
    # stable up to 5.97
    of_quaternions=3.9,
    of_matrices=3.9,
    scenes=BODIES,
    damping_limit=5.1,
    tried_on=("torqued",),
    summary="explicit, 12 stages; for any torque and tight tolerances",
    source="Dormand and Prince; Hairer, Nørsett, Wanner, Solving ODEs I (1993), §II.5, DOP853",
)


# more stages than rk8, but fewer steps at tight tolerances
RK9_TABLEAU = Tableau(
    order=9,
    c=(
        0.0, 0.04, 0.09648736013787361, 0.1447310402068104, 0.576, 0.2272326564618766,
        0.5407673435381234, 0.64, 0.48, 0.06754, 0.25, 0.6770920153543243, 0.8115, 0.906, 1.0,
    ),
    a=(
        (0.04,),
        (-0.01988527319182291, 0.11637263332969652),
        (0.0361827600517026, 0.0, 0.10854828015510781),
        (2.2721142642901775, 0.0, -8.526886447976398, 6.830772183686221),
        (0.050943855353893744, 0.0, 0.0, 0.1755865049809071, 0.0007022961270757468),
        (0.1424783668683285, 0.0, 0.0, -0.35417994346686843, 0.07595315450295101,
         0.6765157656337123),
        (0.07111111111111111, 0.0, 0.0, 0.0, 0.0, 0.32799092876058983, 0.24089796012829906),
        (0.07125, 0.0, 0.0, 0.0, 0.0, 0.32688424515752457, 0.11561575484247544, -0.03375),
        (0.048226773224658105, 0.0, 0.0, 0.0, 0.0, 0.039485599804954, 0.10588511619346581,
         -0.021520063204743093, -0.10453742601833482),
        (-0.026091134357549235, 0.0, 0.0, 0.0, 0.0, 0.03333333333333333, -0.1652504006638105,
         0.03434664118368617, 0.1595758283215209, 0.21408573218281934),
        (-0.03628423396255659, 0.0, 0.0, 0.0, 0.0, -1.0961675974272087, 0.1826035504321331,
         0.07082254444170684, -0.02313647018482431, 0.27112047263209327, 1.3081337494229808),
        (-0.5074635056416975, 0.0, 0.0, 0.0, 0.0, -6.631342198657237, -0.2527480100908801,
         -0.49526123800360955, 0.2932525545253887, 1.440108693768281, 6.237934498647056,
         0.7270192054526987),
        (0.6130118256955932, 0.0, 0.0, 0.0, 0.0, 9.088803891640463, -0.40737881562934486,
         1.7907333894903747, 0.714927166761755, -1.438580857841723, -8.26332931206474,
         -1.5375705708088652, 0.34538328275648716),
        (-1.2116979103438739, 0.0, 0.0, 0.0, 0.0, -19.055818715595954, 1.2630606753898752,
         -6.913916969178458, -0.676462266509498, 3.367860445026608, 18.00675164312591,
         6.83882892679428, -1.0315164519219504, 0.41291062321306227),
    ),
    b=(
        0.014588852784055396, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0020241978878893325,
        0.21780470845697167, 0.12748953408543898, 0.2244617745463132, 0.1787254491259903,
        0.07594344758096558, 0.12948458791975614, 0.029477447612619417,
    ),
)  # fmt: skip
RK9 = explicit_method(
    "rk9",
    RK9_TABLEAU,
    of_quaternions=3.9,
    of_matrices=3.9,
    scenes=BODIES,
    damping_limit=3.8,
    tried_on=("torqued",),
    summary="explicit, 15 stages; for slow torque functions and errors below 1e-6",
    source="Verner, Numer. Algorithms 53 (2010) 383: order 9 of the more robust pair 9(8)",
)
