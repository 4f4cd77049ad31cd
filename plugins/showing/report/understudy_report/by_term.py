"""The recent values of each reward term, and which terminations ended episodes, in a line or two."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence

from understudy_report.words import share, short

#: Iterations that count.
OVER = 10
_REWARD, _ENDED_BY = "reward/", "episode/ended_by/"


class ByTerm:
    """Means over the last :data:`OVER` rows of metrics, which are numbers on the host already."""

    def __init__(self) -> None:
        self._rows: deque[Mapping[str, float]] = deque(maxlen=OVER)

    def add(self, row: Mapping[str, float]) -> None:
        self._rows.append(row)

    def lines(self, width: int) -> list[str]:
        """At most `width` characters each, where names allow it; no lines for a job that has neither rewards nor episodes."""
        return [*self._rewards(width), *self._endings(width)]

    def summary(self, width: int) -> list[str]:
        """The same under a line that says of what."""
        count = len(self._rows)
        head = f"Means of the last {count} iterations:" if count > 1 else "The last iteration:"
        lines = self.lines(width - 2)
        return [head, *(f"  {line}" for line in lines)] if lines else []

    def _rewards(self, width: int) -> list[str]:
        """The reward of a decision; by term, if there are several, with weights."""
        rows = [row for row in self._rows if "reward" in row]
        if not rows:
            return []
        mean = {
            key: sum(row[key] for row in rows) / len(rows)
            for key in rows[-1]
            if (key == "reward" or key.startswith(_REWARD)) and all(key in row for row in rows)
        }
        terms = [f"{k.removeprefix(_REWARD)} {short(v)}" for k, v in mean.items() if k != "reward"]
        return wrapped(f"reward {short(mean['reward'])}", terms, width)

    def _endings(self, width: int) -> list[str]:
        """Shares of the episodes that ended, the largest first; one that several terms ended counts for each."""
        rows = [row for row in self._rows if row.get("episode/episodes")]
        episodes = sum(row["episode/episodes"] for row in rows)
        if not episodes:
            return []
        names = {key: key.removeprefix(_ENDED_BY) for key in rows[-1] if key.startswith(_ENDED_BY)}
        names["episode/truncated"] = "truncated"
        ended = {
            name: sum(row.get(key, 0.0) * row["episode/episodes"] for row in rows) / episodes
            for key, name in names.items()
        }
        most = sorted(ended.items(), key=lambda item: -item[1])
        items = [f"{name} {share(value)}" for name, value in most]
        plural = "s" if episodes > 1 else ""
        return wrapped(f"{episodes:,.0f} episode{plural} ended by", items, width)


def wrapped(head: str, items: Sequence[str], width: int) -> list[str]:
    """``head: item · item …`` in as many lines as it takes; none is broken within an item."""
    if not items:
        return [head]
    lines = [f"{head}: {items[0]}"]
    for item in items[1:]:
        if len(lines[-1]) + len(" · ") + len(item) <= width:
            lines[-1] += f" · {item}"
        else:
            lines.append(f"  {item}")
    return lines
