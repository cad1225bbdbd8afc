r"""Relative motion of two bodies in contact: slip, twist, pose, Montana's equations.

Body 1 is the finger, body 2 the object. In contact frames E_i (or in any frames carried along,
with R the map between their tangent components),

.. math::
    R_\psi = \begin{bmatrix}\cos\psi & -\sin\psi\\ -\sin\psi & -\cos\psi\end{bmatrix}, \qquad
    v_{rel} = R_\psi M_1 \dot q_1 - M_2 \dot q_2 \quad (\text{eq. } netrelvel).

The velocity of the finger's material point relative to the object's is ``-v_rel`` in E2.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from .errors import ConformalContact

# Relative curvature whose determinant is below this part of its square leaves the motion open.
SINGULAR = 1e-12


def contact_map(psi: np.ndarray | float) -> np.ndarray:
    """R_psi (eq. `rotation`), its own inverse: (...) -> (..., 2, 2)."""
    out = np.empty(np.shape(psi) + (2, 2))
    out[..., 0, 0] = np.cos(psi)
    out[..., 0, 1] = out[..., 1, 0] = -np.sin(psi)
    out[..., 1, 1] = -out[..., 0, 0]
    return out


def inverse_montana(
    curvature_1: np.ndarray,
    curvature_2: np.ndarray,
    psi: np.ndarray,
    a1: np.ndarray,
    a2: np.ndarray,
) -> np.ndarray:
    """Relative angular velocity of the finger from the contact rates; nothing is inverted.

    Parameters
    ----------
    curvature_1, curvature_2 : (..., 2, 2)
        Curvature forms K_1, K_2, 1/m.
    psi : (...)
    a1, a2 : (..., 2)
        M_i q_i' in E_i, m/s.

    Returns
    -------
    (..., 2)
        omega_x, omega_y of the finger relative to the object in E1, rad/s; omega_z = 0.
        Montana, Int. J. Robotics Research 7(3), 1988.
    """
    turn = contact_map(psi)
    own = np.einsum("...ij,...j->...i", curvature_1, a1)
    k = own + np.einsum("...ij,...jk,...k->...i", turn, curvature_2, a2)
    return np.stack([k[..., 1], -k[..., 0]], axis=-1)


def forward_montana(
    curvature_1: np.ndarray,
    curvature_2: np.ndarray,
    psi: np.ndarray,
    omega: np.ndarray,
    v_rel: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Contact rates from a measured relative twist (Montana's equations of contact).

    Parameters
    ----------
    curvature_1, curvature_2 : (..., 2, 2)
        Curvature forms K_1, K_2, 1/m.
    psi : (...)
    omega : (..., 2)
        omega_x, omega_y of the finger relative to the object in E1, rad/s.
    v_rel : (..., 2)
        Slip in E2, m/s.

    Returns
    -------
    a1, a2 : (..., 2)
        M_i q_i' in E_i, m/s.

    Raises
    ------
    ConformalContact
        K_1 + R_psi K_2 R_psi is singular: the surfaces fit each other to second order (a sphere in
        a bowl of its own radius), so the contact point is not determined.
    """
    turn = contact_map(psi)
    relative = turn @ curvature_2 @ turn + curvature_1
    size = np.abs(curvature_1).max((-1, -2)) + np.abs(curvature_2).max((-1, -2))
    singular = np.abs(np.linalg.det(relative)) <= SINGULAR * size**2
    if np.any(singular):
        at = tuple(np.argwhere(singular)[0])
        raise ConformalContact(
            "the surfaces conform to each other at the contact (relative curvature "
            f"{relative[at].tolist()} 1/m is singular), so a twist does not determine where they "
            "touch; change a radius or a surface"
        )
    bend = np.stack([-omega[..., 1], omega[..., 0]], axis=-1)
    a1, a2 = contact_velocities(
        curvature_1, curvature_2, turn, bend[..., None], v_rel[..., None], np.linalg.solve
    )
    return a1[..., 0], a2[..., 0]


def contact_velocities(
    curvature_1: Any,
    curvature_2: Any,
    turn: Any,
    bend: Any,
    v_rel: Any,
    solve: Callable[[Any, Any], Any],
) -> tuple[Any, Any]:
    """What :func:`forward_montana` solves, for arrays and for SX matrices alike.

    From ``bend = K_1 a_1 + R_psi K_2 a_2`` and ``v_rel = R_psi a_1 - a_2`` the contact velocities
    a_1, a_2.

    Parameters
    ----------
    curvature_1, curvature_2, turn : (..., 2, 2)
        K_1, K_2 [1/m] and R_psi.
    bend, v_rel : (..., 2, 1)
        ``[-omega_y, omega_x]`` in E1 [rad/s], slip in E2 [m/s].
    solve : callable
        ``solve(A, b)`` of the kind of matrices given.

    Returns
    -------
    a1, a2 : (..., 2, 1)
        M_i q_i' in E_i, m/s.
    """
    a1 = solve(turn @ curvature_2 @ turn + curvature_1, bend + turn @ curvature_2 @ v_rel)
    return a1, turn @ a1 - v_rel


def relative_pose(frame_1: np.ndarray, frame_2: np.ndarray, r0: np.ndarray) -> np.ndarray:
    """Pose of the finger's body frame in the object's (theory section 8), of any kind of numbers.

    Parameters
    ----------
    frame_1, frame_2 : (n, 9, n_times)
        Contact point x and tangent axes p, q of each body, in its own frame.
    r0 : (n, 2, 2)
        Map from tangent components along (p_1, q_1) to those along (p_2, q_2).

    Returns
    -------
    (n, n_times, 4, 4)
    """
    (x1, p1, q1), (x2, p2, q2) = map(_parts, (frame_1, frame_2))
    n1, n2 = _cross(p1, q1), _cross(p2, q2)
    (a, b), (c, d) = r0[:, :, :, None, None].transpose(1, 2, 0, 3, 4)
    # R_21 = [p2 q2 n2] diag(R_0, -1) [p1 q1 n1]^T: (n, 3, 3, n_times)
    turn = p2[:, :, None] * (a * p1 + b * q1)[:, None]
    turn += q2[:, :, None] * (c * p1 + d * q1)[:, None]
    turn -= n2[:, :, None] * n1[:, None]
    pose = np.zeros((len(turn), turn.shape[3], 4, 4), dtype=turn.dtype)
    pose[..., :3, :3] = turn.transpose(0, 3, 1, 2)
    pose[..., :3, 3] = (x2 - (turn * x1[:, None]).sum(axis=2)).swapaxes(1, 2)
    pose[..., 3, 3] = 1.0
    return pose


def relative_twist(
    frame_2: np.ndarray,
    pose: np.ndarray,
    shapes: tuple[np.ndarray, np.ndarray],
    velocities: tuple[np.ndarray, np.ndarray],
    r0: np.ndarray,
    v_rel: np.ndarray,
) -> np.ndarray:
    """Twist of the finger's frame in the object's frame: angular, then velocity of its origin.

    Of any kind of numbers.

    Montana's inverse map in frames carried along (theory section 8):
    ``omega = k_x q_2 - k_y p_2`` with ``k = K_2 a_2 + R_0 K_1 a_1``.

    Parameters
    ----------
    frame_2 : (n, 9, n_times)
    pose : (n, n_times, 4, 4)
    shapes : two (n, 3, n_times)
        K_pp, K_pq, K_qq of finger and object.
    velocities : two (n, 2, n_times)
        a_1, a_2: velocity of the contact point in (p_i, q_i).
    r0 : (n, 2, 2)
    v_rel : (n, 2, n_times)
        Slip along (p_2, q_2).

    Returns
    -------
    (n, n_times, 6)
        rad/s and m/s, in the object's axes.
    """
    x2, p2, q2 = _parts(frame_2)
    bent = [_bend(k, a) for k, a in zip(shapes, velocities)]
    k = bent[1] + r0 @ bent[0]
    omega = k[:, :1] * q2 - k[:, 1:] * p2
    sliding = v_rel[:, :1] * p2 + v_rel[:, 1:] * q2
    arm = x2 - pose[..., :3, 3].swapaxes(1, 2)  # R_21 x_1: from the finger's origin to the contact
    return np.concatenate([omega, -sliding - _cross(omega, arm)], axis=1).swapaxes(1, 2)


def _bend(shape: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    x = shape[:, 0] * velocity[:, 0] + shape[:, 1] * velocity[:, 1]
    y = shape[:, 1] * velocity[:, 0] + shape[:, 2] * velocity[:, 1]
    return np.stack([x, y], axis=1)


def _parts(frame: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """x, p, q of (n, 9, n_times), (n, 3, n_times) each."""
    return frame[:, :3], frame[:, 3:6], frame[:, 6:]


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a x b along the second axis."""
    after, before = [1, 2, 0], [2, 0, 1]
    return a[:, after] * b[:, before] - a[:, before] * b[:, after]
