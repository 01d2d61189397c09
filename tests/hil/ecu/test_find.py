"""Check of an ECU's name before a run: valid names, and messages for others."""

from __future__ import annotations

from pathlib import Path

import pytest
from hil_support import issues_of

from liftgate_hil.ecu.find import adapter_for, check_ecu
from liftgate_hil.errors import ConfigError, printable
from liftgate_hil.plan.plan import plan_of
from liftgate_hil.plan.request import Job, RunRequest
from liftgate_hil.plan.setup import rig_from


@pytest.mark.parametrize(
    ("name", "told"),
    [
        (
            "ecu.c",
            "source code; its shared library is needed: cc -shared -fPIC -o ecu.so ecu.c; allowed: reference,",
        ),
        ("src/ecu.cpp", "source code; its shared library is needed: c++ -shared -fPIC -o ecu.so src/ecu.cpp; "),
        ("my_ecu.py", "a Python file; name its module and class: my_ecu:CLASS; allowed: "),
        ("my_ecu.py:Ecu", "a Python file; name its module and class: my_ecu:Ecu; allowed: "),
        ("my-ecu.py:Ecu", "a Python file, but no module, for its name; rename it with letters, digits and _; "),
        ("my_ecu.py:Ecu:Other", "a Python file; name its module and class: my_ecu:CLASS; allowed: "),
        (
            "../a b/my_ecu.py:Ecu",
            "a Python file; name its module and class: my_ecu:Ecu, with PYTHONPATH='../a b'; ",
        ),
        (".my_ecu:Ecu", "allowed: reference, the path of a shared library, MODULE:CLASS, or bus"),
        ("a\nb/nowhere.so", "no such file"),
        ("src/my_ecu.py:Ecu", "a Python file; name its module and class: src.my_ecu:Ecu; allowed: "),
        (
            "../my_ecu.py:Ecu",
            "a Python file; name its module and class: my_ecu:Ecu, with PYTHONPATH=..; allowed: ",
        ),
        (
            "program",
            "neither a shared library (.so) nor a Python class; a program of its own is reached by a bus; ",
        ),
        ("module_here", "a module; name its class, too: module_here:CLASS; allowed: "),
        ("mutant:no_such", "a mutant is run by liftgate-hil test and campaign; allowed: "),
        ("Referense", "did you mean reference? allowed: "),
        ("my_ecu", "a module; name its class, too: my_ecu:CLASS; allowed: "),
        ("no_ecu", "allowed: reference, the path of a shared library, MODULE:CLASS, or bus"),
        ("no_ecu.py:Ecu", "no_ecu.py: no such file; allowed: "),
        ("nowhere.so", "no such file"),
        ("no_such.part:Ecu", "no module no_such in "),
    ],
)
def test_an_unknown_ecu_name_is_reported_with_a_suggestion(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, told: str
) -> None:
    here = tmp_path / "here"
    here.mkdir()
    monkeypatch.chdir(here)
    for each in (
        "program",
        "module_here.py",
        "my_ecu.py",
        "my-ecu.py",
        "src/my_ecu.py",
        "../my_ecu.py",
        "../a b/my_ecu.py",
    ):
        Path(each).parent.mkdir(exist_ok=True)
        Path(each).touch()
    (issue,) = issues_of(check_ecu, name)
    assert issue.startswith(f"`ecu` {printable(name)}: {told}")
    assert issues_of(plan_of, Job(RunRequest("anti_trap", name))) == [issue]  # before anything runs


def test_a_missing_class_is_reported_with_the_classes_of_the_module(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "misspelt_ecu.py").write_text("from pathlib import Path\nclass Door: ...\n")
    with pytest.raises(
        ConfigError, match=r"misspelt_ecu \(/.*/misspelt_ecu\.py\) has no Dor; allowed: misspelt_ecu:Door$"
    ):
        adapter_for("misspelt_ecu:Dor", rig_from("liftgate"), 2)


def test_existing_libraries_modules_and_objects_are_accepted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("ecu.so.1").touch()
    Path("own_ecu.py").touch()
    for name in ("reference", "bus", Path("ecu.so.1"), "own_ecu:Ecu", "json:loads", object()):
        check_ecu(name)


def test_messages_name_an_ecu_class_as_given_and_not_by_its_repr(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "named_ecu.py").write_text("class Ecu:\n    def __repr__(self):\n        return 'step'\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    assert issues_of(adapter_for, "named_ecu:Ecu", rig_from("liftgate"), 2) == [
        "`ecu` named_ecu:Ecu: no step(); allowed: an object with step(now_s, frames) -> frames"
    ]
