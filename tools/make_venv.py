"""Make a virtual environment: `python3 tools/make_venv.py FOLDER`.

Debian and Ubuntu ship Python without `ensurepip` unless python3-venv is installed. If it is missing, the package
is installed where that is possible; elsewhere the program ends with a message that names the package.
"""

import os
import shutil
import subprocess
import sys
import venv
from pathlib import Path


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
    if not has_ensurepip():
        install_venv_package()
    # The folder is cleared: one that is left from an interrupted try would lack pip.
    venv.create(Path(sys.argv[1]), with_pip=True, clear=True)


if __name__ == "__main__":
    main()
