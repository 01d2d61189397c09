"""With STUDY=short, leave out all but the first case of each study."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.study.shortened import SHORT


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if not SHORT:
        return
    first: dict[tuple[Path, str], pytest.Item] = {}
    for item in items:
        if item.path.parent == Path(__file__).parent:
            first.setdefault((item.path, item.name.partition("[")[0]), item)
    kept = [item for item in items if item in first.values()]
    config.hook.pytest_deselected(items=[item for item in items if item not in kept])
    items[:] = kept
