"""Tables of a fleet's store: names, columns and units; SI, except where `unit` differs and for degrees Celsius.

Each table is Parquet in STORE/TABLE/ROBOT/PERIOD.parquet. `robot` is a column as well, not a part of a path such as
`robot=7`, which readers take for a number. `maintenance` is one file. Changing the meaning of a column, removing or
renaming one raises VERSION; adding one does not.
"""

from typing import Final, NamedTuple

import pyarrow as pa

VERSION: Final = 1

TIME: Final = pa.timestamp("us", "UTC")
TEXT: Final = pa.string()
REAL: Final = pa.float64()
# Columns of each table of recordings: `recording` is unique in a store; `start_utc`, `place` and `batch` (of gyros) are
# null if unknown.
LABELS: Final = [
    ("recording", TEXT),
    ("robot", TEXT),
    ("place", TEXT),
    ("batch", TEXT),
    ("start_utc", TIME),
]


class Table(NamedTuple):
    """Columns of a table, and the period that each of its files covers, as a strftime format."""

    schema: pa.Schema
    period: str = "%Y"


# One row per recording examined. `uri`: its location. `verdict`: "failed" if `error` says why. `digest`: hash of its
# files; `build`: that of the diagnosis; `signature`: hash of the files' sizes and times. `own`: the recording's own
# labels, as JSON, without those of ROBOTS.yaml. `begins_s`: when a part of a long recording begins, after the
# recording's start; `start_utc` is the part's own.
RECORDINGS: Final = pa.schema(
    [
        *LABELS,
        ("uri", TEXT),
        ("duration_s", REAL),
        ("distance_m", REAL),
        ("verdict", TEXT),
        ("digest", TEXT),
        ("build", TEXT),
        ("error", TEXT),
        ("signature", TEXT),
        ("own", TEXT),
        ("begins_s", REAL),
    ]
)

# One row per parameter of each finding; for a finding without any, one with parameter, value, sigma and unit null.
# `number`: rank of the finding in its recording. `also_fits`: names that the drive cannot distinguish from it.
FINDINGS: Final = pa.schema(
    [
        *LABELS,
        ("number", pa.int32()),
        ("effect", TEXT),
        ("status", TEXT),
        ("probability", REAL),
        ("parameter", TEXT),
        ("value", REAL),
        ("sigma", REAL),
        ("unit", TEXT),
        ("also_fits", pa.list_(TEXT)),
        ("gain_nats", REAL),
        ("covariance", pa.list_(REAL)),  # this parameter's row, over the finding's parameters, in their units
        ("sentence", TEXT),
    ]
)

# The robot's constants in each recording, whether a finding or not: radius_left, radius_right, tread, gyro_scale
# (relative errors, 1), lag_s (s), bias_per_c (rad/s per degree Celsius). No row if the recording does not determine it.
CONSTANTS: Final = pa.schema(
    [
        *LABELS,
        ("duration_s", REAL),
        ("name", TEXT),
        ("value", REAL),
        ("sigma", REAL),
        ("unit", TEXT),
    ]
)

# Figures of `drd evaluate` for the poses, if there is a reference; `model`: "nominal", or "found", corrected for the
# findings. `figure` names the unit.
POSE: Final = pa.schema([*LABELS, ("model", TEXT), ("figure", TEXT), ("value", REAL)])

# Score and information of each recording over all effects and nuisances: one row for each of k columns of its
# regression. `information` (k,): row `at` of the symmetric matrix. For parameters x relative to the model without any
# effect, log likelihood = `score` x - x `information` x / 2 - `square` / 2, up to a constant; nuisances are in units of
# their prior, which is not in the information: add 1 to its diagonal for each.
PRODUCTS: Final = pa.schema(
    [
        *LABELS,
        ("at", pa.int32()),
        ("kind", TEXT),  # "effect" or "nuisance"
        ("effect", TEXT),  # the nuisance's name
        ("parameter", TEXT),  # "" if the unit is the whole effect, with the shape `shape`
        ("shape", TEXT),  # nonlinear parameters, SI, as JSON
        ("score", REAL),
        ("information", pa.list_(REAL)),
        ("square", REAL),
        ("rows", pa.int64()),
    ]
)

# Recordings that could not be read or analysed.
ERRORS: Final = pa.schema([*LABELS, ("uri", TEXT), ("error", TEXT)])

# Work done on a robot, from the maintenance log.
MAINTENANCE: Final = pa.schema([("date", TIME), ("robot", TEXT), ("what", TEXT)])

# Products are the largest table, hence a file per month: adding a recording rewrites its whole file.
TABLES: Final = {
    "recordings": Table(RECORDINGS),
    "findings": Table(FINDINGS),
    "constants": Table(CONSTANTS),
    "pose": Table(POSE),
    "products": Table(PRODUCTS, "%Y-%m"),
    "errors": Table(ERRORS),
}
# A recording's rows of all tables, in one file, until they are moved into the tables' own.
PENDING: Final = pa.schema([(name, pa.list_(pa.struct(list(t.schema)))) for name, t in TABLES.items()])
