"""The tables of a fleet's store: names, columns and units; SI, but for what `unit` names and for degrees Celsius.

Each table lies as Parquet in STORE/TABLE/ROBOT/PERIOD.parquet. `robot` is a column as well, not a part of a path such
as `robot=7`, which readers take for a number. `maintenance` is one file. What changes a column's meaning, takes one
away or renames one raises VERSION; a new column does not.
"""

from typing import Final, NamedTuple

import pyarrow as pa

VERSION: Final = 1

TIME: Final = pa.timestamp("us", "UTC")
TEXT: Final = pa.string()
REAL: Final = pa.float64()
# In each table of recordings: `recording` is unique in a store; `start_utc` is null where nothing tells it, and so are
# `place` and `batch` (of gyros).
LABELS: Final = [
    ("recording", TEXT),
    ("robot", TEXT),
    ("place", TEXT),
    ("batch", TEXT),
    ("start_utc", TIME),
]


class Table(NamedTuple):
    """Columns of a table, and the time that one of its files covers, as strftime writes it."""

    schema: pa.Schema
    period: str = "%Y"


# One row for each recording that was looked at. `uri`: where it lies. `verdict`: "failed" where `error` says why.
# `digest`: of its files, the build of the diagnosis, and its form here; `signature`: sizes and times of the files.
# `own`: labels that the recording brings, as JSON, before those of ROBOTS.yaml. `begins_s`: how long after that start
# a part of a long recording begins; `start_utc` is the part's own.
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

# One row for each parameter of each finding; one with parameter, value, sigma and unit null where it has none.
# `number`: of the finding in its recording, the best first. `also_fits`: names that the drive cannot tell from it.
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
# (relative errors, 1), lag_s (s), bias_per_c (rad/s per degree Celsius). None where the recording does not tell.
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

# Figures of `drd evaluate` for the poses, where there is a reference; `model`: "nominal", or "found", with the findings
# taken off. `figure` names the unit.
POSE: Final = pa.schema([*LABELS, ("model", TEXT), ("figure", TEXT), ("value", REAL)])

# Score and information of each recording over all effects and nuisances: one row for each of k columns of its
# regression. `information` (k,): the row `at` of the symmetric matrix. For parameters x away from the model without any
# effect, log likelihood = `score` x - x `information` x / 2 - `square` / 2, up to a constant; nuisances are in units of
# their prior, which is not in the information: add 1 to its diagonal for each.
PRODUCTS: Final = pa.schema(
    [
        *LABELS,
        ("at", pa.int32()),
        ("kind", TEXT),  # "effect" or "nuisance"
        ("effect", TEXT),  # the nuisance's name
        ("parameter", TEXT),  # "" where the whole effect is the unit, of the shape that `shape` tells
        ("shape", TEXT),  # parameters that are not linear, SI, as JSON
        ("score", REAL),
        ("information", pa.list_(REAL)),
        ("square", REAL),
        ("rows", pa.int64()),
    ]
)

# Recordings that could not be read or analysed.
ERRORS: Final = pa.schema([*LABELS, ("uri", TEXT), ("error", TEXT)])

# What was done to a robot, from the log of maintenance.
MAINTENANCE: Final = pa.schema([("date", TIME), ("robot", TEXT), ("what", TEXT)])

# Products take the most room: a file of a month is rewritten whole when a recording is added.
TABLES: Final = {
    "recordings": Table(RECORDINGS),
    "findings": Table(FINDINGS),
    "constants": Table(CONSTANTS),
    "pose": Table(POSE),
    "products": Table(PRODUCTS, "%Y-%m"),
    "errors": Table(ERRORS),
}
# A recording's rows of all tables, in one file, until they are sorted into the tables' own.
PENDING: Final = pa.schema([(name, pa.list_(pa.struct(list(t.schema)))) for name, t in TABLES.items()])
