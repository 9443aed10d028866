"""Basilisk's imuSensor at the 0.1 s step, one core: samples/s of its three gyros with bias, Gauss-Markov noise and rounding.

Its state of the spacecraft is constant, so that no dynamics is counted; the messages of its steps are.
"""
import sys
import time

from Basilisk.architecture import messaging
from Basilisk.simulation import imuSensor
from Basilisk.utilities import SimulationBaseClass, macros

samples, step_s, steps = int(sys.argv[1]), 0.1, 5
simulation = SimulationBaseClass.SimBaseClass()
task = simulation.CreateNewTask("gyros", macros.sec2nano(step_s))
simulation.CreateNewProcess("unit").addTask(task)
imu = imuSensor.ImuSensor()
imu.setBodyToPlatformDCM(0.0, 0.0, 0.0)
imu.senRotBias = [1e-6, -2e-6, 3e-6]
imu.PMatrixGyro = [[1e-8, 0.0, 0.0], [0.0, 1e-8, 0.0], [0.0, 0.0, 1e-8]]
imu.setWalkBoundsGyro([1e-5, 1e-5, 1e-5])
imu.setLSBs(1e-6, 4.848e-6)
state = messaging.SCStatesMsgPayload()
state.omega_BN_B = [1e-3, 2e-4, -3e-4]
message = messaging.SCStatesMsg().write(state)
imu.scStateInMsg.subscribeTo(message)
simulation.AddModelToTask("gyros", imu)
simulation.InitializeSimulation()
simulation.ConfigureStopTime(macros.sec2nano(samples * steps * step_s))
start = time.perf_counter()
simulation.ExecuteSimulation()
print(samples / (time.perf_counter() - start))
