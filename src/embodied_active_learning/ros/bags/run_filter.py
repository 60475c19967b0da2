"""Select the messages of one run: skip repetitions, and detect where another run begins."""

from __future__ import annotations

from typing import Dict, Hashable


class RunFilter:
    """Accepts the numbered messages of the first run in a recording.

    A resumed run may record messages again: they have the same number and content. A number that falls back to less
    than half of the last one, with other content, begins another run; all its messages are left out and counted.
    """

    def __init__(self, last: int) -> None:
        """last: number before the first one."""
        self.last = last
        self.lost = 0
        """Number of missing messages between the accepted ones."""
        self.repeated = 0
        """Number of messages recorded twice with different content, of which the first is used."""
        self.other_runs = 0
        """Number of messages left out because they belong to other runs."""
        self._seen: Dict[int, Hashable] = {}

    def accept(self, number: int, content: Hashable) -> bool:
        """Return whether a message is new and belongs to the first run."""
        if self._seen.get(number) == content:
            return False
        if self.other_runs or (number <= self.last and number <= self.last // 2):
            self.other_runs += 1
            return False
        if number <= self.last:
            self.repeated += 1
            return False
        self.lost += number - self.last - 1
        self.last = number
        self._seen[number] = content
        return True
