"""Reasons for a pose that is not simply valid: set once, kept with the time of onset, cleared when over."""

from drd.samples import Reason, Validity


class Reasons:
    """Current problems by source. A source is an input or a cause: "fog", "encoders.left", "bias", ..."""

    def __init__(self) -> None:
        self._active: dict[str, tuple[Reason, Validity]] = {}
        self._tuple: tuple[Reason, ...] = ()
        self._worst = Validity.VALID

    def set(self, source: str, text: str, now_ns: int, severity: Validity = Validity.DEGRADED) -> None:
        """Set a problem of `source`. While it lasts, the text may change but `since` does not."""
        known = self._active.get(source)
        if known is not None and known[0].text == text and known[1] is severity:
            return
        since_ns = now_ns if known is None else known[0].since_ns
        self._active[source] = (Reason(source, text, since_ns), severity)
        self._summarise()

    def clear(self, source: str) -> None:
        """Clear the problem of `source`."""
        if self._active.pop(source, None) is not None:
            self._summarise()

    def update(self, source: str, text: str | None, now_ns: int, severity: Validity = Validity.DEGRADED) -> None:
        """Set, or clear where `text` is None."""
        if text is not None:
            self.set(source, text, now_ns, severity)
        elif source in self._active:
            self.clear(source)

    def _summarise(self) -> None:
        self._tuple = tuple(reason for reason, _ in self._active.values())
        severities = {severity for _, severity in self._active.values()}
        for worst in (Validity.INVALID, Validity.INITIALISING, Validity.DEGRADED):
            if worst in severities:
                self._worst = worst
                return
        self._worst = Validity.VALID

    @property
    def validity(self) -> Validity:
        """The worst of all active reasons; VALID where there is none."""
        return self._worst

    def active(self) -> tuple[Reason, ...]:
        """All current problems, in the order in which they began."""
        return self._tuple

    def has(self, source: str) -> bool:
        """Whether `source` has a problem."""
        return source in self._active
