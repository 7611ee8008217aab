"""Reads the chosen exports block by block, in several passes over the same bytes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from biodyn_ros.base.progress import OnProgress
from biodyn_ros.blue_trident.cleaning import Cleaner
from biodyn_ros.blue_trident.exports import ChosenExports
from biodyn_ros.blue_trident.rows import Damage
from biodyn_ros.blue_trident.samples import Export, Part, Samples


class ExportReader:
    """Reads the chosen exports, and reports the bytes of all passes: two over low-g, and those added by `expect`.

    sizes: the initial sizes of the files: a file that grows is read to the same position in every pass. start_ns: of
    the first row of a file without a time of day.
    """

    def __init__(self, chosen: ChosenExports, start_ns: int, progress: OnProgress) -> None:
        self.chosen, self.sizes = chosen, {export: export.path.stat().st_size for export in chosen.exports}
        self._lows = [export for export in chosen.exports if any(info.channel == "low" for info in export.channels)]
        self._start_ns, self._progress = start_ns, progress
        self._done, self._total = 0, 2 * sum(self.sizes[export] for export in self._lows)

    def expect(self, exports: Iterable[Export]) -> None:
        """Add one more pass over these files."""
        self._total += sum(self.sizes[export] for export in exports)

    def cleaned(
        self, cleaners: Mapping[str, Cleaner], damage: dict[Export, Damage]
    ) -> Iterator[list[tuple[str, Samples]]]:
        """One pass over low-g: serials and their cleaned samples block by block; then the rows that the cleaners hold.

        `damage` receives an entry for each file.
        """
        for parts in self.in_time_order(self._lows, damage):
            low = [part for part in parts if part.channel == "low" and part.serial in cleaners]
            yield [(part.serial, cleaners[part.serial].push(part.samples)) for part in low]
        last = [(serial, cleaner.finish()) for serial, cleaner in cleaners.items()]
        yield [(serial, samples) for serial, samples in last if samples is not None]

    def in_time_order(self, exports: Iterable[Export], damage: dict[Export, Damage]) -> Iterator[list[Part]]:
        """The parts of several files block by block, always from the file with the earliest time."""
        reading = {
            export: export.parts(damage.setdefault(export, Damage()), self._start_ns, self.sizes[export])
            for export in exports
        }
        latest_ns = dict.fromkeys(reading, -(2**63))
        while reading:
            export = min(reading, key=lambda one: latest_ns[one])
            block = next(reading[export], None)
            if block is None:
                del reading[export]
                continue
            read, parts = block
            ends = [int(part.samples.stamps_ns[-1]) for part in parts if len(part.samples.stamps_ns)]
            latest_ns[export] = max(ends, default=latest_ns[export])
            self._done += read
            self._progress(self._done, max(self._total, self._done))
            yield parts
