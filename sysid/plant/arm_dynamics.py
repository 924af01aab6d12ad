"""Dynamics of the links of an arm, compiled: mass matrix, and the torques of speeds and gravity.

Composite rigid bodies and the recursive Newton-Euler equations, in the axes of the base frame; every body is described by its
ten inertial parameters about the origin of its joint (:class:`sysid.plant.machine_arrays.MachineArrays`).

Source: Featherstone, Rigid Body Dynamics Algorithms (2008), ch. 5-6; Luh, Walker, Paul, ASME JDSMC 102 (1980).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sysid.effects.compiled import inlined, kernel, loop
from sysid.plant.layout import AT, AXIS_WIDTH
from sysid.plant.machine_arrays import (
    AXIS,
    OFFSET,
    ORDER,
    PASSIVE,
    PRISMATIC,
    RATIO,
    ROTATION,
    SHIFT,
    WEIGHT,
    MachineArrays,
)
from sysid.plant.trig import sincos

Array = npt.NDArray[np.float64]

#: Numbers that :func:`dynamics` keeps of a joint: axis, way from the joint before it, mass, first moment and inertia about its
#: origin, force and torque.
BODY = 22
_WAY, _MASS, _MOMENT, _INERTIA, _FORCE, _TORQUE = 3, 6, 7, 10, 16, 19


@loop
def dynamics(q, v, links, bodies, kept, mass, bias):
    """Mass matrix and bias of the links at positions ``q`` (A,) and speeds ``v`` (A,): torque = mass · acceleration + bias.

    Args:
        links, bodies: of :class:`~sysid.plant.machine_arrays.MachineArrays`.
        kept: (J, BODY), used inside.
        mass, bias: out, (A, A) [kg·m², kg·m or kg] and (A,) [N·m or N].
    """
    count, axes = len(bodies), len(q)
    for i in range(axes):
        bias[i] = 0.0
        for j in range(axes):
            mass[i, j] = 0.0
    xx, xy, xz, yx, yy, yz, zx, zy, zz = 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0  # columns of the frame's rotation
    wx, wy, wz, ex, ey, ez, ax, ay = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0  # turning, its rate
    az = links[0, WEIGHT]  # ax, ay, az: acceleration
    for j in range(count):
        fx, fy, fz = links[j, SHIFT], links[j, SHIFT + 1], links[j, SHIFT + 2]
        rx, ry, rz = xx * fx + yx * fy + zx * fz, xy * fx + yy * fy + zy * fz, xz * fx + yz * fy + zz * fz
        xx, xy, xz, yx, yy, yz, zx, zy, zz = _times(links, j, xx, xy, xz, yx, yy, yz, zx, zy, zz)
        u1, u2, u3 = links[j, AXIS], links[j, AXIS + 1], links[j, AXIS + 2]
        ux, uy, uz = xx * u1 + yx * u2 + zx * u3, xy * u1 + yy * u2 + zy * u3, xz * u1 + yz * u2 + zz * u3
        order, ratio = int(links[j, ORDER]), links[j, RATIO]
        place, speed = q[order] * ratio + links[j, OFFSET], v[order] * ratio
        sliding = links[j, PRISMATIC] != 0.0
        if sliding:
            rx, ry, rz = rx + place * ux, ry + place * uy, rz + place * uz
        cx, cy, cz = _cross(wx, wy, wz, rx, ry, rz)
        dx, dy, dz = _cross(wx, wy, wz, cx, cy, cz)
        gx, gy, gz = _cross(ex, ey, ez, rx, ry, rz)
        ax, ay, az = ax + gx + dx, ay + gy + dy, az + gz + dz
        cx, cy, cz = _cross(wx, wy, wz, speed * ux, speed * uy, speed * uz)
        if sliding:
            ax, ay, az = ax + 2.0 * cx, ay + 2.0 * cy, az + 2.0 * cz
        else:
            ex, ey, ez = ex + cx, ey + cy, ez + cz
            wx, wy, wz = wx + speed * ux, wy + speed * uy, wz + speed * uz
            s, c = sincos(place)
            xx, xy, xz = _turned(xx, xy, xz, ux, uy, uz, s, c)
            yx, yy, yz = _turned(yx, yy, yz, ux, uy, uz, s, c)
            zx, zy, zz = _turned(zx, zy, zz, ux, uy, uz, s, c)
        kept[j, 0], kept[j, 1], kept[j, 2] = ux, uy, uz
        kept[j, _WAY], kept[j, _WAY + 1], kept[j, _WAY + 2] = rx, ry, rz
        m, h1, h2, h3 = bodies[j, 0], bodies[j, 1], bodies[j, 2], bodies[j, 3]
        hx, hy, hz = xx * h1 + yx * h2 + zx * h3, xy * h1 + yy * h2 + zy * h3, xz * h1 + yz * h2 + zz * h3
        a11, a12, a22, a13, a23, a33 = bodies[j, 4], bodies[j, 5], bodies[j, 6], bodies[j, 7], bodies[j, 8], bodies[j, 9]
        # Columns of rotation · inertia, then their products with the rows of the rotation.
        p1, p2, p3 = xx * a11 + yx * a12 + zx * a13, xy * a11 + yy * a12 + zy * a13, xz * a11 + yz * a12 + zz * a13
        q1, q2, q3 = xx * a12 + yx * a22 + zx * a23, xy * a12 + yy * a22 + zy * a23, xz * a12 + yz * a22 + zz * a23
        r1, r2, r3 = xx * a13 + yx * a23 + zx * a33, xy * a13 + yy * a23 + zy * a33, xz * a13 + yz * a23 + zz * a33
        ixx, ixy, ixz = p1 * xx + q1 * yx + r1 * zx, p1 * xy + q1 * yy + r1 * zy, p1 * xz + q1 * yz + r1 * zz
        iyy, iyz, izz = p2 * xy + q2 * yy + r2 * zy, p2 * xz + q2 * yz + r2 * zz, p3 * xz + q3 * yz + r3 * zz
        kept[j, _MASS] = m
        kept[j, _MOMENT], kept[j, _MOMENT + 1], kept[j, _MOMENT + 2] = hx, hy, hz
        kept[j, _INERTIA], kept[j, _INERTIA + 1], kept[j, _INERTIA + 2] = ixx, ixy, iyy
        kept[j, _INERTIA + 3], kept[j, _INERTIA + 4], kept[j, _INERTIA + 5] = ixz, iyz, izz
        cx, cy, cz = _cross(wx, wy, wz, hx, hy, hz)
        dx, dy, dz = _cross(wx, wy, wz, cx, cy, cz)
        gx, gy, gz = _cross(ex, ey, ez, hx, hy, hz)
        kept[j, _FORCE], kept[j, _FORCE + 1], kept[j, _FORCE + 2] = m * ax + gx + dx, m * ay + gy + dy, m * az + gz + dz
        lx, ly, lz = ixx * wx + ixy * wy + ixz * wz, ixy * wx + iyy * wy + iyz * wz, ixz * wx + iyz * wy + izz * wz
        cx, cy, cz = _cross(wx, wy, wz, lx, ly, lz)
        dx, dy, dz = _cross(hx, hy, hz, ax, ay, az)
        kept[j, _TORQUE] = ixx * ex + ixy * ey + ixz * ez + cx + dx
        kept[j, _TORQUE + 1] = ixy * ex + iyy * ey + iyz * ez + cy + dy
        kept[j, _TORQUE + 2] = ixz * ex + iyz * ey + izz * ez + cz + dz
    for j in range(count - 1, -1, -1):
        ux, uy, uz = kept[j, 0], kept[j, 1], kept[j, 2]
        rx, ry, rz = kept[j, _WAY], kept[j, _WAY + 1], kept[j, _WAY + 2]
        fx, fy, fz = kept[j, _FORCE], kept[j, _FORCE + 1], kept[j, _FORCE + 2]
        nx, ny, nz = kept[j, _TORQUE], kept[j, _TORQUE + 1], kept[j, _TORQUE + 2]
        m, hx, hy, hz = kept[j, _MASS], kept[j, _MOMENT], kept[j, _MOMENT + 1], kept[j, _MOMENT + 2]
        ixx, ixy, iyy = kept[j, _INERTIA], kept[j, _INERTIA + 1], kept[j, _INERTIA + 2]
        ixz, iyz, izz = kept[j, _INERTIA + 3], kept[j, _INERTIA + 4], kept[j, _INERTIA + 5]
        order, ratio = int(links[j, ORDER]), links[j, RATIO]
        sliding = links[j, PRISMATIC] != 0.0
        bias[order] += ratio * (ux * fx + uy * fy + uz * fz if sliding else ux * nx + uy * ny + uz * nz)
        if j > 0:
            cx, cy, cz = _cross(rx, ry, rz, fx, fy, fz)
            kept[j - 1, _FORCE] += fx
            kept[j - 1, _FORCE + 1] += fy
            kept[j - 1, _FORCE + 2] += fz
            kept[j - 1, _TORQUE] += nx + cx
            kept[j - 1, _TORQUE + 1] += ny + cy
            kept[j - 1, _TORQUE + 2] += nz + cz
            along, square = 2.0 * (hx * rx + hy * ry + hz * rz), rx * rx + ry * ry + rz * rz
            kept[j - 1, _MASS] += m
            kept[j - 1, _MOMENT] += hx + m * rx
            kept[j - 1, _MOMENT + 1] += hy + m * ry
            kept[j - 1, _MOMENT + 2] += hz + m * rz
            kept[j - 1, _INERTIA] += ixx + along - 2.0 * hx * rx + m * (square - rx * rx)
            kept[j - 1, _INERTIA + 1] += ixy - hx * ry - hy * rx - m * rx * ry
            kept[j - 1, _INERTIA + 2] += iyy + along - 2.0 * hy * ry + m * (square - ry * ry)
            kept[j - 1, _INERTIA + 3] += ixz - hx * rz - hz * rx - m * rx * rz
            kept[j - 1, _INERTIA + 4] += iyz - hy * rz - hz * ry - m * ry * rz
            kept[j - 1, _INERTIA + 5] += izz + along - 2.0 * hz * rz + m * (square - rz * rz)
        # Force and torque that accelerate all that moves with this joint by one unit along or about its axis.
        if sliding:
            fx, fy, fz = m * ux, m * uy, m * uz
            nx, ny, nz = _cross(hx, hy, hz, ux, uy, uz)
        else:
            fx, fy, fz = _cross(ux, uy, uz, hx, hy, hz)
            nx, ny, nz = ixx * ux + ixy * uy + ixz * uz, ixy * ux + iyy * uy + iyz * uz, ixz * ux + iyz * uy + izz * uz
        for i in range(j, -1, -1):
            ux, uy, uz = kept[i, 0], kept[i, 1], kept[i, 2]
            value = ux * fx + uy * fy + uz * fz if links[i, PRISMATIC] != 0.0 else ux * nx + uy * ny + uz * nz
            value *= ratio * links[i, RATIO]
            other = int(links[i, ORDER])
            mass[order, other] += value
            if i != j:
                mass[other, order] += value
            cx, cy, cz = _cross(kept[i, _WAY], kept[i, _WAY + 1], kept[i, _WAY + 2], fx, fy, fz)
            nx, ny, nz = nx + cx, ny + cy, nz + cz


@loop
def true_bodies(p, links, bodies, out):
    """Inertial parameters of the bodies of a plant, (J, 10): those of the URDF, changed by ``link_mass_error``."""
    for j in range(len(bodies)):
        ratio = 1.0 if links[j, PASSIVE] != 0.0 else p[int(links[j, ORDER]) * AXIS_WIDTH + AT.link_mass_error]
        for k in range(bodies.shape[1]):
            out[j, k] = ratio * bodies[j, k]


def mass_ratios(arrays: MachineArrays, theta: Array) -> Array:
    """True mass of each body over that in the URDF, (J,)."""
    links = arrays.links[: len(arrays.bodies)]
    of_axis = theta[links[:, ORDER].astype(np.intp) * AXIS_WIDTH + AT.link_mass_error]
    return np.where(links[:, PASSIVE] != 0.0, 1.0, of_axis)


@inlined
def _cross(ax, ay, az, bx, by, bz):
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@inlined
def _times(links, j, xx, xy, xz, yx, yy, yz, zx, zy, zz):
    """Columns of a rotation times that of the frame of joint ``j``."""
    u, v, w = links[j, ROTATION], links[j, ROTATION + 3], links[j, ROTATION + 6]
    a1, a2, a3 = xx * u + yx * v + zx * w, xy * u + yy * v + zy * w, xz * u + yz * v + zz * w
    u, v, w = links[j, ROTATION + 1], links[j, ROTATION + 4], links[j, ROTATION + 7]
    b1, b2, b3 = xx * u + yx * v + zx * w, xy * u + yy * v + zy * w, xz * u + yz * v + zz * w
    u, v, w = links[j, ROTATION + 2], links[j, ROTATION + 5], links[j, ROTATION + 8]
    return a1, a2, a3, b1, b2, b3, xx * u + yx * v + zx * w, xy * u + yy * v + zy * w, xz * u + yz * v + zz * w


@inlined
def _turned(x, y, z, ax, ay, az, s, c):
    """A vector turned about a unit axis by the angle of sine ``s`` and cosine ``c`` (Rodrigues)."""
    along = (ax * x + ay * y + az * z) * (1.0 - c)
    cx, cy, cz = _cross(ax, ay, az, x, y, z)
    return c * x + s * cx + along * ax, c * y + s * cy + along * ay, c * z + s * cz + along * az


@kernel
def link_series(links, bodies, q, v, a, ahead, own, bias, coupled, slope):
    """What the motion of all joints makes of the links, for the dynamics of each axis by itself.

    The torque on axis i is ``own·q̈ + bias + coupled + slope·(q − q_moved)`` for another motion q of this axis alone.

    Args:
        q, v: positions and speeds at the samples, (n, A) each; ``a``: mean accelerations from each sample to the next, (n, A).
        ahead: share of the first of both samples in the inertia of the step between them.
        own, bias, slope: out, (A, n): inertia about the axis [kg·m² or kg], torque of speeds and gravity [N·m or N], and its
            change by the own position at rest [N·m/rad or N/m].
        coupled: out, (A, n): mean torque of the accelerations of the other axes from each sample to the next.
    """
    axes = q.shape[1]
    kept, mass, torque = np.empty((len(bodies), BODY)), np.empty((axes, axes)), np.empty(axes)
    coupled[:] = 0.0
    for k in range(len(q)):
        dynamics(q[k], v[k], links, bodies, kept, mass, torque)
        for i in range(axes):
            own[i, k], bias[i, k], slope[i, k] = mass[i, i], torque[i], _weight_slope(links, kept, i)
            for j in range(axes):
                if j != i:
                    coupled[i, k] += ahead * mass[i, j] * a[k, j]
                    if k > 0:
                        coupled[i, k - 1] += (1.0 - ahead) * mass[i, j] * a[k - 1, j]


@inlined
def _weight_slope(links, kept, i):
    """Change of the gravity torque of axis ``i`` by its own position [N·m/rad or N/m], after :func:`dynamics`.

    The second derivative of the potential energy: a joint turns the axes and first moments of those behind it.
    """
    total, w = 0.0, links[0, WEIGHT]
    for j in range(len(kept)):
        if int(links[j, ORDER]) != i:
            continue
        ux, uy, uz = kept[j, 0], kept[j, 1], kept[j, 2]
        hx, hy, hz = kept[j, _MOMENT], kept[j, _MOMENT + 1], kept[j, _MOMENT + 2]
        for before in range(j + 1):
            if int(links[before, ORDER]) != i or links[before, PRISMATIC] != 0.0:
                continue
            bx, by, bz = kept[before, 0], kept[before, 1], kept[before, 2]
            ex, ey, ez = _cross(bx, by, bz, ux, uy, uz)
            if links[j, PRISMATIC] != 0.0:
                value = ez * kept[j, _MASS] * w
            else:
                gx, gy, _ = _cross(bx, by, bz, hx, hy, hz)
                value = w * (ex * hy - ey * hx + ux * gy - uy * gx)
            total += (1.0 if before == j else 2.0) * links[j, RATIO] * links[before, RATIO] * value
    return total
