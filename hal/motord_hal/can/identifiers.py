# SPDX-License-Identifier: Apache-2.0
"""The identifiers that the drives of one CAN bus send and obey, and those that two of them share.

On a CAN bus the identifier alone says who sent a frame and what it means: 11 and 29 bits are
different identifiers, a frame and the remote frame that requests it have the same one. Pure.
"""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

from motord_hal.base.errors import ProfileError
from motord_hal.can.errors import WARN_EVERY_S
from motord_hal.can.plan import CanPlan, Sent
from motord_hal.drives.can_profile import EXTENDED_ID_MAX, STANDARD_ID_MAX, Frame, Reserved, Sender
from motord_hal.fieldbus.ports import LineSpec
from motord_hal.fieldbus.units import joints_by_unit


@dataclass(frozen=True, slots=True)
class Claim:
    """The identifiers of one frame of a drive: all whose bits under `mask` are those of
    `identifier`."""

    name: str
    identifier: int
    mask: int
    extended: bool
    use: str
    """What happens with them, in words."""
    is_sent: bool
    """Whether motord or the drive sends them. Others are only obeyed."""
    common: str = ""
    """For a frame to all drives at once: its content. Two drives share those that
    are alike. Empty: the frame is of one drive."""

    def shared_with(self, other: Claim) -> int | None:
        """Return an identifier that both have, though they must not; None: they have none."""
        if self.extended != other.extended or (self.identifier ^ other.identifier) & (
            self.mask & other.mask
        ):
            return None
        if (self.common and self.common == other.common) or not (self.is_sent or other.is_sent):
            return None
        return self.identifier & self.mask | other.identifier & other.mask


@dataclass(frozen=True, slots=True)
class Clash:
    """Two drives that share identifiers."""

    one: CanPlan
    other: CanPlan
    identifiers: tuple[int, ...]
    text: str
    """The first of them: what it is for either drive."""


def claims(plan: CanPlan) -> list[Claim]:
    """Return what a drive sends and obeys, first what motord sends to it. Frames with one
    identifier count once."""
    frames = sorted(plan.table.frames.values(), key=lambda frame: frame.sender is Sender.DRIVE)
    found = [_of_frame(plan, frame) for frame in frames]
    found += [_of_reserved(plan, reserved) for reserved in plan.table.reserved]
    unique: dict[object, Claim] = {}
    for claim in found:
        unique.setdefault((claim.identifier, claim.mask, claim.extended, claim.common), claim)
    return list(unique.values())


def _of_frame(plan: CanPlan, frame: Frame) -> Claim:
    common = ""
    if not frame.addressed:
        common = f"{frame.size_bytes} {frame.fd} {frame.begins.hex()}"
        common = "CANopen" if plan.table.abort else common
    extended = frame.is_extended(plan.node)
    return Claim(
        frame.name,
        frame.identifier(plan.node),
        EXTENDED_ID_MAX if extended else STANDARD_ID_MAX,
        extended,
        "which motord sends" if frame.sender is Sender.MOTORD else "which the drive sends",
        is_sent=True,
        common=common,
    )


def _of_reserved(plan: CanPlan, reserved: Reserved) -> Claim:
    common = ""
    if not reserved.addressed:
        common = "CANopen" if plan.table.abort else reserved.name
    sent = reserved.sender is Sender.DRIVE
    return Claim(
        reserved.name,
        reserved.identifier(plan.node),
        reserved.mask,
        reserved.extended,
        "reserved, which the drive may send" if sent else "reserved, which the drive obeys",
        is_sent=sent,
        common=common,
    )


def clashes(plans: Sequence[CanPlan]) -> Iterator[Clash]:
    """Yield the pairs of drives that share an identifier, each with a text that names both."""
    of = [(plan, claims(plan)) for plan in plans]
    for (one, ours), (other, theirs) in combinations(of, 2):
        found: dict[tuple[int, bool], tuple[Claim, Claim]] = {}
        for mine in ours:
            for its in theirs:
                if (shared := mine.shared_with(its)) is not None:
                    found.setdefault((shared, mine.extended), (mine, its))
        if found:
            (shared, extended), (mine, its) = next(iter(found.items()))
            text = f"{identifier_words(shared, extended=extended)} is {mine.name} of {_words(one)}"
            text += f", {mine.use}, and {its.name} of {_words(other)}, {its.use}"
            text += f"; {len(found) - 1} more" if len(found) > 1 else ""
            yield Clash(one, other, tuple(number for number, _ in found), text)


def identifier_words(identifier: int, *, extended: bool) -> str:
    return f"identifier {identifier:#05x} ({29 if extended else 11} bits)"


def _words(plan: CanPlan) -> str:
    joints = ", ".join(joint.name for joint in plan.joints)
    return f'"{plan.profile.name}" node {plan.node} (joint {joints})'


def can_plans(spec: LineSpec) -> list[CanPlan]:
    """Return a plan for each drive of a CAN line. Raise ProfileError if they cannot share it."""
    plans = [CanPlan(joints) for joints in joints_by_unit(spec)]
    for clash in clashes(plans):
        raise ProfileError(f"{spec.name}: {clash.text}")
    return plans


@dataclass(frozen=True, slots=True)
class Sending:
    """An identifier that motord sends, and no other node of the CAN bus may send."""

    identifier: int
    extended: bool
    remote: bool
    """Whether motord sends it as a remote frame only."""
    words: str
    """What motord sends with it, and to which drive."""


def sendings(plans: Iterable[CanPlan]) -> list[Sending]:
    """Return every identifier that motord may send to these drives, each once."""
    found: dict[tuple[int, bool, bool], Sending] = {}

    def add(sent: Sent, words: str) -> None:
        key = (sent.identifier, sent.extended, sent.remote_bytes is not None)
        found.setdefault(key, Sending(*key, words))

    for plan in plans:
        for frame in plan.table.frames.values():
            if frame.sender is Sender.MOTORD:
                add(plan.write(frame, {}), f"{frame.name} to {_words(plan)}")
            elif frame.ask == "rtr" and (question := plan.question(frame)) is not None:
                add(question, f"the request of {frame.name} to {_words(plan)}")
    return list(found.values())


OWN_FRAMES_MAX = 1024
"""Greatest number of frames of one identifier that have been sent and have not come back."""


class OwnFrames:
    """The frames that motord has sent and that its bus shows it again. Any other frame is another
    node's: the kernel marks the frames of other programs on this computer as local, too. Frames of
    one identifier come back in the order in which they went."""

    def __init__(self) -> None:
        self._waiting: defaultdict[tuple[int, bool, bool], deque[bytes]] = defaultdict(
            lambda: deque(maxlen=OWN_FRAMES_MAX)
        )

    def sent(self, sent: Sent) -> None:
        """Note a frame that the bus has taken."""
        key = (sent.identifier, sent.extended, sent.remote_bytes is not None)
        self._waiting[key].append(sent.data)

    def came(self, key: tuple[int, bool, bool], data: bytes) -> bool:
        """Return whether this frame is one of motord's. Those before it were lost."""
        waiting = self._waiting[key]
        place = next((n for n, ours in enumerate(waiting) if data.startswith(ours)), None)
        if place is None:
            return False
        for _ in range(place + 1):
            waiting.popleft()
        return True


class ForeignSenders:
    """Warnings of nodes that send what motord sends. Each identifier appears once in
    WARN_EVERY_S."""

    def __init__(self) -> None:
        self._reported_s: dict[Sending, float] = {}

    def new(self, sending: Sending, now_s: float) -> str:
        """Return the warning to log now for this identifier; empty: it was logged lately."""
        if now_s - self._reported_s.get(sending, -WARN_EVERY_S) < WARN_EVERY_S:
            return ""
        self._reported_s[sending] = now_s
        number = identifier_words(sending.identifier, extended=sending.extended)
        return (
            f"another node sends {number}: {sending.words}, which only motord may send. "
            "Find it and switch it off: it can move the drive"
        )
