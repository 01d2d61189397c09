"""Check of the package without a checkout: `python -m tools.check_package`, or `make test-package`.

Builds sdist and wheel, compares the wheel's contents with the sources, installs it into an empty environment and
uses it in a folder that has packages named like the checkout's folders; the sdist, which must build the same
wheel, is installed in its place. Needs a package index for dependencies.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path, PurePosixPath

from packaging.metadata import Metadata

ROOT = Path(__file__).resolve().parents[1]
DECOYS = ("hil", "plant", "configs", "dbc", "tools", "tests", "can", "numpy")
PARTS = {  # in the checkout → in the wheel
    "hil": "",
    "plant": "",
    "dbc": "liftgate_hil/_data/dbc",
    "configs": "liftgate_hil/_data/configs",
    "tools/ecu": "liftgate_hil/_data/ecu",
}


def run(*command: str | Path, cwd: Path = ROOT, env: Mapping[str, str] | None = None, code: int = 0) -> str:
    """Run a command and return its output; exit this program if the command's exit code is not `code`."""
    started = time.monotonic()
    done = subprocess.run(
        [str(each) for each in command],
        cwd=cwd,
        env=env,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    print(f"{time.monotonic() - started:6.1f} s  {' '.join(map(str, command))}", flush=True)
    if done.returncode != code:
        sys.exit(f"{done.stdout}\ncheck_package: exit code {done.returncode}, not {code}")
    return done.stdout


def expect(is_so: object, what: str) -> None:
    """Exit this program with a message if a condition is not met."""
    if not is_so:
        sys.exit(f"check_package: not so: {what}")


def build(folder: Path) -> tuple[Path, Path]:
    """Build the sdist, and the wheel from it, which must equal the wheel built from the checkout."""
    run(sys.executable, "-m", "build", "--outdir", folder, ROOT)
    run(sys.executable, "-m", "build", "--wheel", "--outdir", folder / "direct", ROOT)
    (sdist,), (wheel,) = folder.glob("*.tar.gz"), folder.glob("*.whl")
    direct = folder / "direct" / wheel.name
    expect(contents(wheel) == contents(direct), "the sdist builds the same wheel as the checkout")
    return sdist, wheel


def contents(wheel: Path) -> dict[str, bytes]:
    """Return the content of every file in a wheel, by name."""
    with zipfile.ZipFile(wheel) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def sources() -> dict[str, bytes]:
    """Return the files that a wheel must contain, by path in it: those of PARTS that git does not ignore."""
    listed = run("git", "ls-files", "--cached", "--others", "--exclude-standard", *PARTS)
    held = {}
    for name in map(PurePosixPath, listed.splitlines()):
        part = next(each for each in PARTS if name.is_relative_to(each))
        if (ROOT / name).is_file():  # git lists deleted files, too
            held[str(PurePosixPath(PARTS[part], name.relative_to(part)))] = (ROOT / name).read_bytes()
    return held


def check_contents(wheel: Path) -> None:
    """Check that the wheel contains all sources, unchanged, and nothing else."""
    held, wanted = contents(wheel), sources()
    for name in ("liftgate_hil/py.typed", "liftgate_plant/py.typed", "liftgate_compiler/py.typed"):
        expect(name in wanted, f"{name} among the sources")
    packed = {name for name in held if ".dist-info/" not in name}
    expect(packed == set(wanted), f"the sources, all and alone: {sorted(packed ^ set(wanted))}")
    changed = [name for name in wanted if held[name] != wanted[name]]
    expect(not changed, f"packed as they are: {changed}")


def check_metadata(wheel: Path) -> None:
    """Check that an index would accept the metadata, and that they agree with pyproject.toml."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    held = contents(wheel)
    (name,) = (each for each in held if each.endswith(".dist-info/METADATA"))
    metadata = Metadata.from_email(held[name], validate=True)
    expect(str(metadata.version) == project["version"], "the version")
    expect(metadata.name == project["name"], "the name")
    expect(metadata.summary == project["description"], "the summary")
    expect(metadata.description_content_type == "text/markdown", "a readme in Markdown")
    expect((metadata.description or "").startswith(f"# {project['name']}"), "the readme")
    expect(set(project["classifiers"]) <= set(metadata.classifiers or ()), "the classifiers")
    for licence in ROOT.glob("LICEN[CS]E*"):
        expect(licence.name in (metadata.license_files or ()), f"{licence.name} in the metadata")
        expect(any(each.endswith(f"/{licence.name}") for each in held), f"{licence.name}")
    scripts = next(held[each].decode() for each in held if each.endswith("entry_points.txt"))
    expect("liftgate-hil = liftgate_hil.__main__:main" in scripts, "the command")


class Installation:
    """Installation of the package in an environment of its own, with a folder to use it in."""

    def __init__(self, artifact: Path, folder: Path) -> None:
        self.work = folder / "work"
        for name in DECOYS:
            (self.work / name).mkdir(parents=True)
            (self.work / name / "__init__.py").write_text("raise SystemExit('not ours')\n")
        binaries = folder / "environment/bin"
        kept = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
        self.env = {
            **kept,
            "PATH": f"{binaries}{os.pathsep}{kept['PATH']}",
        }  # the user's cache is kept: it finds machine code of the same sources wherever they are
        run(sys.executable, ROOT / "tools/make_venv.py", folder / "environment")
        self.pip("install", "--no-compile", str(artifact))
        self.pip("check")

    def pip(self, *arguments: str) -> None:
        """Run pip in the environment."""
        self.call("python", "-m", "pip", "--quiet", "--disable-pip-version-check", *arguments)

    def call(self, *command: str, within: str = ".", code: int = 0) -> str:
        """Run a command of the environment in the folder `work` and return its output."""
        return run(*command, cwd=self.work / within, env=self.env, code=code)


def check_use(installed: Installation, version: str) -> None:
    """Check a user's first steps: version, help, the demo, `init`, the C ECU and the copied tests."""
    call, work = installed.call, installed.work
    expect(call("liftgate-hil", "--version") == f"liftgate-hil {version}\n", "--version")
    expect("\n  init " in call("python", "-m", "liftgate_hil", "--help"), "init in the overview")
    output = call("liftgate-hil", "demo", "--clock", "free", "--output", ".")
    expect("reversing" in output, "a reversal in the demo")
    for kind in ("log", "csv", "png"):
        expect((work / f"demo.{kind}").stat().st_size > 0, f"demo.{kind}")
    call("liftgate-hil", "init", "x")
    call("liftgate-hil", "init", "x", code=2)
    call(
        *("liftgate-hil", "--bus", "virtual:x", "--clock", "free", "--duration", "0.1"),
        *("--vehicle", "vehicle.toml", "--rig", "rig.toml", "--scenario", "scenario.toml"),
        within="x",
    )
    if shutil.which("make") and shutil.which("cc"):
        call("make", "-C", "ecu", within="x")
    else:
        print("NOT RUN: the copied ECU's Makefile: no C compiler or make here")
    installed.pip("install", "--no-compile", "pytest")
    call("pytest", within="x")
    if shutil.which("make") and shutil.which("cc"):
        call(
            "liftgate-hil",
            "demo",
            "--clock",
            "free",
            "--no-record",
            "--ecu",
            "x/ecu/build/liftgate-ecu.so",
            "--duration",
            "5",
        )


def main(arguments: Sequence[str] | None = None) -> None:
    """Build the package, and check its contents, its metadata and its use."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.parse_args(arguments)
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    with tempfile.TemporaryDirectory(prefix="liftgate-package-") as name:
        folder = Path(name)
        sdist, wheel = build(folder / "dist")
        check_contents(wheel)
        check_metadata(wheel)
        installed = Installation(wheel, folder / "installed")
        check_use(installed, version)
        installed.pip("uninstall", "--yes", "liftgate-hil")
        installed.pip("install", "--no-deps", str(sdist))
        expect(
            installed.call("liftgate-hil", "--version") == f"liftgate-hil {version}\n", "--version of the sdist"
        )
    print(f"check_package: {sdist.name} and {wheel.name} work away from the checkout")


if __name__ == "__main__":
    main()
