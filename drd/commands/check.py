"""`drd check CONFIG`: what is in force, and where each value came from."""

import dataclasses
from typing import Any

from drd.commands import config_argument, placed
from drd.config_file import load_config
from drd.output.session import check_output
from drd.pipeline import Pipeline
from drd.schema import Key


def main(argv: list[str]) -> int:
    """Print every key with value, unit and origin; load all files that the configuration names."""
    parser = config_argument(
        "drd check",
        "Check a configuration and all files that it names, without opening a device. Prints each key in force "
        "with its value, unit and origin. Exit code 2 where it cannot be used.",
    )
    parser.add_argument("--explain", action="store_true", help="print what each key means, too")
    arguments = parser.parse_args(argv)
    loaded = load_config(arguments.config)
    with placed(loaded):
        pipeline = Pipeline(loaded.value, arguments.config.parent, lambda *_: None)
        check_output(loaded.value.output.beside(arguments.config.parent))
    rows = [(path, _shown(value), meta, loaded.origins[path]) for path, value, meta in _keys(loaded.value)]
    width, value_width = (max(len(row[i]) for row in rows) for i in (0, 1))  # type: ignore[arg-type]  # texts
    for path, value, meta, origin in rows:
        print(f"{path:{width}}  {value:{value_width}}  {meta.unit:14}  {origin}".rstrip())
        if arguments.explain:
            print(f"{'':{width}}  {meta.text}")
    if (calibration := pipeline.calibration) is not None:
        (low, high), (cold, warm) = calibration.rate_range_deg_s, calibration.temperature_range_c
        source = ", ".join(f"{k} {v}" for k, v in calibration.provenance.items() if not k.startswith("sha256"))
        print(f"calibration holds from {low:.4g} to {high:.4g} deg/s and {cold:.4g} to {warm:.4g} degC: {source}")
    print(f"the gyro's scale is {'' if pipeline.estimator.estimates_gyro_scale else 'not '}estimated")
    print(f"wheel travel is resolved to {pipeline.encoders.resolution_m * 1e3:.4g} mm")
    output = loaded.value.output
    if output.ros2 and not output.connect and output.zenoh_config is None:
        print(
            "note: ROS 2's router is usually at tcp/localhost:7447; name it in output.connect and change output.listen"
        )
    print(f"{arguments.config}: good")
    return 0


def _keys(section: Any, prefix: str = "") -> list[tuple[str, Any, Key]]:
    """All leaves of a configuration as (path, value, key)."""
    found: list[tuple[str, Any, Key]] = []
    for f in dataclasses.fields(section):
        value, path = getattr(section, f.name), f"{prefix}{f.name}"
        if dataclasses.is_dataclass(value):
            found += _keys(value, f"{path}.")
        else:
            found.append((path, value, f.metadata["key"]))
    return found


def _shown(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if value is None:
        return "null"
    if isinstance(value, tuple):
        return f"[{', '.join(map(str, value))}]"
    return f"{value:.12g}" if isinstance(value, float) else str(value)
