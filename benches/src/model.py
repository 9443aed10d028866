"""The four gyros with every effect at the 0.1 s step, vectorised over time with numpy: samples/s on one core.

The pivots and the thermal lag depend on their own past and take a loop over time, in Python, as they would there. Left
out, in its favour: the clock's error and the time offset, temperatures, flags, and the states of commands.
"""
import os
import sys
import time

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[name] = "1"
import numpy as np  # noqa: E402

samples = int(sys.argv[1])
block = 50_000
arcsec = 648_000 / np.pi
rng = np.random.default_rng(1)
axes = [(0, 1, 2, 1), (1, 0, 2, -1), (2, 1, 0, -1), (2, 0, 1, 1)]
pivot, turn, carried, rounded, drift = np.zeros(4), 0.0, np.zeros(4), np.zeros(4), np.zeros(4)
start, done, psi0 = time.perf_counter(), 0, 0.0
while done < samples:
    count = min(block, samples - done)
    h = 0.1
    t = (done * 0.5) + h * np.arange(1, 5 * count + 1)
    theta = np.pi / 2 + 0.3 * np.sin(t / 900.0)
    dtheta = np.diff(theta, prepend=theta[0])
    psi = psi0 + np.cumsum(np.full(t.size, 210.0 / arcsec * h))
    psi0 = psi[-1]
    sun = 2 * np.pi / (365.25 * 86400) * h
    cycle = 4.0 / arcsec * h * np.sin(2 * np.pi * t / 5)
    angle = np.stack([
        210 / arcsec * h * np.cos(theta) + sun * np.cos(psi) * np.sin(theta) + cycle,
        dtheta - sun * np.sin(psi) + cycle,
        210 / arcsec * h * np.sin(theta) - sun * np.cos(psi) * np.cos(theta),
    ]) * arcsec
    settled, lag = 0.9 * (np.degrees(theta) - 90), h / 300
    turns = np.empty(t.size)
    for i, target in enumerate(settled.tolist()):
        turn += (target - turn) * lag
        turns[i] = turn
    excess = np.sin(2 * np.pi * t / 6180)
    counts = np.empty((4, t.size))
    for g, (i, o, s, sign) in enumerate(axes):
        rate = angle[i] + (angle[o] * 45 + angle[s] * -30) / arcsec
        rate = rate + turns * angle[2 if g == 0 else 0] / arcsec
        out = angle[o] / h
        sensed = rate + 0.005 * np.diff(out, prepend=out[0]) + 0.01 * rate * sign * angle[s] / arcsec / h
        moved, p, stop, floats = 0.01 * angle[o], pivot[g], 6.0, np.empty(t.size)
        fast = np.abs(out) >= 1.5
        for k, (step, moves) in enumerate(zip(moved.tolist(), fast.tolist())):
            p = p + step if moves else p - max(min(p, 0.0015), -0.0015)
            p = stop if p > stop else -stop if p < -stop else p
            floats[k] = p
        sensed = sensed + np.diff(floats, prepend=pivot[g])
        pivot[g] = p
        sensed = sensed - 800e-6 * 720 * (rate / h / 720) ** 3 * h + 0.01 * np.sqrt(h) * rng.standard_normal(t.size)
        walk = drift[g] + np.cumsum(8e-6 * np.sqrt(h) * rng.standard_normal(t.size))
        drift[g] = walk[-1]
        d = (0.21 * 2 + 16 / 3600 + walk) * h
        sf = 1.0012 * (1 + 12.5e-6 * excess) * np.where(rate > 0, 1 + 1e-4, 1.0)
        counts[g] = (sensed - d) / sf
    total = carried[:, None] + np.cumsum(counts.reshape(4, count, 5).sum(axis=2), axis=1)
    whole = np.sign(total) * np.floor(np.abs(total) + 0.5)
    increments = np.clip(np.diff(whole, axis=1, prepend=rounded[:, None]), -32768, 32767).astype(np.int16)
    carried, rounded = total[:, -1], whole[:, -1]
    done += count
print(samples / (time.perf_counter() - start))
