"""The same pushes once more, by small equal steps and plain `if`s: a check of `effects`.

    REFERENCE_JIT=1 python -m tests.reference.effect_naive [cases of each group]

prints how far F_p and d of the stored cases lie from it. It knows no events: whatever is to happen
happens at the next step, so it is right to about 1e-5, which shows an equation that is wrong, and
no more than that.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np

from .effect_parameters import NAMES
from .jit import jit

STEP = 1e-7
LONGEST = 3.0  # seconds; slower pushes are left out


@jit
def rates(c, touching, sliding, going, t, y):
    """Of [part, its speed, tip's travel, its drive, lowpass, highpass, bristles]; and the force."""
    (m, mu_s, ratio, k_v, k, b, velocity, _) = c[:8]
    (v_s, delta, s0, s1, drag, wave, length, angle, patch, start, drift, place) = c[8:20]
    (_, _, _, alpha, extra, n, b_r, gap, steep, lag, ripple, period, phase, times) = c[20:34]
    lowpass, highpass = c[37], c[38]
    x, u, far, drive, slow, mean, q = y
    v = times * velocity
    wanted = (min(steep * t, v) if steep < math.inf else v) if going else 0.0
    if lag == 0:
        drive = wanted
    tip = drive * (1 + ripple * math.sin(2 * math.pi * far / period + phase))
    z, w = far - gap - x, tip - u
    force = 0.0
    if touching:
        force = k * 1e-4 * (max(z, 0.0) / 1e-4) ** n + w * (b if w >= 0 else b_r)
        force = max(force, 0.0)
    level = m * 9.80665 * math.cos(alpha) + extra
    level *= 1 + wave * math.sin(2 * math.pi * x / length + angle)
    level *= 1 + patch * (1.0 if x > start else 0.0)
    static = mu_s * (1 + drift * place)
    along, q_rate = m * 9.80665 * math.sin(alpha), 0.0
    if s0 > 0:
        q_rate = u - s0 * abs(u) * q / (ratio * static * level)
        resist = s0 * q + s1 * q_rate + k_v * u + drag * u * abs(u) + along
    else:
        mu = ratio * static
        if v_s > 0:
            mu += (1 - ratio) * static * math.exp(-((abs(u) / v_s) ** delta))
        resist = mu * level + k_v * u + drag * u * u + along
    filtered = slow if lowpass > 0 else force
    out = (
        u if sliding else 0.0,
        (force - resist) / m if sliding else 0.0,
        tip,
        (wanted - drive) / lag if lag > 0 else 0.0,
        (force - slow) / lowpass if lowpass > 0 else 0.0,
        (filtered - mean) / highpass,
        q_rate,
    )
    return out, force, filtered - mean, static * level, along


@jit
def added(y, h, k):
    return (
        y[0] + h * k[0],
        y[1] + h * k[1],
        y[2] + h * k[2],
        y[3] + h * k[3],
        y[4] + h * k[4],
        y[5] + h * k[5],
        y[6] + h * k[6],
    )


@jit
def push(c, step, path):
    """F_p, d, contacts; d is nan where there is none. `path` is room for x at every step."""
    stroke, s0, lag, gap, duration, latch = c[7], c[10], c[29], c[27], c[34], c[43]
    dwell = 1 + c[20] * math.log(1 + c[22] / c[21])
    y = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    if s0 > 0:
        y = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -c[0] * 9.80665 * math.sin(c[23]) / s0)
    touching, sliding, going = gap == 0, s0 > 0, True
    contacts, first = int(touching), s0 == 0
    peak, before, lost, latched, sample, t = -1e300, 0.0, 0, -1, 0, 0.0
    for i in range(path.size):
        t = i * step
        path[i] = y[0]
        # The tip's command, contact and friction, as they are from now on
        drive = y[3] if lag > 0 else rates(c, touching, sliding, going, t, y)[0][2]
        far = y[2] + (lag * drive if lag > 0 else 0.0)
        if going and (far >= stroke or t >= duration):
            going = False
        k1, force, shown, holds, along = rates(c, touching, sliding, going, t, y)
        z, w = y[2] - gap - y[0], k1[2] - y[1]
        if touching and force <= 0 and w < 0:
            touching = False
            going = going and (stroke < math.inf or duration < math.inf)
            if c[42] == 0:
                lost = i
        elif not touching:
            pressed = c[4] * 1e-4 * (max(z, 0.0) / 1e-4) ** c[25] + c[26] * min(w, 0.0)
            if (z >= 0 and w >= 0) or (z > 0 and c[26] > 0 and pressed > 0):
                touching = True
                contacts += 1
        k1, force, shown, holds, along = rates(c, touching, sliding, going, t, y)
        if not sliding and touching and force >= holds * (dwell if first else 1.0) + along:
            sliding, first = True, False
            k1, force, shown, holds, along = rates(c, touching, sliding, going, t, y)
        if before > c[42] >= force and c[42] > 0:
            lost = i
        if before >= latch > force and latched < 0:
            latched = i
        before = force
        if c[40] == math.inf or t + 0.5 * step >= sample / c[40]:
            peak, sample = max(peak, shown), sample + 1
        # Rest for good
        still = not going and drive < 1e-9 * c[6]
        if still and s0 == 0 and not sliding:
            break
        calm = abs(y[1]) < 1e-8 and abs(k1[1]) < 1e-5
        if still and s0 > 0 and calm:
            break
        k2 = rates(c, touching, sliding, going, t + step / 2, added(y, step / 2, k1))[0]
        k3 = rates(c, touching, sliding, going, t + step / 2, added(y, step / 2, k2))[0]
        k4 = rates(c, touching, sliding, going, t + step, added(y, step, k3))[0]
        y = added(
            added(added(added(y, step / 6, k1), step / 3, k2), step / 3, k3),
            step / 6,
            k4,
        )
        if s0 == 0 and sliding and y[1] <= 0:
            sliding = False
            y = (y[0], 0.0, y[2], y[3], y[4], y[5], y[6])
    else:
        return math.nan, math.nan, -1
    peak = min(max(c[35] * peak + c[36], -c[39]), c[39])
    lost = latched if latched >= 0 else lost
    distance = math.nan
    if not touching or latched >= 0:
        late = lost - c[44] / step
        low = math.floor(late)
        share = late - low
        where = path[low] + share * (path[low + 1] - path[low]) if low >= 0 else 0.0
        distance = c[41] * (y[0] - where)
    return peak, distance, contacts


def main() -> None:
    number = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    file = sys.argv[2] if len(sys.argv) > 2 else Path(__file__).with_name("effect_cases.npz")
    stored = np.load(file)
    assert tuple(stored["names"]) == NAMES
    path = np.zeros(round(LONGEST / STEP))
    for index, group in enumerate(stored["groups"]):
        worst, left_out = [], 0
        for i in np.flatnonzero(stored["group"] == index)[:number]:
            force, distance, contacts = push(stored["parameters"][i], STEP, path)
            if contacts < 0:
                left_out += 1
                continue
            d = stored["sliding_distance"][i]
            assert math.isnan(d) == math.isnan(distance), (group, i)
            off = 0.0 if math.isnan(d) else abs(distance - d)
            allowed = 5e-9 + 1e-5 * abs(0 if math.isnan(d) else d)
            worst.append((abs(force / stored["peak_force"][i] - 1), off / allowed, i))
            if contacts != stored["contacts"][i]:
                print("contacts differ:", group, i, contacts, stored["contacts"][i])
        w = np.array(worst).reshape(-1, 3)
        print(f"{group}: F_p {w[:, 0].max():.1e} (case {w[w[:, 0].argmax(), 2]:.0f}),", end=" ")
        print(f"d {w[:, 1].max():.2g} of 5 nm + 1e-5 (case {w[w[:, 1].argmax(), 2]:.0f}),", end=" ")
        print(f"{left_out} left out", flush=True)


if __name__ == "__main__":
    main()
