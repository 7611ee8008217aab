"""The order of test files: fast files first, so that a failure shows early; slow files start early on one worker."""

from __future__ import annotations

from typing import Any, Final

import pytest

SLOW: Final = (
    "test_world_effects", "test_work", "test_trace_outputs", "test_faults", "test_trace", "test_campaign", "test_cli",
    "test_report", "test_effects", "test_identify", "test_pipeline", "test_clocks", "test_live", "test_channels",
    "test_player", "test_page_live", "test_exposure_store", "test_demo", "test_two_processes", "test_docs",
)  # fmt: skip
"""Slow files in their order: long computations first, short ones where the workers meet, long processes last."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Slow files come last; the others stay in their order."""
    places = {name: place for place, name in enumerate(SLOW, 1)}
    items.sort(key=lambda item: places.get(item.path.stem, 0))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Several workers take whole files: the first begins with the slowest file, the others with the fastest ones."""
    from xdist.scheduler import LoadFileScheduling

    class FromBothEnds(LoadFileScheduling):
        def _assign_work_unit(self, node: Any) -> None:
            if node is self.nodes[0] and len(self.nodes) > 1:
                self.workqueue.move_to_end(next(reversed(self.workqueue)), last=False)
            super()._assign_work_unit(node)

    config.option.loadscopereorder = False
    return FromBothEnds(config, log)
