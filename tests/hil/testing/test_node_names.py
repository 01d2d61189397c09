"""Names of expectations within pytest's node ids, which pytest splits at `[` and `::`."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

from hypothesis import given
from hypothesis import strategies as st

from liftgate_hil.testing.plugin import node_names

# Each fails; brackets, colons, and a name that another one's becomes.
ODD = ("force [N]", "force (N)", "Bus::Signal", "[a] b::c", "d]", "e:", "::f", "plain")


@given(st.lists(st.text(st.sampled_from("ab[]():. 2\n"), min_size=1), unique=True, max_size=6))
def test_every_expectation_has_a_unique_node_name(names: list[str]) -> None:
    found = node_names(names)
    assert len(set(found)) == len(found) == len(names)
    for name, own in zip(names, found, strict=True):
        assert not re.search(r"::|[\[\]\n]", own)
        if not re.search(r"::|[\[\]\n]", name):
            assert own == name


def pytest_in(folder: Path, *arguments: str) -> str:
    """Run pytest in a folder; return all that it prints."""
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:xdist", "-p", "no:randomly", *arguments]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=600, check=False)
    return done.stdout + done.stderr


def test_failed_expectations_rerun_with_lf_and_by_id_and_appear_in_junit(tmp_path: Path) -> None:
    text = "duration = 0.1\ninitial = 30\n"
    for name in ODD:
        text += f'[[expect]]\nname = "{name}"\nalways = "time_s < 0.05"\n'
    text += '[[expect]]\nname = "[passes]"\nalways = "time_s > 0"\n'
    (tmp_path / "test_odd.toml").write_text(text)
    (tmp_path / "pytest.ini").write_text("[pytest]\n")
    assert f"{len(ODD)} failed, 1 passed" in pytest_in(tmp_path, "--junit-xml=out.xml")
    again = pytest_in(tmp_path, "--lf")
    assert f"{len(ODD)} failed" in again
    assert "passed" not in again
    root = ElementTree.parse(tmp_path / "out.xml").getroot()
    cases = list(root.iter("testcase"))
    assert {each.get("classname") for each in cases} == {"test_odd.toml"}
    assert [each.get("name") for each in cases] == node_names([*ODD, "[passes]"])
    told = [each.find("properties/property[@name='expectation']") for each in cases]
    names = [each.get("name") if own is None else own.get("value") for each, own in zip(cases, told, strict=True)]
    assert names == [*ODD, "[passes]"]
    ids = [f"test_odd.toml::{each}" for each in node_names(ODD)]
    assert f"{len(ODD)} failed" in pytest_in(tmp_path, *ids)
