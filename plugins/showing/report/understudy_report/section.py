"""What a part of the report page is: a component of kind ``report_section``, from any plugin."""

from __future__ import annotations

from abc import ABC, abstractmethod

from understudy.records.runs import Run

__all__ = ["ReportSection"]


class ReportSection(ABC):
    """One part of the page, made without arguments and from the run folder alone.

    The bundled sections have the orders 0 (headline), 20 (motion), 40 (evaluation), 60 (learning
    curves), 65 (a learned model's error), 80 (provenance) and 90 (configuration).
    """

    #: The heading, as plain text; none if empty.
    title: str
    #: Sections stand in this order, from small to large; by name where it is equal.
    order: int = 50

    @abstractmethod
    def html(self, run: Run) -> str | None:
        """The section's HTML, or None if the run has nothing for it.

        Text from elsewhere must be escaped (the helpers of
        :mod:`understudy_report.markup` do, or :func:`html.escape`). Elements must nest, nothing may be loaded but ``data:``
        addresses, and no script may run; the page shows a sentence in place of a section that raises
        or breaks this.
        """
