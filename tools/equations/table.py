"""Table of the thesis's equations: the place of each in the plant, a change of it, and a test that detects that.

`where` is the function or class of liftgate_plant whose docstring names the equation. `text` occurs once in its
file, inside `where`; with `mutant` in its place the equation is another one, and `test` fails. Equations that the
thesis writes in vectors, or that are only intermediate steps, have no code of their own: `where` then contains the
code that follows from them, and `note` says so.
"""

from __future__ import annotations

from typing import NamedTuple


class Row(NamedTuple):
    """Equation of the thesis, with its place in the plant, its change and its test."""

    number: str
    says: str
    where: str  # module.name in plant/liftgate_plant
    text: str
    mutant: str
    test: str  # in tests/
    note: str = ""


_BODIES, _THESIS = "plant/test_bodies.py", "reference/test_thesis.py"
FRICTION = f"{_BODIES}::test_dry_friction_never_drives"
LOSSES = "plant/test_vehicles.py::test_derived_constants_of_the_suv_agree_with_hand_calculations"
COIL = f"{_BODIES}::test_a_coil_spring_pushes_by_its_compression_and_a_lost_one_not_at_all"
SEAL = f"{_BODIES}::test_the_seals_depth_ends_where_its_force_is_zero"
INVERSE = f"{_BODIES}::test_angle_and_length_are_inverse_and_the_lever_arm_is_their_slope"
HAND_CHECK = f"{_BODIES}::test_the_linkage_agrees_with_the_hand_calculation_wherever_the_hinge_is"
LINKAGE = f"{_THESIS}::test_length_and_lever_arm_of_the_actuator_agree_with_vector_geometry"
WEIGHT = f"{_THESIS}::test_the_weight_torque_agrees_with_its_cross_product"
SPRING = f"{_THESIS}::test_the_spring_torque_agrees_with_its_cross_product"
GEAR = f"{_THESIS}::test_motor_turns_and_actuator_extension_have_the_thesis_ratio"
PLAY = f"{_THESIS}::test_the_drive_force_acts_only_beyond_the_backlash"
SUM = f"{_THESIS}::test_the_gates_acceleration_agrees_with_the_sum_of_all_torques"
BACK = f"{_THESIS}::test_the_gates_force_accelerates_the_motor_back_by_the_spindles_lead"
MOTOR = f"{_THESIS}::test_a_motor_without_a_gate_obeys_its_state_equations"
RIGID = f"{_THESIS}::test_the_rigidly_joined_plant_agrees_with_the_third_order_model"

VECTOR = "a vector; the plant has its length and angle"
TURNED = "with α_0 for α: the road turns both points of the actuator alike"
BODIES = "departure: drive and gate are bodies of their own, joined by a force"

# fmt: off
TABLE = (
    # Motor.
    Row("3.1", "L di/dt + R i + c2Φ n − u = 0", "motor.solve_windings",
        "left.duty * supply_voltage - left.speed_constant", "left.duty * supply_voltage + left.speed_constant",
        MOTOR),
    Row("3.2", "2πJ dn/dt = c1Φ i − M_L − M_L0", "drive_step.balance",
        "inertia = 2.0 * math.pi * drive.inertia / step", "inertia = drive.inertia / step", MOTOR),
    Row("3.3", "M_L0 = (1 − η_M) M_0 sgn(n)", "transmission.coulomb_torque",
        "(1.0 - motor.efficiency) * motor.load_torque", "motor.efficiency * motor.load_torque", LOSSES),
    Row("3.4", "sgn(x) = −1, 0, 1", "friction.soft_threshold",
        "return drive - math.copysign(limit, drive)", "return drive + math.copysign(limit, drive)", FRICTION,
        "departure: set-valued at 0, so that a shaft at rest stays there"),
    # Gear.
    Row("3.5", "b = Δθ/2π", "vehicle.drive_of",
        "half_play=0.5 * tables.gear.backlash", "half_play=tables.gear.backlash", PLAY),
    Row("3.6", "n_G = n/i", "vehicle.drive_of",
        "travel = tables.spindle.lead / tables.gear.ratio", "travel = tables.spindle.lead", GEAR),
    Row("3.7", "J_G dω_G/dt + M_SL + M_GL0 = i M_L", "transmission.total_inertia",
        "gear.inertia / (gear.ratio * gear.ratio)", "gear.inertia / gear.ratio", BACK),
    Row("3.8", "M_GL0 = (1 − η_G) M_G0 sgn(n_G)", "transmission.coulomb_torque",
        "(1.0 - gear.efficiency) * gear.friction_torque", "gear.efficiency * gear.friction_torque", LOSSES),
    # Spindle.
    Row("3.9", "v_S = ω_G s_rev/2π", "vehicle.drive_of",
        "travel = tables.spindle.lead /", "travel = tables.spindle.lead / (2.0 * math.pi) /", GEAR),
    Row("3.10", "M_SL = (1 − η_S) M_S0 + F_S s_rev/2π", "vehicle.drive_of",
        "torque_per_force=travel / (2.0 * math.pi)", "torque_per_force=travel", BACK),
    Row("3.11", "M_S0 = F_S0 s_rev/2π sgn(ω_G)", "transmission.coulomb_torque",
        "/ (2.0 * math.pi * gear.ratio)", "/ gear.ratio", LOSSES),
    # Spring.
    Row("3.12", "F_F = F_F0 + k (l_max − l_S) − F", "spring.force",
        "spring.preload + spring.stiffness * compression", "spring.preload - spring.stiffness * compression",
        COIL),
    Row("3.13", "l_S = ∫ v_S dt", "dynamics.drive_force",
        "state.slip - place.extension", "state.slip + place.extension", PLAY,
        "departure: the spindle's way p ρ and the gate's l_S(φ) differ by play and give"),
    Row("3.14", "F = k_3 l_S beyond l_max, else 0", "dynamics.stop_torque",
        "return (closed - opened) * place.lever", "return (closed + opened) * place.lever", SUM,
        "departure: the penetration l_S − l_max, damped, and a closed stop"),
    # Gate.
    Row("3.15", "J_L φ̈ = M_S + M_F − M_W + M_2", "dynamics.torque_at",
        "+ body_torque(plant, load, state.gate_angle,", "- body_torque(plant, load, state.gate_angle,", SUM),
    Row("3.16", "F_S = M_S/r_AP", "dynamics.side_torque",
        "return force * place.lever + stop_torque", "return force + stop_torque", SUM),
    Row("3.17", "M_2 = r_F2 (F_20 − k_2 l_S), not below 0", "seal.depth",
        "return seal.force / seal.stiffness - extension", "return seal.force / seal.stiffness + extension", SEAL),
    Row("3.18", "J_L = m (L_L² + T²)/12 + m r²", "gate.inertia",
        "gate.thickness * gate.thickness) / 12.0", "gate.thickness * gate.thickness) / 3.0", HAND_CHECK),
    # Angles.
    Row("3.19", "2 s r_AP0 cos(φ + θ) = s² + r_AP0² − l²", "gate.length",
        "r * r - 2.0 * s * r * math.cos", "r * r + 2.0 * s * r * math.cos", HAND_CHECK),
    Row("3.20", "φ = −θ + arccos((s² + r_AP0² − (l_0 + l_S)²)/(2 s r_AP0))", "gate.angle_of_extension",
        "(2.0 * s * r)) - link.offset", "(2.0 * s * r)) + link.offset", INVERSE),
    Row("3.21", "α = α_0 − γ", "gate.weight_torque",
        "link.gravity_angle + slope", "link.gravity_angle - slope", WEIGHT),
    # Weight.
    Row("3.22", "r_GP = r_GP0 (cos(φ + β − α), sin(φ + β − α))", "gate.linkage",
        "gravity_angle=math.atan2(gy, gx)", "gravity_angle=math.atan2(gx, gy)", WEIGHT, VECTOR),
    Row("3.23", "r_GP0 = |GP − H|", "gate.linkage",
        "gravity_radius=math.hypot(gx, gy)", "gravity_radius=math.hypot(gx, 0.0)", HAND_CHECK),
    Row("3.24", "M_W = r_GP × F_W", "gate.weight_torque",
        "return moment * math.cos(", "return moment * math.sin(", WEIGHT,
        "a cross product; (3.26) is its size"),
    Row("3.25", "F_W = −F_W ŷ", "vehicle.plant_of",
        "vehicle.gate.mass * GRAVITY * link", "vehicle.gate.mass * link", WEIGHT,
        "a vector; its size m g is in the weight's moment"),
    Row("3.26", "M_W = −r_GP0 F_W cos(φ + β − α)", "gate.weight_torque",
        "math.cos(angle + link.gravity_angle", "math.cos(link.gravity_angle - angle", WEIGHT,
        "departure: without the sign, which (3.15) has too"),
    # Torque of the spring.
    Row("3.27", "r_AP = AP − H", "gate.linkage",
        "gate.gate_point[0] - hx", "gate.gate_point[0]", HAND_CHECK, VECTOR),
    Row("3.28", "r_AP = r_AP0 (cos(φ − α), sin(φ − α))", "gate.linkage",
        "theta = math.atan2(cx * ay - cy * ax,", "theta = math.atan2(cy * ax - cx * ay,", LINKAGE,
        f"{VECTOR}, {TURNED}"),
    Row("3.29", "r_AP0 = |AP − H|", "gate.linkage",
        "r = math.hypot(ax, ay)", "r = abs(ay)", HAND_CHECK),
    Row("3.30", "d̂ = (r_AP − (CP − H))/|r_AP − (CP − H)|", "gate.lever",
        " / length(s, r, link.offset, angle)", "", LINKAGE,
        "a vector; the lever has the division by its length"),
    Row("3.31", "F_d = F_F d̂", "dynamics.side_torque",
        "force += spring_force(drive", "force -= spring_force(drive", SUM,
        "a vector; F_F counts along the actuator"),
    Row("3.32", "M_F = r_AP × F_d", "gate_step.side_torque",
        "return LinearizedForce(r * force +", "return LinearizedForce(force +", SUM,
        "a cross product; the lever is its size by that of F_d"),
    Row("3.33", "M_F = r_AP × F_F (H − CP)/|r_AP − (CP − H)|", "gate.lever",
        "return s * r * math.sin", "return r * r * math.sin", LINKAGE,
        "a cross product; s = |CP − H| is in the lever"),
    Row("3.34", "M_F = F_F times (3.35)", "gate_step.side_torque",
        "push.constant + dynamics.spring_force", "push.constant - dynamics.spring_force", SUM),
    Row("3.35", "r_AP(φ) = r_AP0 ((H − CP)_y cos(φ − α) − (H − CP)_x sin(φ − α))/l", "gate.lever",
        "math.sin(angle + link.offset)", "math.sin(angle - link.offset)", LINKAGE,
        f"as s r_AP0 sin(φ + θ)/l, {TURNED}"),
    Row("3.36", "M_F = F_F r_AP(φ)", "dynamics.smooth_torque",
        "return springs * gate.lever(link, angle)", "return springs", SPRING),
    # Length of the actuator.
    Row("3.37", "l = |AP(φ) − CP|", "gate.length",
        "return math.sqrt(s * s + r * r", "return (s * s + r * r", LINKAGE, "by the law of cosines (3.19)"),
    Row("3.38", "AP(φ) = r_AP(φ) + H", "gate.linkage",
        "gate.body_point[1] - hy", "gate.body_point[1]", HAND_CHECK, "the hinge is the origin of all points"),
    Row("3.39", "l(φ) in coordinates", "gate.length",
        "math.cos(angle + theta)", "math.cos(angle - theta)", LINKAGE, "by the law of cosines (3.19)"),
    Row("3.40", "l = (3.35)'s numerator/r_AP(φ)", "gate.lever",
        "length(s, r, link.offset, angle)", "length(s, r, link.offset, 0.0)", INVERSE),
    # Acceleration of the gate.
    Row("3.41", "a_S = a_S d̂", "dynamics.drive_force",
        "- place.lever * place.rate", "+ place.lever * place.rate", SUM,
        f"{BODIES}: no acceleration is handed over, speeds along the actuator are compared"),
    Row("3.42", "a_S · Φ̂ = r_AP0 φ̈", "drive_step.stretch_in",
        "drive.travel * state.speed - middle.lever * side.rate,", "drive.travel * state.speed - side.rate,", SUM,
        f"{BODIES}: dl_S/dt = r_AP ω"),
    Row("3.43", "Φ̂ = (−sin(φ − α), cos(φ − α))", "dynamics.place_at",
        "gate.lever(link, angle))", "gate.lever(link, 0.0))", SUM,
        "a vector; the lever at φ has its angle to d̂"),
    Row("3.44", "φ̈ = a_S/(r_AP0 l) ((CP − H)_x sin(φ − α) − (CP − H)_y cos(φ − α))", "dynamics.outputs",
        "acceleration = torque / total_inertia", "acceleration = torque * total_inertia", SUM,
        f"{BODIES}: φ̈ is torque by inertia, with the change of the lever that this leaves out"),
    # State equations.
    Row("4.1", "ẋ1 = −R/L x1 − c2Φ/L x2 + u/L", "electrics.winding_of",
        "resistance, motor.inductance, by_speed, duty,", "-resistance, motor.inductance, by_speed, duty,", MOTOR),
    Row("4.2", "ẋ2 = (c1Φ x1 − M_L − (1 − η_M) M_L0)/2πJ", "drive_step.balance",
        "+ torque_constant * current - kappa", "- torque_constant * current - kappa", MOTOR),
    Row("4.3", "ẋ3 = x2", "drive_step.next_drive",
        "way = 0.5 * step * (state.speed + speed)", "way = step * (state.speed + speed)", MOTOR),
    Row("4.4", "M_L = (2πJ_G/i ẋ2 + M_SL + (1 − η_G) M_GL0)/i", "vehicle.drive_of",
        "inertia=transmission.total_inertia(tables.motor, tables.gear)", "inertia=tables.motor.rotor_inertia",
        MOTOR,
        "the motor, gear and spindle turn as one body"),
    Row("4.5", "M_SL = (1 − η_S) M_S0 + F_S s_rev/2π", "drive_step.balance",
        "- kappa * push.constant", "+ kappa * push.constant", BACK),
    Row("4.6", "F_S = (J_L φ̈ − M_F + M_W − M_2)/2r_AP", "integrate.new_speeds",
        "constant += torque_l.constant + torque_r.constant", "constant += torque_l.constant", SUM,
        f"{BODIES}: each drive's own, no halves"),
    Row("4.7", "φ̈ = s_rev/(i r_AP) ẋ2", "drive_step.balance",
        "lever * push.slope * rho", "push.slope * rho", SUM,
        f"{BODIES}; the change of the lever, which this drops, is in their path"),
    Row("4.8", "M_F = 2 r_AP F_F", "dynamics.smooth_torque",
        "springs += spring_force(plant.right", "springs -= spring_force(plant.right", SPRING),
    Row("4.9", "F_F = F_F0 + k l_max − k l_S − F", "spring.force",
        "compression = stroke - extension", "compression = stroke + extension", SPRING),
    Row("4.10", "M_W = r_GP F_W", "dynamics.body_torque",
        ") - gate.weight_torque(plant", ") + gate.weight_torque(plant", SPRING),
    Row("4.11", "J_tot ẋ2 = c1Φ x1 + s_rev/2πi F_F − s_rev/4πi r_GP/r_AP m g − M_tot", "integrate.new_speeds",
        "constant = carry + dynamics.body_torque", "constant = carry - dynamics.body_torque", RIGID,
        f"{BODIES}; this is their limit"),
    Row("4.12", "M_tot = (1 − η_M) M_0 + (1 − η_G) M_G0/i + (1 − η_S) M_S0/i", "transmission.coulomb_torque",
        "+ (1.0 - spindle.efficiency)", "- (1.0 - spindle.efficiency)", MOTOR),
    Row("4.13", "J_tot = 2πJ + J_G/i² + J_L (s_rev/(i r_AP))²", "dynamics.total_inertia",
        "return plant.gate_inertia + environment", "return 2.0 * plant.gate_inertia + environment", RIGID,
        "departure: its units are mixed; the limit is 2πJ + 2πJ_G/i² + J_L/4π (s_rev/(i r_AP))²"),
)
# fmt: on
