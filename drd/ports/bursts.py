"""Times of frames that were read at once from an adapter without time stamps."""

from collections import Counter
from collections.abc import Sequence

from drd.samples import CanFrame
from drd.units import NS_PER_S


class Bursts:
    """Spreads the times of frames that waited (in an adapter, or for the host) and were all read at one moment.

    With that moment as their time, the speed would come out many times too large. So frames of one identifier that were
    read together follow the one before the burst at the nominal period, or closer if there is no room; after a loss
    they end at the moment of reading.
    """

    def __init__(self, rate_hz: float):
        self._period_ns = round(NS_PER_S / rate_hz)
        self._last_ns: dict[tuple[int, bool], int] = {}

    def spread(self, batch: Sequence[CanFrame]) -> list[CanFrame]:
        """The batch with its frames' times spread out, in the same order."""
        left = Counter((frame.can_id, frame.extended) for frame in batch)
        if not batch or max(left.values()) == 1:
            self._last_ns.update({(f.can_id, f.extended): f.t_ns for f in batch})
            return list(batch)
        spread = []
        for frame in batch:
            key = (frame.can_id, frame.extended)
            last_ns = self._last_ns.get(key)
            t_ns = frame.t_ns - left[key] * self._period_ns  # the earliest: the last would be a period old
            if last_ns is None:
                t_ns += self._period_ns
            else:
                room_ns = max(0, frame.t_ns - last_ns) // left[key]
                t_ns = max(t_ns, last_ns + min(self._period_ns, room_ns))
            left[key] -= 1
            self._last_ns[key] = t_ns
            spread.append(frame._replace(t_ns=t_ns))
        return spread
