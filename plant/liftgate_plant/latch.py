"""The latch: without positions it holds the gate at φ = 0 until it is released, and engages again at φ = 0.

A latch with positions (`[latch] half` in the file) is a claw that holds a striker on the gate, s = r_l φ from
home:

    claw's spring    M_claw = r_l F_claw (1 − s/s_entry)        for s < s_entry; opens
    hook             M_hook = −r_l (k_l (s − q) + c_l (ṡ − q̇))   for s > q, closes; never positive

The pawl holds the claw in its half position, q = s_half, once the striker has come as far as s_half, and in its
full one, q = s_full, once it has come home. After a release the pawl is lifted with a delay and stays lifted for
some time; when it falls, it catches the claw in the position that the striker has reached. A cinching motor draws
a half closed claw home, automatically or on command, q = s_half − p, at a speed that the hook's spring limits.
Afterwards it returns to its own home, together with the hook if the claw is still half closed:

    ṗ = v_c (1 − k_l (s − q)/F_c) ≥ 0 while it pulls (a stalled gear does not let go),    ṗ = −v_c else, to p = 0

It pulls by s_entry at most.
"""

from __future__ import annotations

from typing import Annotated, NamedTuple

from liftgate_compiler import compilable
from liftgate_plant import contact
from liftgate_plant.contact import LinearizedForce
from liftgate_plant.motor import phi_functions
from liftgate_plant.quantity import Quantity, choice

CINCHES = ("none", "automatic", "commanded")
NO_CINCH, AUTOMATIC, COMMANDED = range(3)

# Positions in which the pawl holds the claw.
OPEN, HALF, FULL = 0.0, 1.0, 2.0


class Latch(NamedTuple):
    """Table `[latch]` of the vehicle file.

    The defaults, apart from that of `half`, are assumptions of a size that such latches have.
    """

    half: Annotated[
        float,
        Quantity("s_half", "m", 0.0, 0.1, "striker's distance from home in the half position; 0: no positions"),
    ] = 0.0  # fmt: skip
    full: Annotated[float, Quantity("s_full", "m", 0.0, 0.05, "the same in the full position")] = 0.0005
    entry: Annotated[float, Quantity("s_entry", "m", 1e-3, 0.2, "the same where the striker meets the claw")] = (
        0.020
    )
    distance: Annotated[float, Quantity("r_l", "m", 0.05, 10.0, "distance of the striker from the hinge")] = 1.0
    claw_force: Annotated[
        float, Quantity("F_claw", "N", 0.0, 1e4, "force of the claw's spring with the striker at home")
    ] = 40.0
    stiffness: Annotated[float, Quantity("k_l", "N/m", 1e5, 1e9, "stiffness of hook and striker")] = 2e6
    damping: Annotated[float, Quantity("c_l", "N s/m", 0.0, 1e6, "damping of hook and striker")] = 3e3
    release_time: Annotated[
        float, Quantity("", "s", 0.0, 5.0, "time from the release until the pawl is lifted")
    ] = 0.05
    hold_time: Annotated[
        float, Quantity("", "s", 0.0, 10.0, "time for which it stays lifted after the release")
    ] = 0.3
    cinch: Annotated[
        str, choice(CINCHES, "how a half closed latch is drawn home; commanded: by `latch_cinch`")
    ] = "none"
    cinch_speed: Annotated[
        float, Quantity("v_c", "m/s", 1e-4, 1.0, "speed of the striker without load, while it is drawn home")
    ] = 0.012
    cinch_force: Annotated[
        float, Quantity("F_c", "N", 1.0, 1e5, "force at the striker at which the cinching motor stalls")
    ] = 1200.0


class Claw(NamedTuple):
    """Constants of a latch, derived from its table by `claw_of`."""

    half: float  # m; 0: a latch without positions
    full: float
    entry: float
    distance: float
    spring: float  # F_claw/s_entry, N/m
    stiffness: float
    damping: float
    release_time: float  # s
    hold_time: float
    cinch: float  # one of NO_CINCH, AUTOMATIC, COMMANDED
    cinch_speed: float  # m/s
    cinch_force: float  # N


class LatchState(NamedTuple):
    """State of a latch with positions: claw, pull of the cinching motor, release timers."""

    claw: float  # OPEN, HALF, FULL
    pull: float  # m, p, travel of the cinching motor from its home
    driven: float  # s, how long the release has been driven
    lifted: float  # s, how long the pawl still stays lifted


NOT_LATCHED = LatchState(OPEN, 0.0, 0.0, 0.0)


def claw_of(latch: Latch) -> Claw:
    """Return the constants derived from the table `[latch]`."""
    return Claw(
        half=latch.half,
        full=latch.full,
        entry=latch.entry,
        distance=latch.distance,
        spring=latch.claw_force / latch.entry,
        stiffness=latch.stiffness,
        damping=latch.damping,
        release_time=latch.release_time,
        hold_time=latch.hold_time,
        cinch=float(CINCHES.index(latch.cinch)),
        cinch_speed=latch.cinch_speed,
        cinch_force=latch.cinch_force,
    )


# Latch without positions.


@compilable
def takes_up(angle: float, released: float) -> bool:
    """Whether a latch without positions catches a gate at an angle [rad]; `released`: 1.0 while driven open."""
    return angle <= 0.0 and released == 0.0


@compilable
def is_reached(angle: float, rate: float, rate_end: float, step: float) -> bool:
    """Whether a gate reaches the closed position within a step, from an angle [rad] above it."""
    return angle > 0.0 >= angle + 0.5 * step * (rate + rate_end)


@compilable
def rate_home(angle: float, rate: float, step: float) -> float:
    """Return the final rate [rad/s] of a step in which a gate reaches φ = 0 with a linearly changing rate."""
    return -2.0 * angle / step - rate


@compilable
def held_home(latched: bool) -> LatchState:
    """Return the state of a latch without positions, latched or open."""
    return LatchState(FULL if latched else OPEN, 0.0, 0.0, 0.0)


@compilable
def at_first(claw: Claw, latched: bool) -> LatchState:
    """Return the initial state of a latch with positions: fully closed, or as if released long ago."""
    driven = 0.0 if latched else claw.release_time
    return LatchState(FULL if latched else OPEN, 0.0, driven, 0.0)


# Latch with positions.


@compilable
def hook_place(claw: Claw, state: LatchState) -> float:
    """Return the hook's position q [m]: how far from the closed position the claw holds the striker."""
    return claw.full if state.claw == FULL else claw.half - state.pull


@compilable
def is_to_pull(claw: Claw, state: LatchState, cinched: float) -> bool:
    """Whether the cinching motor is to draw a half closed claw home; `cinched` above 0: it is commanded to."""
    wanted = claw.cinch == AUTOMATIC or (claw.cinch == COMMANDED and cinched > 0.0)
    return state.claw == HALF and wanted


@compilable
def yielding_of(claw: Claw) -> float:
    """Return the drop of the cinching motor's speed [m/s] per deflection [m] of the hook, v_c k_l/F_c."""
    return claw.cinch_speed * claw.stiffness / claw.cinch_force


@compilable
def bent_by(claw: Claw, state: LatchState, angle: float) -> float:
    """Return the hook's deflection s − q [m] at a gate angle [rad]; negative: no contact."""
    return claw.distance * angle - hook_place(claw, state)


@compilable
def loaded_speed(claw: Claw, bent: float) -> float:
    """Return the speed [m/s] of a pulling cinching motor at a deflection `bent` [m] of the hook."""
    free = claw.cinch_speed
    return min(free, max(0.0, free - yielding_of(claw) * bent))


@compilable
def pull_speed(claw: Claw, state: LatchState, angle: float, cinched: float) -> float:
    """Return the cinching motor's present speed dp/dt [m/s] at a gate angle [rad].

    The motor returns, with a negative speed, where it shall not pull.
    """
    if not is_to_pull(claw, state, cinched):
        return -claw.cinch_speed if state.pull > 0.0 else 0.0
    return loaded_speed(claw, bent_by(claw, state, angle))


@compilable
def hook_speed(claw: Claw, state: LatchState, angle: float, cinched: float) -> float:
    """Return the hook's cinching speed [m/s] home; negative: it returns; 0 unless the claw is half closed."""
    return pull_speed(claw, state, angle, cinched) if state.claw == HALF else 0.0


@compilable
def mean_pull(
    claw: Claw, state: LatchState, angle: float, rate: float, rate_end: float, cinched: float, step: float
) -> float:
    """Return the cinching motor's mean dp/dt [m/s] in a step from a gate angle [rad] with a linear rate [rad/s].

    While the motor pulls, the hook is deflected by b, db/dt = ṡ + v_c − y b with y = v_c k_l/F_c, which is solved
    for the mean of ṡ: the hook yields to the motor, and the gate follows it.
    """
    free = claw.cinch_speed
    if not is_to_pull(claw, state, cinched):
        return -min(free, state.pull / step)
    bent, yielding = bent_by(claw, state, angle), yielding_of(claw)
    way = step * (0.5 * claw.distance * (rate + rate_end) + free)
    share = 1.0
    if bent < 0.0:  # no contact at the start: pulls freely until it touches
        share = max(0.0, 1.0 + bent / way) if way > 0.0 else 0.0
        bent = 0.0
    _, phi1, phi2, _ = phi_functions(-yielding * share * step)
    mean = share * (phi1 * bent + phi2 * share * way)
    return loaded_speed(claw, mean)


@compilable
def pulled_force(
    claw: Claw, bent: float, rate: float, stiff: bool, step: float
) -> tuple[LinearizedForce, LinearizedForce]:
    """Return the hook's linear mean force [N] in a step while the cinching motor pulls, and final deflection [m].

    The hook yields to the motor; both results are linear in the striker's rate [m/s] at the end. The deflection b
    is that of `mean_pull`, for a linearly changing rate; as in `contact.push`, a stiff hook takes its force at the
    step's end, with the deflection that it has reached at the rate there.
    """
    free, yielding = claw.cinch_speed, yielding_of(claw)
    k, c = claw.stiffness, claw.damping
    e, phi1, phi2, phi3 = phi_functions(-yielding * step)
    if stiff:
        end = LinearizedForce(e * bent + phi1 * step * free, phi1 * step)
        by_bent = k - c * yielding
        return LinearizedForce(by_bent * end.constant + c * free, by_bent * end.slope + c), end
    start = step * (rate + free)
    end = LinearizedForce(e * bent + phi1 * start - phi2 * step * rate, phi2 * step)
    mean = LinearizedForce(phi1 * bent + phi2 * start - phi3 * step * rate, phi3 * step)
    damping = c / step
    constant = k * mean.constant + damping * (end.constant - bent)
    return LinearizedForce(constant, k * mean.slope + damping * end.slope), end


@compilable
def hook_force(claw: Claw, state: LatchState, angle: float, rate: float, cinched: float) -> float:
    """Return the force [N] with which the hook pulls the striker home.

    The gate is at `angle` [rad] with `rate` [rad/s], while a cinching motor may draw the hook or let it go.
    """
    if claw.half == 0.0 or state.claw == OPEN:
        return 0.0
    drawn = hook_speed(claw, state, angle, cinched)
    bent = bent_by(claw, state, angle)
    return contact.force(claw.stiffness, claw.damping, bent, claw.distance * rate + drawn)


@compilable
def claw_depth(claw: Claw, angle: float) -> float:
    """Return the distance [m] by which the striker has turned the claw against its spring."""
    return claw.entry - claw.distance * angle


@compilable
def torque(claw: Claw, state: LatchState, angle: float, rate: float, cinched: float) -> float:
    """Return the torque [N m] of the latch's hook and claw on the gate."""
    if claw.half == 0.0:
        return 0.0
    spring = contact.force(claw.spring, 0.0, claw_depth(claw, angle), 0.0)
    return claw.distance * (spring - hook_force(claw, state, angle, rate, cinched))


@compilable
def drawn_since(claw: Claw, state: LatchState, before: float, place: float, cinched: float, step: float) -> float:
    """Return the distance [m] by which the cinching motor draws a claw that is caught within the step.

    The striker moves linearly from `before` to `place` [m], without touching the hook: there is no load.
    """
    caught = LatchState(HALF, state.pull, state.driven, state.lifted)
    if before <= place or not is_to_pull(claw, caught, cinched):
        return 0.0
    left = (hook_place(claw, caught) - place) / (before - place)
    return min(1.0, max(0.0, left)) * step * claw.cinch_speed


@compilable
def next_latch(
    claw: Claw,
    state: LatchState,
    before: float,
    angle: float,
    pulling: float,
    cinched: float,
    released: float,
    step: float,
) -> LatchState:
    """Return the latch's state after a step in which the gate moves from `before` to `angle` [rad].

    `pulling` is the cinching motor's speed [m/s] in that step.
    """
    place = claw.distance * angle
    driven, lifted, is_driven = 0.0, max(0.0, state.lifted - step), False
    if released > 0.0:
        driven = state.driven + step
        is_driven = driven >= claw.release_time - 0.5 * step
    if is_driven:
        lifted = claw.hold_time
    pull = min(max(0.0, state.pull + step * pulling), claw.entry)
    held = state.claw
    if is_driven or lifted > 0.5 * step:
        held = OPEN
    elif place <= 0.0:
        held = FULL
    elif held == OPEN and place <= claw.half - pull:  # a striker outside a hook that is drawn home is not caught
        held = HALF
        drawn = drawn_since(claw, state, claw.distance * before, place, cinched, step)
        pull = min(pull + drawn, claw.entry)
    return LatchState(held, pull, driven, lifted)
