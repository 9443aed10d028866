"""numpy and filterpy on one core, on data of the size that GEU has; seconds.

`numpy`: four gyros, each with scale factor, drift and two misalignments, by `lstsq` over every sample.
`filterpy`: a Kalman filter of three attitude errors and three drift rates over every sample with star fixes, and its smoother.
"""
import os
import sys
import time

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[name] = "1"
import numpy as np  # noqa: E402

tool, samples, fixes = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
rng = np.random.default_rng(1)
if tool == "numpy":
    angles = rng.standard_normal((samples, 3)) * 100
    design = np.column_stack([angles, np.full(samples, 0.5)])
    counts = design @ rng.standard_normal((4, 4)) + np.sqrt(1 / 12) * rng.standard_normal((samples, 4))
    start = time.perf_counter()
    np.linalg.lstsq(design, counts, rcond=None)
    print(time.perf_counter() - start)
else:
    from filterpy.kalman import KalmanFilter

    step_s, every = 0.5, samples // fixes
    kalman = KalmanFilter(dim_x=6, dim_z=2)
    kalman.F = np.eye(6)
    kalman.F[:3, 3:] = -step_s * np.eye(3)
    kalman.H = np.eye(2, 6)
    kalman.Q = np.diag([1e-4] * 3 + [1e-12] * 3)
    kalman.R = np.eye(2) * 4.0
    kalman.P *= 100.0
    fixed = {every * index: rng.standard_normal(2) for index in range(1, fixes + 1)}
    start = time.perf_counter()
    states, covariances = np.empty((samples, 6, 1)), np.empty((samples, 6, 6))
    for index in range(samples):
        kalman.predict()
        if index in fixed:
            kalman.update(fixed[index])
        states[index], covariances[index] = kalman.x, kalman.P
    kalman.rts_smoother(states, covariances)
    print(time.perf_counter() - start)
