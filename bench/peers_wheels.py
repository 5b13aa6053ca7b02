"""A spacecraft with reaction wheels under sampled control in Basilisk: ``wheel_feedback``'s."""

from __future__ import annotations

from typing import Any

import numpy as np
import wheel_feedback as problem


class BasiliskWheels:
    """The modules of ``scenarioAttitudeFeedbackRW``, without orbit: one body from given starts.

    Wheels read their commands before the spacecraft is integrated, as in the scenario; ``is_late``
    exchanges the two, so that a command acts a sample later.
    """

    def __init__(self, samples: int, *, is_late: bool = False) -> None:
        from Basilisk.architecture import bskLogging, messaging
        from Basilisk.fswAlgorithms import attTrackingError, inertial3D, mrpFeedback, rwMotorTorque
        from Basilisk.simulation import reactionWheelStateEffector, simpleNav, spacecraft
        from Basilisk.utilities import SimulationBaseClass, simIncludeRW

        bskLogging.setDefaultLogLevel(bskLogging.BSK_ERROR)
        self.period = round(problem.PERIOD * 1e9)  # ns, as all its times
        self.samples = samples
        self.simulation = simulation = SimulationBaseClass.SimBaseClass()
        task = simulation.CreateNewTask("task", self.period)
        simulation.CreateNewProcess("process").addTask(task)
        self.craft = craft = spacecraft.Spacecraft()
        craft.hub.mHub, craft.hub.IHubPntBc_B = 750.0, np.diag(problem.HUB).tolist()
        factory = simIncludeRW.rwFactory()
        self.wheels = [
            factory.create(
                "Honeywell_HR16", axis, maxMomentum=50.0, RWModel=messaging.BalancedWheels
            )
            for axis in np.eye(3).tolist()
        ]
        self.effector = effector = reactionWheelStateEffector.ReactionWheelStateEffector()
        factory.addToSpacecraft("wheels", effector, craft)
        simulation.AddModelToTask("task", craft, 1)
        simulation.AddModelToTask("task", effector, 0 if is_late else 2)

        sensor, target = simpleNav.SimpleNav(), inertial3D.inertial3D()
        error, control = attTrackingError.attTrackingError(), mrpFeedback.mrpFeedback()
        motors = rwMotorTorque.rwMotorTorque()
        control.K, control.P, control.Ki = problem.STIFFNESS, problem.DAMPING, -1.0
        motors.controlAxes_B = np.eye(3).ravel().tolist()
        moments = messaging.VehicleConfigMsgPayload(ISCPntB_B=np.diag(problem.HUB).ravel().tolist())
        known = messaging.VehicleConfigMsg().write(moments), factory.getConfigMessage()
        sensor.scStateInMsg.subscribeTo(craft.scStateOutMsg)
        error.attNavInMsg.subscribeTo(sensor.attOutMsg)
        error.attRefInMsg.subscribeTo(target.attRefOutMsg)
        control.guidInMsg.subscribeTo(error.attGuidOutMsg)
        control.vehConfigInMsg.subscribeTo(known[0])
        control.rwParamsInMsg.subscribeTo(known[1])
        control.rwSpeedsInMsg.subscribeTo(effector.rwSpeedOutMsg)
        motors.rwParamsInMsg.subscribeTo(known[1])
        motors.vehControlInMsg.subscribeTo(control.cmdTorqueOutMsg)
        effector.rwMotorCmdInMsg.subscribeTo(motors.rwMotorTorqueOutMsg)
        modules = sensor, target, error, control, motors
        for module in modules:
            simulation.AddModelToTask("task", module, -1)
        self.owned = modules, known, factory  # which the simulation only points to

    def run(self, sigma: Any, w: Any, speeds: Any) -> Any:
        """σ at the end."""
        hub = self.craft.hub
        hub.sigma_BNInit, hub.omega_BN_BInit = ([[float(x)] for x in v] for v in (sigma, w))
        for wheel, speed in zip(self.wheels, speeds, strict=True):
            wheel.Omega = float(speed)
        self.simulation.InitializeSimulation()
        self.simulation.ConfigureStopTime(self.samples * self.period)
        self.simulation.ExecuteSimulation()
        return self.craft.dynManager.getStateObject("hubSigma").getState()

    def histories(self) -> tuple[np.ndarray, np.ndarray]:
        """σ and speeds at every sample, of the scenario's start."""
        records = self.craft.scStateOutMsg.recorder(), self.effector.rwSpeedOutMsg.recorder()
        for record in records:
            self.simulation.AddModelToTask("task", record, -2)
        self.run(*problem.SCENARIO)
        return np.array(records[0].sigma_BN), np.array(records[1].wheelSpeeds)[:, :3]
