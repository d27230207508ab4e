"""Poses as tables: CSV as `drd evaluate` reads it, TUM trajectories, Parquet."""

from pathlib import Path
from typing import Final

import numpy as np

from drd.output.cdr import quaternion_zw
from drd.samples import Validity
from drd.units import DEG_PER_RAD, NS_PER_S, S_PER_NS
from drd_tools.export.poses import Exported
from drd_tools.recordings.folder import BOUND, COVARIANCE, ESTIMATES, ESTIMATES_FORM, write_table

NUMBERS: Final = ("x_m", "y_m", "heading_rad", "speed_m_s", "rate_rad_s", "speed_sigma_m_s", "rate_sigma_rad_s")


def write_csv(file: Path, exported: Exported) -> None:
    """Write poses, covariances, bounds and whether they are valid; times from the daemon's start or the folder's."""
    zero_ns = exported.zero_ns
    rows = np.array(
        [
            (
                (p.t_ns - zero_ns) * S_PER_NS,
                p.x_m,
                p.y_m,
                p.heading_rad * DEG_PER_RAD,
                *p.covariance,
                p.position_bound_m,
                p.validity is Validity.VALID,
            )
            for _, p in exported.poses
        ]
    )
    write_table(file, ESTIMATES, rows, ESTIMATES_FORM)


def write_tum(file: Path, exported: Exported) -> None:
    """Write a line for each pose: seconds since 1970 or of the folder, x, y, z in m, and the quaternion x, y, z, w."""
    with file.open("w", encoding="ascii") as out:
        for at_ns, p in exported.poses:
            seconds, nanoseconds = divmod(abs(at_ns), NS_PER_S)
            sign = "-" if at_ns < 0 else ""
            z, w = quaternion_zw(p.heading_rad)
            out.write(f"{sign}{seconds}.{nanoseconds:09} {p.x_m:.9f} {p.y_m:.9f} 0 0 0 {z:.12f} {w:.12f}\n")


def write_parquet(file: Path, exported: Exported) -> None:
    """Write all fields of the poses, exactly; `time` is UTC, or the folder's own time as if UTC. Needs pyarrow."""
    import pyarrow as pa  # noqa: PLC0415  # an extra of its own
    import pyarrow.parquet as pq  # noqa: PLC0415

    poses = [p for _, p in exported.poses]
    columns = {
        "time": pa.array([at_ns for at_ns, _ in exported.poses], pa.timestamp("ns", "UTC")),
        "monotonic_ns": pa.array([p.t_ns for p in poses], pa.int64()),
        "sequence": pa.array([p.sequence for p in poses], pa.int64()),
        **{name: pa.array([getattr(p, name) for p in poses], pa.float64()) for name in NUMBERS},
        **{name: pa.array([p.covariance[i] for p in poses], pa.float64()) for i, name in enumerate(COVARIANCE)},
        BOUND: pa.array([p.position_bound_m for p in poses], pa.float64()),
        "validity": pa.array([p.validity.value for p in poses]).dictionary_encode(),
        "reasons": pa.array(["; ".join(f"{r.source}: {r.text}" for r in p.reasons) for p in poses]).dictionary_encode(),
    }
    pq.write_table(pa.table(columns), file)
