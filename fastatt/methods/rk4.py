"""RK4: the classical method on the numbers of the representation."""

from fastatt.methods.runge_kutta import Tableau, explicit_method

TABLEAU = Tableau(
    order=4,
    c=(0.0, 0.5, 0.5, 1.0),
    a=((0.5,), (0.0, 0.5), (0.0, 0.0, 1.0)),
    b=(1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0),
)
METHOD = explicit_method(
    "rk4",
    TABLEAU,
    # stable up to 4√2 on quaternions and 2√2 on matrices, but inaccurate well below these
    of_quaternions=1.7,
    of_matrices=1.5,
    first_turn=True,
    damping_limit=1.7,
    summary="the classical method; its error in the norm is removed by renormalisation",
    source="Kutta, Z. Math. Phys. 46 (1901) 435; norm: Boyle, Adv. Appl. Clifford Alg. 27 (2017)",
)
