"""What a licence, as somebody wrote it down, says of a use. A reading aid, and no legal advice."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal

#: What it is to be used for: sold or part of what is sold; passed on for nothing; research.
Purpose = Literal["commercial", "sharing", "research"]
PURPOSES: tuple[Purpose, ...] = ("commercial", "sharing", "research")


@dataclass(frozen=True)
class Verdict:
    """Whether a use is allowed (None: that cannot be told), and why or on what condition."""

    allowed: bool | None
    why: str


_FORBIDS = r"non.?commercial|\bby-nc\b|\bnc\b|not for commercial|no commercial|(research|academic|personal|evaluation) (use |purposes )?only|only for (research|academic|personal)|\bsmpl\b|\bamass\b"
_NO_CHANGES = r"\bby-(nc-)?nd\b|no.?deriv"
_CLOSED = r"all rights reserved|proprietary|confidential"
_ALIKE = r"\b[al]?gpl|\bmpl\b|\beupl\b|\bby-(nc-)?sa\b|share.?alike"
_FREE = r"\bapache|\bmit\b|\bbsd\b|\bisc\b|\bcc0\b|\bzlib\b|\bunlicense\b|public domain|\bcc.by\b|\bcc-by\b|any purpose|free for research and commercial use|commercial use (is )?(allowed|permitted)"


def judge(licence: str, purpose: Purpose) -> Verdict:
    """What `licence` says of the use; of several joined by `` AND `` the worst."""
    verdicts = [
        _judge_one(" ".join(part.lower().split()), purpose) for part in licence.split(" AND ")
    ]
    for allowed in (False, None):
        for verdict in verdicts:
            if verdict.allowed is allowed:
                return verdict
    return Verdict(True, "; ".join(dict.fromkeys(v.why for v in verdicts if v.why)))


def _judge_one(text: str, purpose: Purpose) -> Verdict:
    if text in ("", "unknown", "none") or text.startswith("unknown "):
        return Verdict(None, "nothing says on what terms it may be used")
    if re.search(_FORBIDS, text) and "research and commercial" not in text:
        if purpose == "commercial":
            return Verdict(False, "it is not for commercial use")
        if purpose == "sharing" and not re.search(r"\bcc\b|\bby-nc\b", text):
            return Verdict(None, "it does not say whether it may be passed on")
        return Verdict(True, "not for commercial use")
    if re.search(_NO_CHANGES, text):
        if purpose == "research":
            return Verdict(True, "nothing made from it may be passed on")
        return Verdict(False, "nothing made from it may be passed on")
    if re.search(_ALIKE, text):
        why = "what is made from it and passed on must have the same licence"
        return Verdict(True, "" if purpose == "research" else why)
    if re.search(_FREE, text):
        if "resale" in text:
            return Verdict(True, "it must not be sold as data")
        free = re.search(r"\bcc0\b|public domain|\bunlicense\b", text)
        return Verdict(
            True, "" if free or purpose == "research" else "keep its notice and name its authors"
        )
    if re.search(_CLOSED, text):
        return Verdict(False, "its owner has reserved all rights")
    return Verdict(None, "its terms are not among those that are known here: read them")
