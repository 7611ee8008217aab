"""Measured streams: sensor checks of pairs of recorded channels, as recorded and with hidden faults.

`python -m blind.measured [SEED ...]` prints both tables; verdicts are computed before any truth is used.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from world import measured

from biodyn_core.sensor_pairs import pairs, transfers
from biodyn_core.sensor_pairs.settings import PairSettings
from blind.requirements import has_recordings

Floats = NDArray[np.float64]

RECORDS: Final = 100
SEED: Final = 77
RATIOS: Final = (0.4, 0.8)
"""Hidden change over background: below the first `unexplained` is correct, above the second a name is required."""

PIECE_S: Final = 12.0
"""Length of the earlier and of the later stretch of a recording without hidden faults."""


@dataclass(frozen=True, eq=False)
class WithoutFault:
    """One recorded pair without a hidden fault, and its check.

    still_percent: difference to the reference's nearest axis without a transfer, NaN if it has none of the same kind.
    """

    name: str
    still_percent: float
    found: pairs.PairCheck


@dataclass(frozen=True, eq=False)
class CheckedRecord:
    """One record: the check, the hidden fault, and the ratio of its change to the background."""

    name: str
    found: pairs.PairCheck
    fault: str
    size: float
    ratio: float

    @property
    def named(self) -> bool:
        """Whether the hidden fault is named."""
        return self.found.verdict == "effect" and self.found.name == self.fault

    @property
    def within(self) -> bool:
        """Whether the hidden fault is among the reported ones."""
        return self.fault in (self.found.name, *self.found.ambiguous_with)


def _pair(pair: measured.Pair) -> pairs.Pair:
    own = pair.under_test[:, :2] if pair.turns else None
    return pairs.Pair(pair.rate_hz, pair.reference, pair.under_test[:, 2], own)


def without_fault() -> list[WithoutFault]:
    """Every recorded pair as it is, the second half checked against the first, at most `PIECE_S` each."""
    found = []
    for pair in measured.pairs():
        length = min(round(PIECE_S * pair.rate_hz), len(pair.reference) // 2)
        middle = len(pair.reference) // 2
        earlier, later = (measured.cut(pair, begin, begin + length) for begin in (middle - length, middle))
        found.append(WithoutFault(pair.name, _still(later), pairs.check(_pair(later), _pair(earlier))))
    return found


def _still(pair: measured.Pair) -> float:
    """Difference in band to the reference's nearest axis, percent."""
    if not pair.turns:
        return float("nan")
    s = PairSettings()
    band = (pair.rate_hz, s.lowest_hz, s.highest_share * pair.rate_hz)
    output = transfers.in_band(pair.under_test[:, 2], *band)
    apart = output[:, None] - transfers.in_band(pair.reference, *band)
    return float(100.0 * np.sqrt((apart**2).mean(axis=0).min() / (output**2).mean()))


def run(
    count: int = RECORDS, seed: int = SEED, report: Callable[[str], None] = lambda text: None
) -> list[CheckedRecord]:
    """Draw records, check every one, and only then read the hidden faults."""
    records, truths = measured.records(count, seed)
    answers = []
    for number, record in enumerate(records):
        answers.append(pairs.check(_pair(record.later), _pair(record.earlier), seed=number))
        report(f"record {number + 1} of {count}")
    # The truths are used only after this line.
    return [
        CheckedRecord(record.name, answer, truth.fault, truth.size, _ratio(record, truth))
        for record, answer, truth in zip(records, answers, truths, strict=True)
    ]


def _ratio(record: measured.Record, truth: measured.Truth) -> float:
    """Rms of the hidden change over that of the background's residual, both in the band that is compared.

    The transfer comes from the earlier stretch, so no refit can compensate the change.
    """
    s, later = PairSettings(), _pair(record.later)
    clean = pairs.Pair(later.rate_hz, later.reference, truth.clean_mps2)
    left = pairs.residual(clean, _pair(record.earlier), s)
    band = (later.rate_hz, s.lowest_hz, s.highest_share * later.rate_hz)
    change = transfers.in_band(later.under_test - truth.clean_mps2, *band)
    return float(np.sqrt(np.sum(change[left != 0.0] ** 2) / np.sum(left**2)))


@dataclass(frozen=True)
class Count:
    """Records of one hidden fault within two ratios, by answer; wrong: only other faults are named."""

    fault: str
    ratios: tuple[float, float]
    of: int
    named: int
    among: int
    wrong: int
    none: int
    unexplained: int
    not_decidable: int


def counts(records: Sequence[CheckedRecord]) -> list[Count]:
    """Counts by hidden fault and ratio, then of any fault, then of none, where every name is a false alarm: `wrong`."""
    steps = ((0.0, RATIOS[0]), RATIOS, (RATIOS[1], np.inf))
    found = [
        _count(fault, (low, high), [g for g in records if g.fault == fault and low <= g.ratio < high])
        for fault in measured.FAULTS
        for low, high in steps
    ]
    hidden = [g for g in records if g.fault != "none"]
    found += [_count("any", (low, high), [g for g in hidden if low <= g.ratio < high]) for low, high in steps]
    return [*found, _count("none", (0.0, 0.0), [g for g in records if g.fault == "none"])]


def _count(fault: str, ratios: tuple[float, float], records: Sequence[CheckedRecord]) -> Count:
    among, verdicts = sum(g.within for g in records), [g.found.verdict for g in records]
    declared = verdicts.count("effect") + verdicts.count("ambiguous")
    rest = tuple(map(verdicts.count, ("none", "unexplained", "not_decidable")))
    return Count(fault, ratios, len(records), sum(g.named for g in records), among, declared - among, *rest)


def table(records: Sequence[CheckedRecord]) -> list[str]:
    """The counts as lines."""
    heads = ("of", "named", "among", "wrong", "none", "unexpl.", "undec.")
    return [f"{'hidden':12} {'ratio':>9} " + " ".join(f"{head:>7}" for head in heads)] + [
        f"{c.fault:12} {f'{c.ratios[0]:g}-{c.ratios[1]:g}':>9} "
        + " ".join(f"{n:7}" for n in (c.of, c.named, c.among, c.wrong, c.none, c.unexplained, c.not_decidable))
        for c in counts(records)
    ]


def _line(f: pairs.PairCheck) -> str:
    """One check as a line."""
    best = max((f.gains or {"": 0.0}).values())
    return (
        f"{f.verdict:13} {f.name:10} {f.size:10.4g} {f.unit:5} gain {best:6.3f} of {f.threshold:6.3f}, background"
        f" {f.background_percent:5.1f} before {f.before_percent:5.1f} after {f.after_percent:5.1f} %"
        f" {' '.join(f.ambiguous_with)}"
    )


def main() -> int:
    """Print both tables; exit code 2 without the recordings."""
    if not has_recordings():
        return 2
    for one in without_fault():
        print(f"{one.name:32} as it is {one.still_percent:5.1f} %  {_line(one.found)}")
    seeds = [int(text) for text in sys.argv[1:]] or [SEED]
    records = [one for seed in seeds for one in run(seed=seed)]
    for g in records:
        print(f"{g.name:46} {g.fault:10} {g.size:10.4g} ratio {g.ratio:5.2f}  {_line(g.found)}")
    print("\n".join(table(records)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
