"""Units in a rig: from the database or the rig; a missing or contradictory unit is refused."""

from __future__ import annotations

from pathlib import Path

import pytest
from hil_support import database_of, decoded, issues_of, rig_of, transmitted, write_rig

from liftgate_hil.config.rig import Rig, load_rig
from liftgate_hil.signals import BUS_OUTPUTS, OUT, OUTPUT_COUNT

BODY = """BO_ 256 Cmd: 8 ECU
 SG_ Duty : 0|16@1- (0.01,0) [-100|100] "%" Gate
 SG_ Dir : 32|4@1+ (1,0) [0|15] "" Gate
 SG_ Bare : 36|4@1+ (1,0) [0|15] "" Gate
 SG_ Alive : 40|8@1+ (1,0) [0|255] "" Gate
 SG_ Pwm : 48|16@1+ (0.01,0) [0|100] "%" Gate
BO_ 512 Out: 8 Gate
"""
LABELS = 'VAL_ 256 Dir 0 "coast" 1 "open" 2 "close" 3 "brake" ;\n'
INPUTS = '[inputs]\nleft_duty = "Cmd.Duty"\n'


def database(unit: str, place: str = "0|32@1- (0.5,0) [0|0]") -> str:
    return database_of(f'{BODY} SG_ X : {place} "{unit}" ECU\n') + LABELS


def rig(output: str, inputs: str = INPUTS) -> str:
    return f'dbc = "their.dbc"\n{inputs}[outputs]\n{output}\n'


def faults(folder: Path, text: str, content: str) -> list[str]:
    return [
        issue.removeprefix(f"{folder / 'their.toml'}: ")
        for issue in issues_of(load_rig, write_rig(folder, content, text))
    ]


def sent(rig: Rig, quantity: str, value: float) -> float:
    """Return the value that cantools reads of a quantity, in the database's unit."""
    values = [float("nan")] * OUTPUT_COUNT
    values[getattr(OUT, quantity)] = value
    _, frames = transmitted(rig.output_config(), values)
    (row,) = decoded(rig, frames, "Out")
    return float(row["X"])


@pytest.mark.parametrize(
    ("quantity", "unit", "ours", "theirs"),
    [
        ("left_current", "A", 2.5, 2.5),
        ("left_current", "mA", 2.5, 2500.0),
        ("left_current", "Amps", -2.5, -2.5),
        ("gate_angle", "rad", 28.64788975654116, 0.5),
        ("gate_angle", "Grad", 28.5, 28.5),
        ("gate_angle", "°", 28.5, 28.5),
        ("true_left_speed", "U/min", 50.0, 3000.0),
        ("terminal_voltage", "mV", 12.5, 12500.0),
        ("ambient_temperature", "K", 20.35, 293.5),
        ("gate_acceleration", "g", 9.80665, 1.0),
        ("true_left_duty", "%", 0.5, 50.0),
        ("left_hall_count", "", 7.5, 7.5),
        ("left_hall_count", "Imp", 7.5, 7.5),
        ("lateness_p50", "ms", 1500.0, 1.5),
    ],
)
def test_a_quantity_is_sent_in_the_databases_unit(
    tmp_path: Path, quantity: str, unit: str, ours: float, theirs: float
):
    loaded = rig_of(tmp_path, database(unit), rig(f'{quantity} = "Out.X"'))
    assert sent(loaded, quantity, ours) == pytest.approx(theirs)


@pytest.mark.parametrize(
    ("quantity", "unit", "said"),
    [
        ("left_current", "V", "Out.X is in 'V', a unit of voltage; allowed: unit = 'A' | 'mA'"),
        ("left_current", "", "Out.X has no unit in the database; allowed: unit = 'A' | 'mA'"),
        ("left_current", "0.1 A", "Out.X is in '0.1 A', which is no known unit; allowed: unit = "),
        ("left_hall_speed", "rpm", "or the motor's speed, true_left_speed"),
        ("left_hall_count", "U", "no known unit; allowed: unit = '1'"),
        ("true_left_duty", "", "has no unit in the database; allowed: unit = '1' | '%'"),
        ("road_slope", "%", "a unit of share"),
        ("gate_angle", "degC", "a unit of temperature"),
    ],
)
def test_a_wrong_unknown_or_missing_unit_is_refused(tmp_path: Path, quantity: str, unit: str, said: str):
    (fault,) = faults(tmp_path, rig(f'{quantity} = "Out.X"'), database(unit))
    assert fault.startswith(f"outputs.{quantity}: ")
    assert said in fault
    assert "or scale and offset" in fault


@pytest.mark.parametrize(
    ("unit", "keys", "theirs"),
    [
        ("", 'unit = "mA"', 2500.0),
        ("V", 'unit = "mA"', 2500.0),
        ("", "scale = 0.001", 2500.0),
        ("mA", "scale = 1", 2.5),  # the user knows better
        ("V", "scale = -0.5", -5.0),
        ("", 'unit = "mA", scale = -1', -2500.0),
        ("", 'unit = "mA", offset = 500', 2000.0),
    ],
)
def test_unit_and_scale_of_the_rig_override_the_databases(tmp_path: Path, unit: str, keys: str, theirs: float):
    text = rig(f'left_current = {{ signal = "Out.X", {keys} }}')
    assert sent(rig_of(tmp_path, database(unit), text), "left_current", 2.5) == theirs


@pytest.mark.parametrize(
    ("keys", "key", "said"),
    [
        ('unit = "V"', "outputs.left_current", "a unit of voltage"),
        ('unit = "x"', "outputs.left_current", "no known unit"),
        ('unit = "?"', "outputs.left_current", "no known unit"),
        ("unit = 3", "outputs.left_current.unit", "allowed: a unit"),
        ("saturates = 3", "outputs.left_current.saturates", "allowed: true or false"),
        ("values = { open = 1 }, scale = 2", "outputs.left_current.scale", "without values"),
    ],
)
def test_invalid_or_contradictory_keys_of_a_mapping_are_refused(tmp_path: Path, keys: str, key: str, said: str):
    text = rig(f'left_current = {{ signal = "Out.X", {keys} }}')
    issues = faults(tmp_path, text, database("A"))
    assert any(issue.startswith(f"{key}: ") and said in issue for issue in issues), issues


def direction(signal: str) -> str:
    return rig('left_current = "Out.X"', INPUTS + f"left_direction = {signal}\n")


def test_labels_equal_to_those_of_the_quantity_need_no_values(tmp_path: Path):
    (_, wire) = rig_of(tmp_path, database("A"), direction('"Cmd.Dir"')).inputs
    assert wire.values is None
    content = database("A").replace('1 "open" 2 "close"', '2 "Open" 1 "CLOSE"')
    (_, wire) = rig_of(tmp_path, content, direction('"Cmd.Dir"')).inputs
    assert wire.values == {"coast": "coast", "open": "Open", "close": "CLOSE", "brake": "brake"}


@pytest.mark.parametrize(("signal", "said"), [("Dir", "the labels 0 'coast', 1 'up'"), ("Bare", "no value table")])
def test_an_enumeration_with_other_labels_or_none_needs_values(tmp_path: Path, signal: str, said: str):
    content = database("A").replace('"open"', '"up"')
    (fault,) = faults(tmp_path, direction(f'"Cmd.{signal}"'), content)
    assert said in fault
    assert "allowed: values = { coast = …, open = …, close = …, brake = … }" in fault
    given = f'{{ signal = "Cmd.{signal}", values = {{ open = 1, close = 2, coast = 0 }} }}'
    rig_of(tmp_path, content, direction(given))


def test_an_unsigned_duty_needs_a_direction(tmp_path: Path):
    unsigned = rig('left_current = "Out.X"', '[inputs]\nleft_duty = "Cmd.Pwm"\n')
    (fault,) = faults(tmp_path, unsigned, database("A"))
    assert fault.startswith("inputs.left_direction: missing, and Cmd.Pwm is 0 to 100 %, so the motor")
    rig_of(tmp_path, database("A"), unsigned.replace("[outputs]", 'left_direction = "Cmd.Dir"\n[outputs]'))
    centred = database("A").replace("(0.01,0) [0|100]", "(0.01,-100) [-100|100]")
    rig_of(tmp_path, centred, unsigned)


@pytest.mark.parametrize("option", ["counter", "checksum"])
def test_an_input_mapped_to_its_counter_or_checksum_is_refused(tmp_path: Path, option: str):
    panel = 'snow_mass = { signal = "Cmd.Alive", scale = 1 }\n'
    text = rig('left_current = "Out.X"', INPUTS + panel) + f'[messages.Cmd]\n{option} = "Alive"\n'
    (fault,) = faults(tmp_path, text, database("A"))
    assert f"Cmd.Alive carries the {option} too" in fault


def test_counter_and_checksum_in_the_same_signal_are_refused(tmp_path: Path):
    text = rig('left_current = "Out.X"') + '[messages.Cmd]\ncounter = "Alive"\nchecksum = "Alive"\n'
    (fault,) = faults(tmp_path, text, database("A"))
    assert "messages.Cmd: Alive is the counter and the checksum" in fault


@pytest.mark.parametrize("option", ["counter", "checksum"])
def test_a_multiplexed_counter_or_checksum_is_refused(tmp_path: Path, option: str):
    content = database("A").replace("SG_ Bare :", "SG_ Bare M :").replace("SG_ Alive :", "SG_ Alive m1 :")
    text = rig('left_current = "Out.X"') + f'[messages.Cmd]\n{option} = "Alive"\n'
    (fault,) = faults(tmp_path, text, content)
    assert "messages.Cmd: Alive is in some frames only; allowed: a signal" in fault


def test_two_inputs_may_read_the_same_signal(tmp_path: Path):
    text = rig('left_current = "Out.X"', INPUTS + 'right_duty = "Cmd.Duty"\n')
    assert len(rig_of(tmp_path, database("A"), text).inputs) == 2


@pytest.mark.parametrize("identifier", [0x7DF, 0x7E0, 0x7EF, 0x80000000 | 0x18DA10F1])
def test_sent_messages_with_identifiers_of_diagnostics_are_refused(tmp_path: Path, identifier: int):
    content = database("A").replace("BO_ 512", f"BO_ {identifier}")
    (fault,) = faults(tmp_path, rig('left_current = "Out.X"'), content)
    assert "allowed: none that cars use for diagnostics" in fault
    # Another's frame there is read like any other.
    rig_of(
        tmp_path,
        database("A").replace("BO_ 256", "BO_ 2016").replace("VAL_ 256", "VAL_ 2016"),
        rig('left_current = "Out.X"'),
    )


def test_the_shipped_rig_converts_only_the_ages_of_edges_from_microseconds():
    from liftgate_hil.plan.setup import rig_from

    shipped = rig_from("liftgate")
    for wire in (*shipped.inputs, *shipped.outputs):
        scale = 1e-6 if "Age" in wire.signal else 1.0  # µs, as a timer has it
        assert (wire.scale, wire.offset, wire.values) == (scale, 0.0, None)
    assert {wire.quantity for wire in shipped.outputs} <= {*BUS_OUTPUTS}


def test_a_former_name_of_a_quantity_is_refused_with_its_present_name(tmp_path: Path):
    """All former names, one line each, without the list of names that an unknown name gets."""
    names = [each.removeprefix("true_") for each in BUS_OUTPUTS if each.startswith("true_")]
    old = [each for each in names if each not in BUS_OUTPUTS]
    assert {"left_speed", "right_voltage", "gate_rate", "pinch_force", "time"} <= {*old}
    text = "\n".join(f'{each} = "Out.X"' for each in old)
    path = write_rig(tmp_path, database("A"), f'dbc = "their.dbc"\n[inputs]\n[outputs]\n{text}\n')
    told = [line for line in issues_of(load_rig, path) if ": outputs." in line]
    assert told == [
        f"{path}: outputs.{each}: no sensor measures it, so it is called true_{each} now; allowed: true_{each}"
        for each in old
    ]


def test_a_direction_with_neither_open_nor_close_is_refused(tmp_path: Path) -> None:
    """With a direction the sign of the duty is ignored, so that such a motor would never be driven."""
    wired = '[inputs]\nleft_duty = "Cmd.Pwm"\nleft_direction = { signal = "Cmd.Dir", values = {VALUES} }\n'
    one_way = rig('left_current = "Out.X"', wired.replace("VALUES", "coast = 0, open = 1"))
    rig_of(tmp_path, database("A"), one_way)
    (fault,) = faults(tmp_path, one_way.replace("open = 1", "brake = 1"), database("A"))
    assert "inputs.left_direction.values: coast, brake: the motor could never be driven" in fault
