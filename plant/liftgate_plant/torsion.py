"""Twist of the gate about a lateral axis, as one mode: at the lateral position y the gate is at φ + ψ y/w.

    J_t ψ̈ + d_t ψ̇ + k_t ψ = M_left − M_right + Σ_j (y_j/w) F_j r_j          T = ½ J_L ω² + ½ J_t ψ̇²

Departure: the thesis has one rigid gate for both drives; here the left drive is at y = w, the right one at −w.
Without a stiffness the gate is rigid, ψ = 0. Snow acts at its place y, and its inertia is in J_L; that it is in
J_t too, and couples ω with ψ̇, is neglected.
"""

from __future__ import annotations

from typing import NamedTuple

from liftgate_compiler import compilable

# Above k_t h²/J_t = 1 the twist is too fast to be resolved within the step, and Newmark's method stays stable
# with β = 1/4; below it β = 1/6 has half the error in the period.
_FAST = 1.0


class Torsion(NamedTuple):
    """Parameters of the torsion mode, in SI units."""

    stiffness: float  # k_t, N m/rad; 0: rigid
    damping: float  # d_t, N m s/rad
    inertia: float  # J_t, kg m²
    half_width: float  # w, m


class TwistMomentum(NamedTuple):
    """Momentum balance of the twist without other torques over a step: own ψ̇1 = constant + other torques."""

    own: float  # N m s/rad
    constant: float  # N m


@compilable
def is_rigid(torsion: Torsion) -> bool:
    """Whether the gate does not twist."""
    return torsion.stiffness == 0.0


@compilable
def share_at(torsion: Torsion, lateral: float) -> float:
    """Return y/w for a lateral position y [m], positive to the left; 0 for a rigid gate."""
    return 0.0 if torsion.stiffness == 0.0 else lateral / torsion.half_width


@compilable
def twist_momentum(torsion: Torsion, twist: float, rate: float, step: float) -> TwistMomentum:
    """Return the twist's momentum balance (inertia, spring, damper) over a step with linearly changing rate."""
    beta = 1.0 / 6.0
    if torsion.stiffness * step * step > _FAST * torsion.inertia:
        beta = 0.25
    own = torsion.inertia / step + beta * step * torsion.stiffness + 0.5 * torsion.damping
    constant = (torsion.inertia / step - 0.5 * torsion.damping) * rate
    constant -= torsion.stiffness * (twist + (0.5 - beta) * step * rate)
    return TwistMomentum(own, constant)
