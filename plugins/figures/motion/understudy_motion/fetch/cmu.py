"""The CMU Graphics Lab Motion Capture Database: its clips' names, addresses and terms.

A clip ``SUBJECT_TRIAL`` (``02_01``) is two files, the motion ``02_01.amc`` and the subject's skeleton
``02.asf``, both in the folder ``subjects/02`` of http://mocap.cs.cmu.edu.
"""

from __future__ import annotations

import re

from understudy.errors import FileError

OFFICIAL = "http://mocap.cs.cmu.edu"
PAGE = OFFICIAL  #: where people look its clips up
FOLDER = "cmu"
SUBJECTS = 144
LICENCE = "free for research and commercial use, not for resale as data"
ATTRIBUTION = (
    "The data used in this project was obtained from mocap.cs.cmu.edu. "
    "The database was created with funding from NSF EIA-0196217."
)

_ADDRESS = re.compile(r"https?://mocap\.cs\.cmu\.edu/subjects/\d+/(\d+_\d+)\.amc")
_CLIP = re.compile(r"(?:cmu/)?([0-9]{1,3})_([0-9]{1,2})")


def clips(text: str) -> list[str]:
    """The clips that `text` names, none if it is no name of this database.

    Parameters
    ----------
    text
        ``02_01``, ``cmu/02_01``, the official address of a motion, or a range of one subject's
        trials, ``02_01..02_05``.

    Raises
    ------
    FileError
        a subject that the database does not have, or a range that is none.
    """
    if official := _ADDRESS.fullmatch(text):
        text = official[1]
    ends = [_CLIP.fullmatch(end) for end in text.split("..")]
    if len(ends) > 2 or not all(ends):
        return []
    subjects = [int(end[1]) for end in ends if end]
    trials = [int(end[2]) for end in ends if end]
    if not 1 <= subjects[0] <= SUBJECTS:
        raise FileError(f"'{text}': the subjects of the CMU database are 01 to {SUBJECTS}.")
    if subjects[0] != subjects[-1] or trials[0] > trials[-1]:
        raise FileError(
            f"'{text}' is no range of clips: give the first and the last trial of one subject, "
            "such as 02_01..02_05."
        )
    return [f"{subjects[0]:02}_{trial:02}" for trial in range(trials[0], trials[-1] + 1)]


def files(clip: str) -> tuple[str, str]:
    """The names of the clip's files, the skeleton first."""
    return f"{clip.partition('_')[0]}.asf", f"{clip}.amc"


def addresses(clip: str, file: str, base: str = OFFICIAL) -> tuple[str, str]:
    """Where a `file` of the clip may be below `base`: in the database's folders, or flat."""
    return f"{base}/subjects/{clip.partition('_')[0]}/{file}", f"{base}/{file}"
