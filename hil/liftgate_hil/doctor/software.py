"""Checks of Python, of the packages that a run needs, and of the compiled model."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable
from importlib import metadata
from pathlib import Path

import liftgate_compiler as compiler
from liftgate_hil.doctor.check import Check, judged
from liftgate_hil.version import PACKAGES

WARM = "liftgate-hil compile"


def versions(version_of: Callable[[str], str] = metadata.version) -> Check:
    """Check that `version_of(name)` finds all required packages, and that numba has one of the tested versions."""
    found, missing = [f"Python {platform.python_version()}"], []
    for name in ("liftgate-hil", *PACKAGES):
        try:
            found.append(f"{name} {version_of(name)}")
        except metadata.PackageNotFoundError:
            missing.append(name)
    text = ", ".join(found)
    needed = [name for name in missing if name in PACKAGES]
    if needed:
        mend = f"python -m pip install {' '.join(needed)}"
        return Check("software", "problem", f"{text}; missing: {', '.join(needed)}", mend)
    try:
        compiler.check_numba()
    except compiler.CompileError as error:
        what, _, advice = str(error).partition(" (")
        return Check("software", "problem", f"{text}; {what}", advice.removesuffix(")"))
    return Check("software", "ok", text)


def model(enabled: bool, cached: bool, folder: Path) -> Check:
    """Return the check on the model's compiled code: whether it is `cached` in `folder`, and what to do if not.

    `enabled`: the compiler is switched on; `cached`: the machine code is there.
    """
    if not enabled:
        found = "the compiler is switched off (LIFTGATE_COMPILE=0): ticks take 20 to 50 times as long"
        mend = "unset LIFTGATE_COMPILE"
    elif cached:
        found, mend = f"ready, in {folder}", ""
    elif not _can_be_made(folder):
        found = f"cannot be cached, {folder} is not writable: every start compiles it, 20 to 90 s"
        mend = "set XDG_CACHE_HOME to a folder that this user may write"
    else:
        found = "not compiled yet: the first start compiles it, 20 to 90 s"
        mend = f"{WARM} (once for this version, machine and user)"
    return judged("compiled model", found, mend)


def _can_be_made(folder: Path) -> bool:
    """Whether this user can write to a folder, or create it."""
    try:
        existing = next(each for each in (folder, *folder.parents) if each.exists())
    except (OSError, StopIteration):
        return False
    return os.access(existing, os.W_OK | os.X_OK)
