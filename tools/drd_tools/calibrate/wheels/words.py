"""Sentences of the wheel calibration: which values are not determined, and what to distrust."""

import math
from collections.abc import Sequence

import numpy as np

from drd.units import DEG_PER_RAD
from drd_tools.calibrate.wheels.covariance import NOTABLE_DISAGREEMENT
from drd_tools.calibrate.wheels.drive import SWEEP_DEG, Drive
from drd_tools.calibrate.wheels.fit import LIMIT, WheelFit
from drd_tools.calibrate.wheels.heldout import HeldOut
from drd_tools.calibrate.wheels.lag import LIMIT_S, Lag
from drd_tools.calibrate.wheels.rest import FEWEST, Rest

ONE_SIDED = 0.2  # ratio of the turning to the lesser side to that to the other
LITTLE_TURN_RAD = 0.5 * math.pi
NOTABLE_SIGMA = 3.0
NOISY = 1.5
WORSE = 1.02
VALUES = ("mean radius", "difference of the radii", "tread")


def not_determined(fit: WheelFit, drives: Sequence[Drive]) -> list[str]:
    """A sentence for each value that stays nominal."""
    if fit.is_lost:
        return [
            f"wheels: not determined, no values explain the reference: {1000 * min(fit.white_m):.0f} mm and "
            f"{DEG_PER_RAD * min(fit.white_rad):.0f} deg remain within the windows. Its rows may be too far apart to "
            "resolve whole turns, a counter may have stopped, or robot.yaml's convention may be wrong."
        ]
    path_m = sum(drive.path_m for drive in drives)
    left, right = np.sum([drive.turns_rad for drive in drives], axis=0)
    turned = f"{DEG_PER_RAD * (left + right):.0f} deg in all, in sweeps of {SWEEP_DEG:g} deg or more"
    sentences = []
    for k, name in enumerate(VALUES):
        if fit.determined[k]:
            continue
        if k == 2 and left + right < LITTLE_TURN_RAD:
            why = f"the recordings hardly turn ({turned})"
        elif k < 2 and path_m < 0.5 * (left + right) * drives[0].nominal.tread_m:
            why = f"the recordings turn ({turned}) but hardly go anywhere ({path_m:.2f} m of path)"
        else:
            why = f"too little motion for this noise ({path_m:.2f} m of path, {turned})"
        sentences.append(
            f"{name}: not determined, {why}; its standard deviation would be {100 * fit.free_sigma[k]:.0f} % or more, "
            f"the limit is {100 * LIMIT[k]:.0f} %. It stays at its nominal."
        )
    if not fit.determined[0] and fit.determined[2]:
        sentences.append(
            "tread: it applies to the nominal radii; only tread / radius was measured. Its sigma allows for that."
        )
    if fit.determined[1] and not fit.determined[2]:
        sentences.append("difference of the radii: it applies to the nominal tread. Its sigma allows for that.")
    return sentences


def warnings(fit: WheelFit, drives: Sequence[Drive]) -> list[str]:
    """Sentences on reasons in the data to doubt this fit."""
    said = []
    left, right = DEG_PER_RAD * np.sum([drive.turns_rad for drive in drives], axis=0)
    if max(left, right) > 90.0 and min(left, right) < ONE_SIDED * max(left, right):
        said.append(
            f"The recordings turn to one side ({left:.0f} deg left, {right:.0f} deg right). Tread, unequal wheels and "
            "a sideways offset of the reference look alike there: drive the same turns the other way too."
        )
    if fit.disagreement > NOTABLE_DISAGREEMENT:
        said.append(
            f"The recordings disagree {fit.disagreement:.1f} times more than their own windows do: something changes "
            "between them (ground, load, way of driving). The uncertainty is taken from recording to recording."
        )
    noise_deg, sheet_deg = (
        DEG_PER_RAD * float(np.median(v)) for v in (fit.white_rad, [d.heading_sigma_rad for d in drives])
    )
    noise_m, sheet_m = float(np.median(fit.white_m)), float(np.median([d.position_sigma_m for d in drives]))
    if noise_deg > NOISY * sheet_deg or noise_m > NOISY * sheet_m:
        said.append(
            f"The residual, {1000 * noise_m:.1f} mm and {noise_deg:.2f} deg, is more than the reference noise "
            f"in robot.yaml, {1000 * sheet_m:.1f} mm and {sheet_deg:.2f} deg: a noisier reference, or slip."
        )
    return said


def held_out_warnings(
    fit: WheelFit, drives: Sequence[Drive], other: WheelFit | None, tests: Sequence[Drive], figures: Sequence[HeldOut]
) -> list[str]:
    """Sentences if the calibration does not generalise; `other` is a fit of the held-out recordings alone."""
    if not figures:
        return []
    said = []
    before, after = (
        math.sqrt(float(np.mean([error.rms_m**2 for error in errors])))
        for errors in ([f.nominal for f in figures], [f.calibrated for f in figures])
    )
    if after > WORSE * before:
        said.append(
            f"The calibration does not help where it was not fitted: {1000 * before:.3g} mm rms along the way with the "
            f"nominal wheels, {1000 * after:.3g} mm with the calibrated ones. Do not use it."
        )
    if other is None:
        return said
    names = ("left radius", "right radius", "tread")
    radii = all(all(f.determined[:2]) for f in (fit, other))
    for k, name in enumerate(names):
        if not (radii if k < 2 else fit.determined[2] and other.determined[2]):
            continue
        mine, its = fit.wheels[k], other.wheels[k]
        sigma = math.hypot(fit.sigma[k] * mine, other.sigma[k] * its)
        if abs(mine - its) > NOTABLE_SIGMA * sigma:
            said.append(
                f"The held-out recordings, fitted alone, give a different {name}: {its:.5g} m, "
                f"{100 * (its / mine - 1):+.2f} %, {abs(mine - its) / sigma:.0f} sigma away."
            )
    if said:
        said.append(
            "Slip makes the effective values depend on how the robot is driven: calibrate with drives like the real "
            f"ones. {_way_of_driving(drives, tests)}"
        )
    return said


def _way_of_driving(drives: Sequence[Drive], tests: Sequence[Drive]) -> str:
    fitted, held_out = (100 * float(np.mean([d.spot_share for d in some])) for some in (drives, tests))
    return (
        f"Of the turning {fitted:.0f} % is on the spot (wheels running against each other) in the fitted recordings, "
        f"{held_out:.0f} % in the held-out ones."
    )


def lag_sentences(lag: Lag | None) -> list[str]:
    """Sentences on the meaning of the wheels' lag, or why it is not determined."""
    if lag is None:
        return ["lag of the wheels: not determined, no recording has motion and rows dense enough to show it."]
    if not lag.determined:
        sigma = "unknown" if math.isinf(lag.sigma_s) else f"{1000 * lag.sigma_s:.0f} ms"
        return [
            f"lag of the wheels: not determined, the turns show it too poorly against the {lag.against} (standard "
            f"deviation {sigma}, the limit is {1000 * LIMIT_S:.0f} ms)."
        ]
    said = []
    if lag.against == "reference":
        said.append(
            "lag of the wheels: without a gyro it is relative to the reference, whose own delay is assumed to be zero."
        )
        if not lag.applies:
            said.append(
                "lag of the wheels: it is not clearly more than its uncertainty and the scatter between recordings, or "
                "it is the reference that lags. It is not written."
            )
    said.append(
        "lag of the wheels: relative to the time stamps of these recordings. If a latency was subtracted from these, "
        "add it."
    )
    if lag.hold_s > 0.0:
        said.append(
            f"The drive holds a wheel speed for {lag.hold_s:.2f} s: a single reading is older or younger than the lag "
            f"states by {1000 * lag.hold_s / math.sqrt(12.0):.0f} ms, which the filter estimates while driving."
        )
    return said


def rest_sentences(rest: Rest | None) -> list[str]:
    """Sentences on why the gyro's noise or bias is not determined."""
    if rest is None:
        return []
    if rest.noise_deg_per_sqrt_h is None:
        return [
            f"gyro noise: not determined, {rest.standstill_s:.0f} s of standstill are too little; {FEWEST} differences "
            f"of consecutive seconds are needed, and there are {rest.differences}."
        ]
    if rest.bias_deg_s is None:
        return ["gyro bias: not determined, four recordings with some seconds of standstill are needed."]
    if rest.repeatability_deg_s is None:
        return [
            f"gyro bias: its repeatability is not determined, the recordings differ by no more than noise allows "
            f"({rest.bias_noise_deg_s:.2g} deg/s)."
        ]
    return []
