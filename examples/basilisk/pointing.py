"""A spacecraft in Basilisk that keeps its attitude by the emulated gyros: pointing error with and without a drift fault.

    pip install bsk; pip install geu-*.whl
    python pointing.py --drift 300 --record run       # GYRX drifts by 300 arcsec/h from half of the time on
    geu diagnose --config unit.toml --link run/link.bin --reference run/reference.csv

The controller knows the initial attitude, adds up the increments of the gyros, and turns the spacecraft to a sequence of attitudes. It does not know the drift:
the spacecraft turns away with it, as Basilisk's own state shows.
"""

import argparse
import math
from pathlib import Path

import numpy
from Basilisk.architecture import messaging, sysModel
from Basilisk.simulation import extForceTorque, spacecraft
from Basilisk.utilities import RigidBodyKinematics as kinematics
from Basilisk.utilities import SimulationBaseClass, macros
from geu.basilisk import GyroUnit

UNIT = Path(__file__).with_name("unit.toml")
STEP_S = 0.1
SLEW_RAD_S = math.radians(0.2)
INERTIA_KG_M2 = numpy.diag([900.0, 800.0, 600.0])
# Natural frequency 0.3 rad/s, critically damped.
STIFFNESS, DAMPING = 0.3**2, 2 * 0.3


def turn(axis, angle_rad):
    """Euler parameters of a turn about a body axis."""
    parameters = numpy.zeros(4)
    parameters[0], parameters[1 + axis] = math.cos(angle_rad / 2), math.sin(angle_rad / 2)
    return parameters


def commanded(t_s):
    """Commanded attitude (Euler parameters) and rate (rad/s): each five minutes a slew of 20 degrees about another axis, there and back."""
    number, within_s = divmod(float(t_s), 300.0)
    axis = int(number) % 3
    slew_s = math.radians(20) / SLEW_RAD_S
    there, back = min(within_s, slew_s), min(max(within_s - 150.0, 0.0), slew_s)
    rate = numpy.zeros(3)
    rate[axis] = SLEW_RAD_S * ((0 < within_s < slew_s) - (150.0 < within_s < 150.0 + slew_s))
    return turn(axis, SLEW_RAD_S * (there - back)), rate


class Controller(sysModel.SysModel):
    """Adds up the measured increments and commands a torque."""

    def __init__(self):
        super().__init__()
        self.ModelTag = "controller"
        self.read_s = 0.0
        self.imuInMsg = messaging.IMUSensorMsgReader()
        self.torqueOutMsg = messaging.CmdTorqueBodyMsg()
        self.attitude, self.rate = turn(0, 0.0), numpy.zeros(3)

    def Reset(self, nanoseconds):
        self.torqueOutMsg.write(messaging.CmdTorqueBodyMsgPayload(), nanoseconds, self.moduleID)

    def UpdateState(self, nanoseconds):
        if self.imuInMsg.timeWritten() > self.read_s and self.imuInMsg.isWritten():
            self.read_s = self.imuInMsg.timeWritten()
            angle = numpy.array(self.imuInMsg().DRFramePlatform)
            size = numpy.linalg.norm(angle)
            step = numpy.array([math.cos(size / 2), *(math.sin(size / 2) * angle / (size or 1.0))])
            self.attitude = kinematics.addEP(self.attitude, step)
            self.rate = numpy.array(self.imuInMsg().AngVelPlatform)
        attitude, rate = commanded(nanoseconds * 1e-9)
        error = kinematics.subEP(self.attitude, attitude)
        error *= math.copysign(1.0, error[0])
        torque = -INERTIA_KG_M2 @ (STIFFNESS * 2 * error[1:] + DAMPING * (self.rate - rate))
        self.torqueOutMsg.write(messaging.CmdTorqueBodyMsgPayload(torqueRequestBody=torque.tolist()), nanoseconds, self.moduleID)


def simulate(duration_s, drift_arcsec_per_h=0.0, record=None, seed=1):
    """Pointing error (arcsec, true attitude against the commanded one) at the end of each minute."""
    faults = {}
    if drift_arcsec_per_h:
        faults = {"gyro.GYRX.drift-step": {"arcsec_per_h": drift_arcsec_per_h, "time_s": duration_s / 2}}
    simulation = SimulationBaseClass.SimBaseClass()
    simulation.CreateNewProcess("process").addTask(simulation.CreateNewTask("dynamics", macros.sec2nano(STEP_S)))
    body = spacecraft.Spacecraft()
    body.ModelTag = "spacecraft"
    body.hub.mHub, body.hub.IHubPntBc_B = 1000.0, INERTIA_KG_M2.tolist()
    actuator = extForceTorque.ExtForceTorque()
    body.addDynamicEffector(actuator)
    gyros = GyroUnit(UNIT, set=faults, seed=seed, record=record)
    try:
        gyros.scStateInMsg.subscribeTo(body.scStateOutMsg)
        controller = Controller()
        controller.imuInMsg.subscribeTo(gyros.imuOutMsg)
        actuator.cmdTorqueInMsg.subscribeTo(controller.torqueOutMsg)
        for model in (body, actuator, gyros, controller):
            simulation.AddModelToTask("dynamics", model)
        state = body.scStateOutMsg.recorder(macros.sec2nano(60.0))
        simulation.AddModelToTask("dynamics", state)
        simulation.InitializeSimulation()
        simulation.ConfigureStopTime(macros.sec2nano(duration_s))
        simulation.ExecuteSimulation()
    finally:
        gyros.stop()
    errors = []
    for nanoseconds, sigma in zip(state.times()[1:], state.sigma_BN[1:]):
        difference = kinematics.subEP(kinematics.MRP2EP(sigma), commanded(nanoseconds * 1e-9)[0])
        errors.append(2 * math.degrees(math.asin(min(1.0, numpy.linalg.norm(difference[1:])))) * 3600)
    return errors


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--duration", type=float, default=1800.0, metavar="SECONDS")
    parser.add_argument("--drift", type=float, default=0.0, metavar="ARCSEC_PER_H")
    parser.add_argument("--record", metavar="DIRECTORY")
    arguments = parser.parse_args()
    errors = simulate(arguments.duration, arguments.drift, arguments.record)
    for minute, error in enumerate(errors, 1):
        print(f"{60 * minute:6d} s  pointing error {error:9.3f} arcsec")


if __name__ == "__main__":
    main()
