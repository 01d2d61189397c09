"""Cycle and time-out of a message from its send type, its cycle in the database, and the rig."""

from __future__ import annotations

import cantools
import pytest
from cantools.database.can import Message

from liftgate_hil.codec.protection import MessageOptions
from liftgate_hil.codec.sending import SendType, cycle_of, send_type_of, timeout_of

DBC = """BU_: A B
BO_ 1 M: 8 A
 SG_ S : 0|8@1+ (1,0) [0|1] "" B
 SG_ T : 8|8@1+ (1,0) [0|1] "" B
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_DEF_ "GenMsgCycleTime" 100;
"""
TYPE = 'BA_DEF_ BO_ "GenMsgSendType" ENUM "{name}","Other";\nBA_DEF_DEF_ "GenMsgSendType" "Other";\n'
SIGNALS = (
    'BA_DEF_ SG_ "GenSigSendType" ENUM "Cyclic","OnWrite","OnChange","IfActive","NoSigSendType";\n'
    'BA_DEF_DEF_ "GenSigSendType" "NoSigSendType";\n'
)
BY_DATABASE = MessageOptions()


def message(more: str = "") -> Message:
    (found,) = cantools.database.load_string(DBC + more, "dbc").messages
    return found


def sent(name: str) -> Message:
    return message(TYPE.format(name=name) + 'BA_ "GenMsgSendType" BO_ 1 0;\n')


@pytest.mark.parametrize(
    ("name", "meant"),
    [
        ("Cyclic", SendType.CYCLIC),
        ("cyclicX", SendType.CYCLIC),
        ("cyclicAndSpontaneousWithDelay", SendType.CYCLIC),
        ("cyclicWithRepeatOnDemand", SendType.CYCLIC),
        ("FixedPeriodic", SendType.CYCLIC),
        ("EventPeriodic", SendType.CYCLIC),
        ("NoMsgSendType", SendType.CYCLIC),
        ("NotUsed", SendType.CYCLIC),
        ("spontaneous", SendType.EVENT),
        ("spontanX", SendType.EVENT),
        ("spontaneousWithDelay", SendType.EVENT),
        ("OnWrite", SendType.EVENT),
        ("OnChangeWithRepetition", SendType.EVENT),
        ("Event", SendType.EVENT),
        ("On_Request", SendType.EVENT),
        ("acyclic", SendType.EVENT),
        ("Not cyclic", SendType.EVENT),
        ("IfActive", SendType.IF_ACTIVE),
        ("cyclicIfActive", SendType.IF_ACTIVE),
        ("cyclicIfActiveAndSpontaneousWD", SendType.IF_ACTIVE),
        ("EnabledPeriodic", SendType.IF_ACTIVE),
    ],
)
def test_send_type_names_have_the_meaning_that_makers_give_them(name: str, meant: SendType):
    found = sent(name)
    assert send_type_of(found, BY_DATABASE) is meant
    assert cycle_of(found, BY_DATABASE) == (0.0 if meant is SendType.EVENT else 100.0)
    assert timeout_of(found, BY_DATABASE) == (300.0 if meant is SendType.CYCLIC else 0.0)


def test_a_message_without_a_send_type_has_the_default_cycle():
    assert cycle_of(message(), BY_DATABASE) == 100.0
    assert timeout_of(message(), BY_DATABASE) == 300.0
    assert cycle_of(message('BA_ "GenMsgCycleTime" BO_ 1 0;\n'), BY_DATABASE) == 0.0


def test_a_default_send_type_applies_unless_the_message_has_its_own():
    default = TYPE.format(name="Cyclic").replace('"Other"', '"OnChange"')
    assert send_type_of(message(default), BY_DATABASE) is SendType.EVENT
    assert send_type_of(message(default + 'BA_ "GenMsgSendType" BO_ 1 0;\n'), BY_DATABASE) is SendType.CYCLIC


def test_a_cycle_in_the_rig_makes_an_event_message_cyclic():
    own = MessageOptions(cycle_ms=20.0)
    assert (cycle_of(sent("OnChange"), own), timeout_of(sent("OnChange"), own)) == (20.0, 60.0)


@pytest.mark.parametrize(
    ("types", "meant"),
    [
        ((1, 2), SendType.EVENT),
        ((1, 0), SendType.CYCLIC),
        ((1, 3), SendType.IF_ACTIVE),
        ((4, 2), SendType.EVENT),
        ((4, 4), SendType.CYCLIC),
    ],
)
def test_a_message_without_a_send_type_takes_it_from_its_signals(types: tuple[int, int], meant: SendType):
    own = [f'BA_ "GenSigSendType" SG_ 1 {name} {number};\n' for name, number in zip("ST", types, strict=True)]
    signals = SIGNALS + "".join(own)
    assert send_type_of(message(signals), BY_DATABASE) is meant
    undecided = TYPE.format(name="NoMsgSendType") + 'BA_ "GenMsgSendType" BO_ 1 0;\n'
    assert send_type_of(message(signals + undecided), BY_DATABASE) is meant
    cyclic = TYPE.format(name="cyclic") + 'BA_ "GenMsgSendType" BO_ 1 0;\n'
    assert send_type_of(message(signals + cyclic), BY_DATABASE) is SendType.CYCLIC
