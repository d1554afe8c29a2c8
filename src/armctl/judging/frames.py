"""Pandas frames as rows."""

from typing import TYPE_CHECKING

from armctl.judging.rows import Rows

if TYPE_CHECKING:
    import pandas as pd


def rows_of_frame(frame: "pd.DataFrame") -> Rows:
    """Return the rows of a frame, which messages call `the frame`."""
    values = frame.astype(object).where(frame.notna(), None).to_numpy().tolist()
    return Rows(
        source="the frame", headings=[str(name) for name in frame.columns], values=values,
        places=range(len(values)), unit="row",
    )  # fmt: skip
