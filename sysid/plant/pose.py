"""Kinematics of one pose, compiled: joints of the structure → end effector, and the gravity load on every axis."""

from __future__ import annotations

import math

import numpy as np

from sysid.effects.compiled import inlined, kernel
from sysid.plant.layout import AT, AXIS_WIDTH
from sysid.plant.machine_arrays import (
    ALIGNED,
    AXIS,
    CENTRE,
    LENGTH,
    MASS,
    OFFSET,
    ORDER,
    PASSIVE,
    PRISMATIC,
    RATIO,
    ROTATION,
    SHIFT,
    TURNED,
    WEIGHT,
)
from sysid.plant.trig import sincos

#: Numbers that :func:`pose` keeps a joint: axis x, y, z and origin x, y in the base frame, mass, its moments x, y.
SCRATCH = 8


@inlined
def pose(q, p, links, base, scratch, tip, load):
    """End effector ``tip`` (3,) [m] and gravity ``load`` (A,) [N·m or N] of the structure at ``q`` (A,).

    The load is the derivative of the potential energy by the joint, its passive joints included: above zero where gravity
    opposes positive motion.
    ``scratch`` (J + 1, SCRATCH) is used inside.
    """
    count = len(links) - 1
    xx, xy, xz, yx, yy, yz, zx, zy, zz = 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0  # columns of the frame's rotation
    px, py, pz = 0.0, 0.0, 0.0
    for j in range(count + 1):
        fx, fy, fz = links[j, SHIFT], links[j, SHIFT + 1], links[j, SHIFT + 2]
        if j > 0 and links[j - 1, PASSIVE] == 0.0:
            longer = p[int(links[j - 1, ORDER]) * AXIS_WIDTH + AT.link_length_error]
            if longer != 0.0 and links[j, LENGTH] > 1e-9:
                stretch = 1.0 + longer / links[j, LENGTH]
                fx *= stretch
                fy *= stretch
                fz *= stretch
        px += xx * fx + yx * fy + zx * fz
        py += xy * fx + yy * fy + zy * fz
        pz += xz * fx + yz * fy + zz * fz
        if j == count:
            b = base + AT.tip_offset
            px += xx * p[b] + yx * p[b + 1] + zx * p[b + 2]
            py += xy * p[b] + yy * p[b + 1] + zy * p[b + 2]
            pz += xz * p[b] + yz * p[b + 1] + zz * p[b + 2]
            break
        if links[j, TURNED] != 0.0:
            ax, ay, az = xx, xy, xz
            bx, by, bz = yx, yy, yz
            cx, cy, cz = zx, zy, zz
            u, v, w = links[j, ROTATION], links[j, ROTATION + 3], links[j, ROTATION + 6]
            xx, xy, xz = ax * u + bx * v + cx * w, ay * u + by * v + cy * w, az * u + bz * v + cz * w
            u, v, w = links[j, ROTATION + 1], links[j, ROTATION + 4], links[j, ROTATION + 7]
            yx, yy, yz = ax * u + bx * v + cx * w, ay * u + by * v + cy * w, az * u + bz * v + cz * w
            u, v, w = links[j, ROTATION + 2], links[j, ROTATION + 5], links[j, ROTATION + 8]
            zx, zy, zz = ax * u + bx * v + cx * w, ay * u + by * v + cy * w, az * u + bz * v + cz * w
        along = links[j, ALIGNED]
        if along == 0.0:
            u, v, w = links[j, AXIS], links[j, AXIS + 1], links[j, AXIS + 2]
            ax, ay, az = xx * u + yx * v + zx * w, xy * u + yy * v + zy * w, xz * u + yz * v + zz * w
        else:  # one of the frame's own axes, or against it
            if along == 1.0 or along == -1.0:
                ax, ay, az = xx, xy, xz
            elif along == 2.0 or along == -2.0:
                ax, ay, az = yx, yy, yz
            else:
                ax, ay, az = zx, zy, zz
            if along < 0.0:
                ax, ay, az = -ax, -ay, -az
        scratch[j, 0], scratch[j, 1], scratch[j, 2] = ax, ay, az
        scratch[j, 3], scratch[j, 4] = px, py
        value = q[int(links[j, ORDER])] * links[j, RATIO] + links[j, OFFSET]
        if links[j, PRISMATIC] != 0.0:
            px += value * ax
            py += value * ay
            pz += value * az
        else:
            s, c = sincos(value)
            if along == 0.0:
                xx, xy, xz = _turn(xx, xy, xz, ax, ay, az, s, c)
                yx, yy, yz = _turn(yx, yy, yz, ax, ay, az, s, c)
                zx, zy, zz = _turn(zx, zy, zz, ax, ay, az, s, c)
            else:
                if along < 0.0:
                    s = -s
                    along = -along
                if along == 3.0:
                    xx, xy, xz, yx, yy, yz = _mix(xx, xy, xz, yx, yy, yz, c, s)
                elif along == 2.0:
                    zx, zy, zz, xx, xy, xz = _mix(zx, zy, zz, xx, xy, xz, c, s)
                else:
                    yx, yy, yz, zx, zy, zz = _mix(yx, yy, yz, zx, zy, zz, c, s)
        mass = links[j, MASS]
        gx, gy, gz = links[j, CENTRE], links[j, CENTRE + 1], links[j, CENTRE + 2]
        scratch[j, 5] = mass
        scratch[j, 6] = mass * (px + xx * gx + yx * gy + zx * gz)
        scratch[j, 7] = mass * (py + xy * gx + yy * gy + zy * gz)
    for i in range(len(load)):
        load[i] = 0.0
    mass, mx, my = 0.0, 0.0, 0.0
    for j in range(count - 1, -1, -1):
        mass += scratch[j, 5]
        mx += scratch[j, 6]
        my += scratch[j, 7]
        if links[j, PRISMATIC] != 0.0:
            own = mass * scratch[j, 2]
        else:
            own = scratch[j, 0] * (my - mass * scratch[j, 4]) - scratch[j, 1] * (mx - mass * scratch[j, 3])
        load[int(links[j, ORDER])] += links[j, WEIGHT] * own * links[j, RATIO]
    b = base + AT.base_misalignment
    u, v, w = p[b + 3], p[b + 4], p[b + 5]
    if u != 0.0 or v != 0.0 or w != 0.0:
        angle = math.sqrt(u * u + v * v + w * w)
        px, py, pz = _turn(px, py, pz, u / angle, v / angle, w / angle, math.sin(angle), math.cos(angle))
    tip[0] = px + p[b]
    tip[1] = py + p[b + 1]
    tip[2] = pz + p[b + 2]


@inlined
def _mix(ax, ay, az, bx, by, bz, c, s):
    """Two columns of a rotation turned about the third one."""
    return c * ax + s * bx, c * ay + s * by, c * az + s * bz, c * bx - s * ax, c * by - s * ay, c * bz - s * az


@inlined
def _turn(x, y, z, ax, ay, az, s, c):
    """A vector turned about a unit axis by the angle of sine ``s`` and cosine ``c`` (Rodrigues)."""
    along = (ax * x + ay * y + az * z) * (1.0 - c)
    return (
        c * x + s * (ay * z - az * y) + along * ax,
        c * y + s * (az * x - ax * z) + along * ay,
        c * z + s * (ax * y - ay * x) + along * az,
    )


@kernel
def loads(p, links, base, joints, out):
    """Gravity loads (n, A) at joints (n, A); a row with a missing joint is NaN."""
    scratch = np.empty((len(links), SCRATCH))
    tip = np.empty(3)
    for k in range(len(joints)):
        missing = False
        for i in range(joints.shape[1]):
            missing |= np.isnan(joints[k, i])
        if missing:
            out[k] = np.nan
        else:
            pose(joints[k], p, links, base, scratch, tip, out[k])
