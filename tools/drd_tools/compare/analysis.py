"""Compare a recording's increments with those of the nominal model."""

from typing import Final

import numpy as np
from scipy.special import gammaincinv  # importing scipy.stats takes 0.4 s

from drd.arrays import Array
from drd.config.robot import Robot
from drd.config.schema import ConfigError
from drd.units import DEG_PER_RAD, RAD_PER_S_PER_SQRT_S_PER_DEG_PER_H_PER_SQRT_H, RAD_PER_SQRT_S_PER_DEG_PER_SQRT_H
from drd_tools.compare.blocks import Blocks, cut
from drd_tools.compare.covariates import Covariate, covariates_of
from drd_tools.compare.mismatch import (
    Kind,
    ReferenceError,
    Standstill,
    kinds_of,
    mismatches,
    modelled,
    reference_errors,
    standstill,
)
from drd_tools.compare.noise import Expected, expected
from drd_tools.compare.results import ChannelResult, Comparison, CovariateResult
from drd_tools.compare.shares import Share, Whitened, curve, shares, whitened
from drd_tools.diagnose.error_model.nominal_path import follow
from drd_tools.diagnose.error_model.path import Path
from drd_tools.diagnose.observe.evidence import Evidence, gather
from drd_tools.recordings.folder import Recording

P_NAMED: Final = 0.01
# Datasheets may be off by 30 %, and noise has tails: only a ratio significantly above this is more than noise.
TOLERATED: Final = 1.5
SURE: Final = 0.999
SIGMAS: Final = 4.0  # for a constant mismatch
FEWEST_BLOCKS: Final = 12  # for any statement on covariates


def compare(recording: Recording, seed: int = 0) -> Comparison:
    """Compare a recording with its model. Raises ConfigError if there is nothing to compare with."""
    e = gather(recording)
    kinds = kinds_of(e)
    if not kinds:
        got = "neither" if recording.reference is None else "too few poses during the drive"
        raise ConfigError(str(recording.folder), "", "a gyro or a reference, to compare the wheels with", got)
    path, blocks = follow(e), cut(e)
    if len(blocks.time_s) < 2:
        got = f"{e.time_s[-1] - e.time_s[0]:.1f} s"
        raise ConfigError(
            str(recording.folder), "", f"a recording of at least two blocks of {blocks.length_s:.1f} s", got
        )
    model = modelled(e, path, recording.terms)
    still = standstill(e, model.gyro_rad)
    found = mismatches(e, path, model, still.bias_rad_s)
    noise = expected(e, path, blocks, still, seed)
    enough = len(blocks.time_s) >= FEWEST_BLOCKS
    covariates = covariates_of(e, path, blocks) if enough else []
    channels = [whitened(blocks.means(found[k.id]), noise[k.id]) for k in kinds]
    judged = shares(channels, covariates, seed)
    errors = {name: [error for error, _ in pairs] for name, pairs in reference_errors(e, path).items()}
    results = [
        _channel(
            kind, w, blocks.means(found[kind.id]), noise[kind.id], blocks, covariates, row, errors.get(kind.id, [])
        )
        for kind, w, row in zip(kinds, channels, judged, strict=True)
    ]
    notes = list(recording.notes)
    if not enough:
        notes.append(f"{len(blocks.time_s)} blocks are too few to tell what the mismatch depends on.")
    return _comparison(recording, e, path, blocks, still, results, notes)


def _comparison(
    recording: Recording,
    e: Evidence,
    path: Path,
    blocks: Blocks,
    still: Standstill,
    channels: list[ChannelResult],
    notes: list[str],
) -> Comparison:
    forward, _, turn = path.steps()
    x, y = (blocks.means(path.pose[1:, k] * e.step_s) for k in (0, 1))
    files = {str(recording.model): "with its effects"} if recording.model else {}
    return Comparison(
        recording=str(recording.folder),
        sha256={**recording.sha256, **files},
        path=f"its reference, {len(e.fix)} poses" if len(e.fix) > 1 else "the gyro's heading and the wheels' travel",
        bias=_bias(e, still),
        noise=_noise_table(e, recording.nominal),
        notes=notes,
        duration_s=float(e.time_s[-1] - e.time_s[0] + e.step_s[0]),
        way_m=float(np.abs(forward).sum()),
        turn_deg=float(np.abs(turn).sum() * DEG_PER_RAD),
        block_s=blocks.length_s,
        time_s=blocks.time_s.tolist(),
        length_s=blocks.duration_s.tolist(),
        x_m=x.tolist(),
        y_m=y.tolist(),
        channels=sorted(channels, key=lambda c: (c.verdict == "nothing", -c.ratio)),
    )


def _bias(e: Evidence, still: Standstill) -> str:
    if e.gyro_rad is None:
        return ""
    if still.seen_s == 0.0:
        return "robot.yaml states no standstill at the start: the gyro's bias is not corrected."
    deg_s = still.bias_rad_s * DEG_PER_RAD
    return f"The bias of the standstill, {deg_s:.4f} deg/s in {still.seen_s:.1f} s, is subtracted from the gyro."


def _noise_table(e: Evidence, nominal: Robot) -> list[list[str]]:
    """Rows of the noise: name, value with unit, and whether robot.yaml states it."""
    sheet, bias_walk_stated = e.datasheet, nominal.gyro_bias_random_walk_deg_per_h_per_sqrt_h
    walk = sheet.walk_rad_per_sqrt_s / RAD_PER_SQRT_S_PER_DEG_PER_SQRT_H
    bias_walk = sheet.bias_walk_rad_s_per_sqrt_s / RAD_PER_S_PER_SQRT_S_PER_DEG_PER_H_PER_SQRT_H
    rows: list[tuple[str, float, str, float | None]] = []
    if e.gyro_rad is not None:
        rows += [
            ("gyro's angle random walk", walk, "deg/sqrt(h)", nominal.gyro_angle_random_walk_deg_per_sqrt_h),
            ("gyro's bias random walk", bias_walk, "deg/h/sqrt(h)", bias_walk_stated),
            (
                "gyro's bias repeatability",
                sheet.bias_rad_s * DEG_PER_RAD,
                "deg/s",
                nominal.gyro_bias_repeatability_deg_s,
            ),
        ]
    slip = nominal.slip_noise_m_per_sqrt_m
    rows.append(("slip noise of each wheel", sheet.slip_m_per_sqrt_m, "m/sqrt(m)", slip))
    if len(e.fix) > 1:
        rows += [
            ("reference's position", sheet.position_m, "m", nominal.reference_position_sigma_m),
            ("reference's heading", sheet.heading_rad * DEG_PER_RAD, "deg", nominal.reference_heading_sigma_deg),
        ]
    return [
        [name, f"{value:.4g} {unit}", "assumed: robot.yaml does not state it" if stated is None else "robot.yaml"]
        for name, value, unit, stated in rows
    ]


def _channel(
    kind: Kind,
    w: Whitened,
    means: Array,
    noise: Expected,
    blocks: Blocks,
    covariates: list[Covariate],
    judged: list[Share],
    reference: list[ReferenceError],
) -> ChannelResult:
    factor = DEG_PER_RAD if kind.angle else 1.0
    ratio = float(np.sqrt(np.mean(w.y**2)))
    errors, P = noise.fit_reference(means)
    means = means - noise.reference @ errors
    C = noise.noise + noise.reference @ P @ noise.reference.T
    alone = whitened(means, Expected(noise.noise, noise.reference[:, :0], noise.independent))
    added = np.tril(np.tile(blocks.duration_s, (len(means), 1)))
    sums, sum_sigma = added @ means, np.sqrt(np.einsum("ij,jk,ik->i", added, C, added))
    mean, mean_sigma = float(sums[-1] / added[-1].sum()), float(sum_sigma[-1] / added[-1].sum())
    rows = [_covariate(alone, d, s, factor) for d, s in zip(covariates, judged, strict=True)]
    rows.sort(key=lambda d: -d.share)
    named = [d.name for k, d in enumerate(rows) if d.p <= P_NAMED and (k == 0 or d.as_good)]
    by_chance = 2.0 * gammaincinv(0.5 * len(w.y), SURE)  # quantile of chi-square
    surely = ratio * float(np.sqrt(len(w.y) / by_chance))
    is_more = surely > TOLERATED or abs(mean) > SIGMAS * mean_sigma
    sigma = np.sqrt(np.diag(noise.noise))
    return ChannelResult(
        id=kind.id,
        title=kind.title,
        text=kind.text,
        unit="deg" if kind.angle else "m",
        rms=factor * float(np.sqrt(np.mean(means**2))),
        expected=factor * float(np.sqrt(np.mean(sigma**2))),
        ratio=ratio,
        independent=noise.independent,
        mean=factor * mean,
        mean_sigma=factor * mean_sigma,
        end=factor * float(sums[-1]),
        end_sigma=factor * float(sum_sigma[-1]),
        verdict="driver" if named else "more" if is_more else "nothing",
        named=named,
        reference=[
            [q.name, q.sigma * float(value), q.sigma * float(variance) ** 0.5, q.unit]
            for q, value, variance in zip(reference, errors, np.diag(P), strict=True)
        ],
        covariates=rows,
        block_mean=(factor * means).tolist(),
        block_sigma=(factor * sigma).tolist(),
        sum=(factor * sums).tolist(),
        sum_sigma=(factor * sum_sigma).tolist(),
    )


def _covariate(w: Whitened, covariate: Covariate, judged: Share, factor: float) -> CovariateResult:
    fitted = curve(w, covariate, judged.left)
    return CovariateResult(
        covariate.name,
        covariate.unit,
        judged.share,
        judged.p,
        judged.left,
        judged.as_good,
        covariate.knots.tolist(),
        (factor * fitted.value).tolist(),
        (factor * fitted.sigma).tolist(),
        (factor * fitted.noise_sigma).tolist(),
    )
