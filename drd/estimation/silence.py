"""Times at which each sensor was last heard, and the reasons that its silence gives the pose."""

from drd.config.keys import Config
from drd.estimation.health import Reasons
from drd.samples import Validity
from drd.units import NS_PER_S, S_PER_NS


class Silence:
    """Watches the times of the samples that were used. Times are CLOCK_MONOTONIC ns, 0 = never."""

    def __init__(self, config: Config, reasons: Reasons):
        self._reasons = reasons
        self._has_gyro = config.fog.protocol != "none"
        self._gyro_limit_ns = round(config.fog.silent_after_s * NS_PER_S)
        self._wheels_limit_ns = round(config.encoders.silent_after_s * NS_PER_S)
        self._invalid_after_s = config.estimation.invalid_after_s
        self._first_ns = 0
        self.gyro_ns = 0
        self.wheels_ns = 0
        # The wheels were silent for so long that the pose was invalid; only a pose from outside clears that.
        self.was_lost = False
        # Until then nothing changes as long as samples arrive.
        self._calm_until_ns = 0

    def begin(self, now_ns: int) -> None:
        """Note that something was heard or time passed: waiting counts from the first such moment."""
        self._first_ns = self._first_ns or now_ns

    def take_over(self, other: "Silence", now_ns: int) -> None:
        """Continue in another's place, whose last tick was `now_ns`."""
        self.begin(1 if other.gyro(now_ns) else now_ns)
        self.wheels_ns, self.gyro_ns, self.was_lost = other.wheels_ns, other.gyro_ns, other.was_lost

    def wheels(self, now_ns: int) -> bool:
        """Whether the wheels are silent."""
        return now_ns - (self.wheels_ns or self._first_ns) >= self._wheels_limit_ns

    def gyro(self, now_ns: int) -> bool:
        """Whether the gyro is silent."""
        return now_ns - (self.gyro_ns or self._first_ns) >= self._gyro_limit_ns

    def watch(self, now_ns: int) -> None:
        """Turn silence into reasons."""
        if now_ns < self._calm_until_ns and not self.was_lost:
            return
        reasons = self._reasons
        self._calm_until_ns = 0
        if self._has_gyro:
            text = "no gyro samples: heading from the wheels alone" if self.gyro(now_ns) else None
            reasons.update("fog", text, now_ns)
        if not self.wheels_ns:
            reasons.set("encoders", "no wheel samples yet", now_ns, Validity.INITIALISING)
        elif self.wheels(now_ns):
            lost = (now_ns - self.wheels_ns) * S_PER_NS > self._invalid_after_s
            self.was_lost |= lost
            severity = Validity.INVALID if lost else Validity.DEGRADED
            reasons.set("encoders", "no wheel samples: position unknown since then", now_ns, severity)
        else:
            reasons.clear("encoders")
            if self.was_lost:
                reasons.set("position", "motion was unseen for too long: only set_pose or reset clears this", now_ns)
            self._calm_until_ns = self.wheels_ns + self._wheels_limit_ns
            if self._has_gyro:
                last_ns = self.gyro_ns or self._first_ns
                self._calm_until_ns = min(self._calm_until_ns, last_ns + self._gyro_limit_ns)
