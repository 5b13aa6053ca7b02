"""Rigid bodies in other programs: RK4 in C, heyoka's Taylor series, MuJoCo, Basilisk, Exudyn.

A peer is imported, or its compiler looked for, where it is used.
"""

from __future__ import annotations

import ctypes
import math
import shutil
import subprocess
import tempfile
import time
from functools import cache
from pathlib import Path
from typing import Any

import equations
import numpy as np

import fastatt as fa

# C

C_SOURCE = r"""
enum { TILE = 64, STATE = 7, COEFFICIENTS = 6 };

/* attitude, momentum; half the inverse moments and the factors of Euler's equations */
typedef struct { double a, b, c, d, x, y, z; } body;
typedef struct { double x, y, z, yz, zx, xy; } coefficients;

#define INLINE static inline __attribute__((always_inline))

INLINE body slope(body s, coefficients k)
{
    const double x = k.x * s.x, y = k.y * s.y, z = k.z * s.z;
    body r;
    r.a = -s.b * x - s.c * y - s.d * z;
    r.b = s.a * x + s.c * z - s.d * y;
    r.c = s.a * y - s.b * z + s.d * x;
    r.d = s.a * z + s.b * y - s.c * x;
    r.x = k.yz * s.y * s.z;
    r.y = k.zx * s.z * s.x;
    r.z = k.xy * s.x * s.y;
    return r;
}

INLINE body add(body s, double h, body r)
{
    s.a += h * r.a; s.b += h * r.b; s.c += h * r.c; s.d += h * r.d;
    s.x += h * r.x; s.y += h * r.y; s.z += h * r.z;
    return s;
}

INLINE void tile(double s[STATE][TILE], double k[COEFFICIENTS][TILE], int shared, double h,
                 long steps)
{
    for (long n = 0; n < steps; n++)
        for (int i = 0; i < TILE; i++) {
            const int j = shared ? 0 : i;
            const coefficients c = {k[0][j], k[1][j], k[2][j], k[3][j], k[4][j], k[5][j]};
            const body s0 = {s[0][i], s[1][i], s[2][i], s[3][i], s[4][i], s[5][i], s[6][i]};
            const body k1 = slope(s0, c);
            const body k2 = slope(add(s0, 0.5 * h, k1), c);
            const body k3 = slope(add(s0, 0.5 * h, k2), c);
            const body k4 = slope(add(s0, h, k3), c);
            body r = add(add(s0, h / 6.0, k1), h / 3.0, k2);
            r = add(add(r, h / 3.0, k3), h / 6.0, k4);
            s[0][i] = r.a; s[1][i] = r.b; s[2][i] = r.c; s[3][i] = r.d;
            s[4][i] = r.x; s[5][i] = r.y; s[6][i] = r.z;
        }
}

INLINE void run(double *y, const double *factors, long bodies, int shared, double h,
                long steps)
{
    double s[STATE][TILE] __attribute__((aligned(64)));
    double k[COEFFICIENTS][TILE] __attribute__((aligned(64)));
    for (long first = 0; first < bodies; first += TILE) {
        for (int e = 0; e < STATE; e++)
            for (int i = 0; i < TILE; i++) s[e][i] = y[e * bodies + first + i];
        for (int e = 0; e < COEFFICIENTS; e++)
            for (int i = 0; i < TILE; i++)
                k[e][i] = shared ? factors[e] : factors[e * bodies + first + i];
        tile(s, k, shared, h, steps);
        for (int e = 0; e < STATE; e++)
            for (int i = 0; i < TILE; i++) y[e * bodies + first + i] = s[e][i];
    }
}

/* y[7][bodies], a multiple of 64 bodies; factors[6] for all or factors[6][bodies] */
void rk4(double *y, const double *factors, long bodies, int shared, double h, long steps)
{
    if (shared) run(y, factors, bodies, 1, h, steps);
    else run(y, factors, bodies, 0, h, steps);
}
"""
C_FLAGS = ("-O3", "-march=native", "-ffast-math", "-shared", "-fPIC")


def has_c() -> bool:
    return shutil.which("gcc") is not None


@cache
def compile_c() -> ctypes._CFuncPtr:
    """The C function ``rk4``; a compiler that does not know the vector width goes without."""
    with tempfile.TemporaryDirectory() as folder:
        source, library = Path(folder, "rk4.c"), Path(folder, "rk4.so")
        source.write_text(C_SOURCE, encoding="ascii")
        done = None
        for flags in dict.fromkeys(((*C_FLAGS, "-mprefer-vector-width=512"), C_FLAGS)):
            command = ["gcc", *flags, str(source), "-o", str(library)]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.returncode == 0:
                break
        else:
            raise RuntimeError(f"gcc failed: {done.stderr}")
        function = ctypes.CDLL(str(library)).rk4
    array = np.ctypeslib.ndpointer(np.float64, flags="C_CONTIGUOUS")
    function.argtypes = [array, array, ctypes.c_long, ctypes.c_int, ctypes.c_double, ctypes.c_long]
    function.restype = None
    return function


def c_rk4(
    inertia: np.ndarray, q0: np.ndarray, m0: np.ndarray, t_end: float, n_steps: int
) -> tuple[np.ndarray, float]:
    """RK4 on attitudes (N, 4) and momenta (N, 3), moments (3,) or (N, 3); N a multiple of 64.

    Attitudes at the end and the seconds that the propagation takes in C, where tiles of 64 bodies
    stay in a local array for the whole run.
    """
    inverse, y = 1.0 / inertia.T, np.ascontiguousarray(np.concatenate([q0, m0], axis=1).T)
    # of the momenta in the rates, and of m2 m3, m3 m1 and m1 m2 in Euler's equations
    factors = [0.5 * inverse, np.roll(inverse, -2, 0) - np.roll(inverse, -1, 0)]
    factors, function = np.ascontiguousarray(np.concatenate(factors)), compile_c()
    begin = time.process_time()
    function(y, factors, len(q0), inertia.ndim == 1, t_end / n_steps, n_steps)
    return y[:4].T, time.process_time() - begin


# heyoka


class TaylorBatch:
    """heyoka's batch integrator of many bodies' equations: compiled once, used batch after batch.

    ``group`` bodies are one system of equations with one step size, which spreads the cost of
    choosing the step. Unrolled code (no compact mode) and a batch of one vector are fastest. The
    library's ensemble functions copy the integrator for every batch, which takes longer than the
    propagation.
    """

    def __init__(self, kind: str, parameters: np.ndarray, tol: float, group: int) -> None:
        """``parameters`` are (P,), shared and compiled in, or (N, P)."""
        import heyoka as hy

        slope = equations.slope(kind, hy.sin, hy.cos)
        self.kind = kind
        self.size = equations.N_STATE[kind]
        self.batch, self.group = hy.recommended_simd_size(), group
        self.parameters = parameters if parameters.ndim == 2 else None
        n = parameters.shape[-1]
        system = []
        for k in range(group):
            own = parameters if parameters.ndim == 1 else [hy.par[k * n + i] for i in range(n)]
            y = hy.make_vars(*(f"y{i}_{k}" for i in range(self.size)))
            system += zip(y, slope(hy.time, y, own), strict=True)
        state = np.tile(np.eye(self.size, 1), (group, self.batch))
        self.integrator = hy.taylor_adaptive_batch(system, state, tol=tol)

    def lanes(self, columns: np.ndarray) -> np.ndarray:
        """Columns (N, k) of the bodies as (batches, group k, batch), the last body repeated."""
        n, k = columns.shape
        size = self.group * self.batch
        bodies = np.minimum(np.arange(-(-n // size) * size), n - 1)
        lanes = columns[bodies].reshape(-1, self.group, self.batch, k)
        return np.swapaxes(lanes, 2, 3).reshape(len(lanes), self.group * k, self.batch)

    def bodies(self, lanes: np.ndarray, n: int) -> np.ndarray:
        """The first n bodies' states (n, k) from what ``run`` gives."""
        y = lanes.reshape(len(lanes), self.group, self.size, self.batch)
        return np.swapaxes(y, 2, 3).reshape(-1, self.size)[:n]

    def run(self, starts: np.ndarray, parameters: np.ndarray | None, t_end: float) -> np.ndarray:
        """The states at the end in lanes, a batch at a time, from t = 0."""
        ends = np.empty_like(starts)
        integrator = self.integrator
        state, own = integrator.state, integrator.pars
        for k in range(len(starts)):
            state[:] = starts[k]
            if parameters is not None:
                own[:] = parameters[k]
            integrator.set_time(0.0)
            integrator.propagate_until(t_end)
            ends[k] = state
        return ends

    def work(self) -> float:
        """Operations of a body of the last batch: its lanes take as many steps as the slowest."""
        steps = max(outcome[3] for outcome in self.integrator.propagate_res)
        return taylor_work(self.integrator, steps, self.kind)


def taylor_work(integrator: Any, steps: int, kind: str) -> float:
    """Operations of a body: a product of two series to the order p takes p², and p its place."""
    p, products = integrator.order, equations.N_PRODUCTS[kind]
    return float(steps * p * (products * p + 2 * equations.N_STATE[kind]))


# programs with steps of their own: (principal moments, t_end, number of steps, mean motion)


class MuJoCoBody:
    """A body on a free joint: RK4 with n steps, by the rollout of states in C."""

    def __init__(self, inertia: Any, t_end: float, n: int, _: float) -> None:
        import mujoco
        from mujoco import rollout

        moments = " ".join(str(float(x)) for x in inertia)
        model = mujoco.MjModel.from_xml_string(
            f"""<mujoco><option timestep="{t_end / n!r}" gravity="0 0 0" integrator="RK4">
            <flag contact="disable" constraint="disable"/></option><worldbody><body><freejoint/>
            <inertial pos="0 0 0" mass="1" diaginertia="{moments}"/></body></worldbody></mujoco>"""
        )
        self.model, self.data, self.n = model, mujoco.MjData(model), n
        self.rollout = rollout.Rollout(nthread=0)

    def state(self, q: np.ndarray, w: np.ndarray) -> np.ndarray:
        """Time, position and attitude, velocity and rate, (N, 14)."""
        zero = np.zeros((len(q), 4))
        return np.concatenate([zero, q, zero[:, :3], w], axis=1)

    def run(self, start: np.ndarray) -> np.ndarray:
        return self.rollout.rollout(self.model, self.data, start, nstep=self.n)[0][:, -1, 4:8]

    def attitudes(self, ends: list[np.ndarray]) -> np.ndarray:
        return np.concatenate(ends)


class BasiliskBody:
    """A spacecraft of nothing but a hub: RK4 with n steps on Rodrigues parameters.

    In orbit its position is integrated too, in a point mass's gravity.
    """

    def __init__(self, inertia: Any, t_end: float, n: int, mean_motion: float) -> None:
        from Basilisk.architecture import bskLogging
        from Basilisk.simulation import GravityGradientEffector, spacecraft, svIntegrators
        from Basilisk.utilities import SimulationBaseClass, simIncludeGravBody

        bskLogging.setDefaultLogLevel(bskLogging.BSK_ERROR)
        self.span = round(t_end * 1e9)  # ns, as all its times
        self.simulation = simulation = SimulationBaseClass.SimBaseClass()
        simulation.CreateNewProcess("process").addTask(
            simulation.CreateNewTask("task", self.span // n)
        )
        self.craft = craft = spacecraft.Spacecraft()
        craft.hub.mHub, craft.hub.IHubPntBc_B = 1.0, np.diag(inertia).tolist()
        self.integrator = svIntegrators.svIntegratorRK4(craft)
        craft.setIntegrator(self.integrator)
        simulation.AddModelToTask("task", craft)
        self.orbit: list[list[list[float]]] = []
        if mean_motion:
            self.owned = gravity = simIncludeGravBody.gravBodyFactory()
            planet = gravity.createEarth()
            planet.isCentralBody = True
            gravity.addBodiesTo(craft)
            self.pull = pull = GravityGradientEffector.GravityGradientEffector()
            pull.addPlanetName(planet.planetName)
            craft.addDynamicEffector(pull)
            simulation.AddModelToTask("task", pull)
            r = (planet.mu / mean_motion**2) ** (1.0 / 3.0)
            self.orbit = [[[r], [0.0], [0.0]], [[0.0], [mean_motion * r], [0.0]]]
        simulation.InitializeSimulation()
        names = ("hubSigma", "hubOmega", "hubPosition", "hubVelocity")[: 2 + len(self.orbit)]
        self.objects = [craft.dynManager.getStateObject(name) for name in names]
        self.ended = 0

    def state(self, q: np.ndarray, w: np.ndarray) -> list[list[list[float]]]:
        """Rodrigues parameters and rates, the position and its rate in orbit, as columns."""
        return [x.T.tolist() for x in (fa.quat_to_mrp(q), w)] + self.orbit

    def run(self, start: list[list[list[float]]]) -> Any:
        for known, value in zip(self.objects, start, strict=True):
            known.setState(value)
        self.ended += self.span
        self.simulation.ConfigureStopTime(self.ended)
        self.simulation.ExecuteSimulation()
        return self.objects[0].getState()

    def attitudes(self, ends: list[Any]) -> np.ndarray:
        return fa.mrp_to_quat(np.reshape(ends, (-1, 3)))


class ExudynBody:
    """A rigid body with a rotation vector: RK67 with n steps, in orbit with a torque in Python."""

    def __init__(self, inertia: Any, t_end: float, n: int, mean_motion: float) -> None:
        import exudyn
        from exudyn import utilities

        self.container = exudyn.SystemContainer()
        self.system = system = self.container.AddSystem()
        body = system.CreateRigidBody(
            inertia=utilities.RigidBodyInertia(
                mass=1.0, com=[0.0] * 3, inertiaTensor=np.diag(inertia)
            ),
            nodeType=exudyn.NodeType.RotationRotationVector, returnDict=True,
        )  # fmt: skip
        node, (i1, i2, i3) = body["nodeNumber"], (float(x) for x in inertia)
        kind, strength = exudyn.OutputVariableType.RotationMatrix, 3.0 * mean_motion**2

        def torque(system, t, _):
            c = system.GetNodeOutput(node, kind).tolist()
            u, v = math.cos(mean_motion * t), math.sin(mean_motion * t)
            x, y, z = u * c[0] + v * c[3], u * c[1] + v * c[4], u * c[2] + v * c[5]
            x, y, z = (i3 - i2) * y * z, (i1 - i3) * z * x, (i2 - i1) * x * y
            return [strength * x, strength * y, strength * z]

        if mean_motion:
            marker = utilities.MarkerBodyRigid(bodyNumber=body["bodyNumber"])
            system.AddLoad(utilities.Torque(
                markerNumber=system.AddMarker(marker), bodyFixed=True, loadVectorUserFunction=torque
            ))  # fmt: skip
        system.Assemble()
        self.settings = settings = exudyn.SimulationSettings()
        settings.timeIntegration.endTime, settings.timeIntegration.numberOfSteps = t_end, n
        settings.timeIntegration.automaticStepSize = False
        settings.timeIntegration.verboseMode = 0
        settings.solution.file.write = False
        settings.solution.sensors.writePeriod = 2.0 * t_end
        self.solver, self.initial = exudyn.DynamicSolverType.RK67, exudyn.ConfigurationType.Initial
        self.matrix = lambda: system.GetNodeOutput(node, kind)

    def state(self, q: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Position and rotation vector, and their rates at no rotation."""
        zero = np.zeros(3)
        return np.append(zero, fa.quat_to_rotation_vector(q)), np.append(zero, w)

    def run(self, start: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        data = self.system.systemData
        data.SetODE2Coordinates(start[0], self.initial)
        data.SetODE2Coordinates_t(start[1], self.initial)
        self.system.SolveDynamic(self.settings, solverType=self.solver)
        return self.matrix()

    def attitudes(self, ends: list[np.ndarray]) -> np.ndarray:
        return fa.dcm_to_quat(np.reshape(ends, (-1, 3, 3)))
