"""Make a virtual environment: `python3 tools/make_venv.py FOLDER`.

A Python with which the project was not tried is refused (`requires-python` of pyproject.toml).

Debian and Ubuntu ship Python without `ensurepip` unless python3-venv is installed. If it is missing, the package
is installed where that is possible; elsewhere the program ends with a message that names the package.
"""

import os
import re
import shutil
import subprocess
import sys
import venv
from pathlib import Path

PROJECT = Path(__file__).resolve().parent.parent / "pyproject.toml"


def check_version(version: tuple) -> None:
    """Exit with a message where the project was not tried with a version (major, minor) of Python."""
    text = PROJECT.read_text(encoding="utf-8")
    lowest, end = re.search(r'^requires-python = ">=3\.(\d+),<3\.(\d+)"$', text, re.MULTILINE).groups()
    if not (3, int(lowest)) <= version < (3, int(end)):
        sys.stderr.write(
            f"make_venv: {sys.executable} is Python {version[0]}.{version[1]}; "
            f"allowed: 3.{lowest} to 3.{int(end) - 1} (make setup PYTHON=python3.{int(end) - 1})\n"
        )
        sys.exit(2)


def has_ensurepip() -> bool:
    """Return whether `venv` can put pip into an environment."""
    return (
        subprocess.run([sys.executable, "-c", "import ensurepip"], check=False, capture_output=True).returncode
        == 0
    )


def install_venv_package() -> None:
    """Install Debian's package that contains `ensurepip`; exit with a message if that is not possible."""
    version = f"{sys.version_info.major}.{sys.version_info.minor}"
    root = [] if os.geteuid() == 0 else ["sudo"]
    apt = [*root, "apt-get"]
    package = f"python{version}-venv"
    if shutil.which("apt-get") is None or (root and shutil.which("sudo") is None):
        sys.exit(f"make_venv: this Python has no ensurepip; install {package}")
    subprocess.run([*apt, "update", "--quiet"], check=False)
    if subprocess.run([*apt, "install", "--yes", "--quiet", package], check=False).returncode:
        sys.exit(f"make_venv: {package} could not be installed; install it by hand")


def main() -> None:
    """Make the virtual environment in the folder that the command line names."""
    check_version(sys.version_info[:2])
    if not has_ensurepip():
        install_venv_package()
    # The folder is cleared: one that is left from an interrupted try would lack pip.
    venv.create(Path(sys.argv[1]), with_pip=True, clear=True)


if __name__ == "__main__":
    main()
