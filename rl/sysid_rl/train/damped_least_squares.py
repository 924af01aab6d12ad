"""Bounded damped least squares on an open chain, compiled: target → joints, searched from given joints.

Each step minimises ``‖J·W·z + e‖² + λ‖z‖²`` (Levenberg–Marquardt), ``dq = W·z``: the smallest weighted joint motion that
brings the tip to the target. A joint that would leave its bound is held, and the step is solved again without it.

Source: Nakamura & Hanafusa, J. Dyn. Sys. 108 (1986); Nocedal & Wright, Numerical Optimization, §10.3.
"""

from __future__ import annotations

import math

import numpy as np

from sysid.effects.compiled import inlined, kernel

# Columns of a chain's rows.
COLUMN, STRETCH, OFFSET, PRISMATIC, SHIFT, ROTATION, AXIS = 0, 1, 2, 3, 4, 7, 16
WIDTH = 19

#: Initial damping, relative to the squared norm of the weighted Jacobian.
DAMPING = 1e-6
#: A step shorter than this share of the weights ends the search.
SHORT = 1e-12


@inlined
def forward_kinematics(rows, last, q, frame, origins, axes, tip):
    """Origins and axes of all joints in the base frame, (J, 3) each, and the tip (3,); ``frame`` (7, 3) is scratch."""
    r, t, p = frame[:3], frame[3:6], frame[6]
    for c in range(3):
        p[c] = 0.0
        for d in range(3):
            r[c, d] = 1.0 if c == d else 0.0
    for j in range(len(rows)):
        row = rows[j]
        for c in range(3):
            p[c] += r[c, 0] * row[SHIFT] + r[c, 1] * row[SHIFT + 1] + r[c, 2] * row[SHIFT + 2]
        for c in range(3):
            for d in range(3):
                t[c, d] = r[c, 0] * row[ROTATION + d] + r[c, 1] * row[ROTATION + 3 + d] + r[c, 2] * row[ROTATION + 6 + d]
        kx, ky, kz = row[AXIS], row[AXIS + 1], row[AXIS + 2]
        for c in range(3):
            axes[j, c] = t[c, 0] * kx + t[c, 1] * ky + t[c, 2] * kz
            origins[j, c] = p[c]
        value = row[STRETCH] * q[int(row[COLUMN])] + row[OFFSET]
        if row[PRISMATIC] != 0.0:
            for c in range(3):
                p[c] += value * axes[j, c]
                r[c, 0], r[c, 1], r[c, 2] = t[c, 0], t[c, 1], t[c, 2]
        else:  # Rodrigues rotation of the frame's columns about the joint axis
            sin, cos = math.sin(value), math.cos(value)
            rest = 1.0 - cos
            for c in range(3):
                a, b, d = t[c, 0], t[c, 1], t[c, 2]
                along = rest * (a * kx + b * ky + d * kz)
                r[c, 0] = cos * a + sin * (b * kz - d * ky) + along * kx
                r[c, 1] = cos * b + sin * (d * kx - a * kz) + along * ky
                r[c, 2] = cos * d + sin * (a * ky - b * kx) + along * kz
    for c in range(3):
        tip[c] = p[c] + r[c, 0] * last[0] + r[c, 1] * last[1] + r[c, 2] * last[2]


@inlined
def position_jacobian(rows, origins, axes, tip, jacobian):
    """Derivatives of the tip with respect to the joints, (3, A)."""
    jacobian[:] = 0.0
    for j in range(len(rows)):
        i, stretch = int(rows[j, COLUMN]), rows[j, STRETCH]
        ax, ay, az = axes[j, 0], axes[j, 1], axes[j, 2]
        if rows[j, PRISMATIC] != 0.0:
            jacobian[0, i] += stretch * ax
            jacobian[1, i] += stretch * ay
            jacobian[2, i] += stretch * az
        else:
            x, y, z = tip[0] - origins[j, 0], tip[1] - origins[j, 1], tip[2] - origins[j, 2]
            jacobian[0, i] += stretch * (ay * z - az * y)
            jacobian[1, i] += stretch * (az * x - ax * z)
            jacobian[2, i] += stretch * (ax * y - ay * x)


@inlined
def damped_step(jacobian, weights, error, damping, q, low, high, held, z):
    """Change ``z`` (A,) of the joints, within their bounds; ``held`` (A,) is scratch."""
    count = len(weights)
    held[:] = False
    for _ in range(count):
        a, b, c, d, e, f = damping, 0.0, 0.0, damping, 0.0, damping  # JWWJ' + λ, symmetric: aa ab ac bb bc cc
        for i in range(count):
            if not held[i]:
                w = weights[i] * weights[i]
                x, y, v = jacobian[0, i], jacobian[1, i], jacobian[2, i]
                a += w * x * x
                b += w * x * y
                c += w * x * v
                d += w * y * y
                e += w * y * v
                f += w * v * v
        aa, ab, ac = d * f - e * e, c * e - b * f, b * e - c * d
        bb, bc, cc = a * f - c * c, b * c - a * e, a * d - b * b
        size = a * aa + b * ab + c * ac
        if size == 0.0:
            z[:] = 0.0
            return
        x = -(aa * error[0] + ab * error[1] + ac * error[2]) / size
        y = -(ab * error[0] + bb * error[1] + bc * error[2]) / size
        v = -(ac * error[0] + bc * error[1] + cc * error[2]) / size
        more = False
        for i in range(count):
            if held[i]:
                z[i] = 0.0
                continue
            z[i] = weights[i] ** 2 * (jacobian[0, i] * x + jacobian[1, i] * y + jacobian[2, i] * v)
            if (q[i] <= low[i] and z[i] < 0.0) or (q[i] >= high[i] and z[i] > 0.0):
                held[i] = True
                more = True
        if not more:
            break
    for i in range(count):
        z[i] = 0.0 if held[i] else min(max(z[i], low[i] - q[i]), high[i] - q[i])


@kernel
def solve(rows, last, low, high, weights, begin, targets, follow, steps, near, out, left):
    """Joints that bring the tip to each target.

    Args:
        rows: (J, WIDTH); ``last`` (3,) the tip in the frame of the last joint.
        low, high, weights: (A,).
        begin: joints at which each search begins, (n, A); with ``follow`` it begins at the result before, the first at
            ``begin[0]``.
        targets: (n, 3) [m].
        steps: at most, for each target; ``near``: distance at which a search ends [m].
        out: joints, (n, A); ``left``: remaining distances, (n,) [m].
    """
    count = len(weights)
    origins, axes = np.empty((len(rows), 3)), np.empty((len(rows), 3))
    frame = np.empty((7, 3))
    jacobian, tip, error, away = np.empty((3, count)), np.empty(3), np.empty(3), np.empty(3)
    q, trial, z = np.empty(count), np.empty(count), np.empty(count)
    held = np.zeros(count, dtype=np.bool_)
    for k in range(len(targets)):
        for i in range(count):
            x = out[k - 1, i] if follow and k > 0 else begin[k, i]
            q[i] = min(max(x, low[i]), high[i])
        forward_kinematics(rows, last, q, frame, origins, axes, tip)
        cost = 0.0
        for c in range(3):
            error[c] = tip[c] - targets[k, c]
            cost += error[c] * error[c]
        damping = 0.0
        for _ in range(steps):
            if cost <= near * near:
                break
            position_jacobian(rows, origins, axes, tip, jacobian)
            scale = 0.0
            for i in range(count):
                for c in range(3):
                    scale += (weights[i] * jacobian[c, i]) ** 2
            if damping == 0.0:
                damping = DAMPING * scale
            better = False
            for _ in range(12):
                damped_step(jacobian, weights, error, damping, q, low, high, held, z)
                length = 0.0
                for i in range(count):
                    trial[i] = min(max(q[i] + z[i], low[i]), high[i])
                    length += (z[i] / weights[i]) ** 2
                if length < SHORT * SHORT:
                    break
                forward_kinematics(rows, last, trial, frame, origins, axes, tip)
                found = 0.0
                for c in range(3):
                    away[c] = tip[c] - targets[k, c]
                    found += away[c] * away[c]
                if found < cost:
                    better = True
                    break
                damping = 8.0 * damping + 1e-3 * DAMPING * scale
            if not better:
                break
            done = cost - found < 1e-9 * cost
            q[:] = trial
            error[:] = away
            cost = found
            damping *= 0.2
            if done:
                break
        for i in range(count):
            out[k, i] = q[i]
        left[k] = math.sqrt(cost)


@kernel
def tips(rows, last, joints, out):
    """Tips (n, 3) at joints (n, A)."""
    frame, origins, axes = np.empty((7, 3)), np.empty((len(rows), 3)), np.empty((len(rows), 3))
    for k in range(len(joints)):
        forward_kinematics(rows, last, joints[k], frame, origins, axes, out[k])
