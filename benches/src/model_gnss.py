"""gnss-ins-sim (Aceinna) at the 0.1 s step, one core: samples/s of a whole simulation, and of its gyros alone.

Its gyros are three, with a bias, a Gauss-Markov drift and an angle random walk; they give rates and no counts. A whole
simulation lays out the trajectory and adds accelerometers, which cannot be left out. Both loop over time in Python.
"""
import contextlib
import os
import sys
import time

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[name] = "1"
import numpy as np  # noqa: E402
from gnss_ins_sim.pathgen import pathgen  # noqa: E402
from gnss_ins_sim.sim import imu_model, ins_sim  # noqa: E402

samples = int(sys.argv[1])
rate_hz = 10.0
motion = """ini lat,ini lon,ini alt,ini vx,ini vy,ini vz,ini yaw,ini pitch,ini roll
0,0,0,0,0,0,0,0,0
command type,yaw,pitch,roll,vx,vy,vz,command duration,GPS visibility
1,{},0,0,0,0,0,{},0
""".format(210 / 3600, samples * 0.5)
imu = imu_model.IMU(accuracy="high-accuracy", axis=6, gps=False)
start = time.perf_counter()
with contextlib.redirect_stdout(sys.stderr):
    sim = ins_sim.Sim([rate_hz, 0.0, 0.0], motion, ref_frame=1, imu=imu)
    sim.run(1)
whole_s = time.perf_counter() - start
true_rates = np.asarray(sim.dmgr.ref_gyro.data)
assert true_rates.shape == np.asarray(sim.dmgr.gyro.data[0]).shape
start = time.perf_counter()
pathgen.gyro_gen(rate_hz, true_rates, imu.gyro_err)
gyros_s = time.perf_counter() - start
count = len(true_rates) / 5
print(count / whole_s, count / gyros_s)
