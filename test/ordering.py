"""The order of test files: fast files first, so that a failure shows early; slow files start early on one worker."""

from __future__ import annotations

import gc
from pathlib import PurePath
from typing import Any, Final

import pytest

SLOW: Final = (
    "test_world_effects", "test_work", "test_trace_command", "test_trace_page", "test_faults", "test_trace",
    "test_campaign", "test_cli", "test_report", "test_effects", "test_identify", "test_pipeline", "test_clocks",
    "test_live", "test_channels", "test_player", "test_page_live", "test_exposure_store", "test_demo",
    "test_two_processes", "test_docs",
)  # fmt: skip
"""Slow files in their order: long computations first, short ones where the workers meet, long processes last."""

SHARED: Final = (
    "test_data_checks", "test_diagnose", "test_effects", "test_joint_refit", "test_local_fit",
    "test_nuisance_parameters", "test_preliminary_fit", "test_restoring_force", "test_screen", "test_surface",
    "test_trace", "test_unsteady",
)  # fmt: skip
"""Files whose tests use the simulated events of hiding.py: one worker runs them all and simulates these once."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Slow files come last; the others stay in their order."""
    places = {name: place for place, name in enumerate(SLOW, 1)}
    items.sort(key=lambda item: places.get(item.path.stem, 0))


def pytest_collection_finish() -> None:
    """Garbage collection is rare and leaves out the collected tests: it took a fourteenth of all time."""
    gc.freeze()
    gc.set_threshold(100_000, 50, 100)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Several workers take whole files, `SHARED` as one: the first begins with the slowest, others with the fastest."""
    from xdist.scheduler import LoadFileScheduling

    class FromBothEnds(LoadFileScheduling):
        def _split_scope(self, nodeid: str) -> str:
            file = nodeid.partition("::")[0]
            return "hiding" if PurePath(file).stem in SHARED else file

        def _assign_work_unit(self, node: Any) -> None:
            if node is self.nodes[0] and len(self.nodes) > 1:
                self.workqueue.move_to_end(next(reversed(self.workqueue)), last=False)
            super()._assign_work_unit(node)

    config.option.loadscopereorder = False
    return FromBothEnds(config, log)
