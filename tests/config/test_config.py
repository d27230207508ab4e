from pathlib import Path

import pytest

from drd.config.file import load_config
from drd.config.schema import ConfigError

COUNTED = "encoders: {counts_per_revolution: 4096}"
DBC = "encoders: {layout: dbc, dbc: {file: a.dbc, quantity: %s}, left: {message: L, signal: p}, right: {message: R%s}}"


def write(folder: Path, text: str) -> Path:
    file = folder / "robot.yaml"
    file.write_text("robot: {wheel_radius_m: 0.1, tread_m: 0.5}\n" + text)
    return file


def test_two_sizes_and_the_counts_are_all_that_must_be_given(tmp_path: Path) -> None:
    config = load_config(write(tmp_path, COUNTED)).value
    assert (config.encoders.layout, config.fog.protocol) == ("cia406", "ecore")


@pytest.mark.parametrize(
    "text",
    [
        "encoders: {layout: agilex}",
        "encoders: {layout: agilex, left: {node: 2}}",  # one frame holds both sides
        "encoders: {layout: vesc}",
        "encoders: {layout: odrive}",
        "encoders: {layout: odrive, odrive: {message: counts}, counts_per_revolution: 8192}",
        DBC % ("speed", ", signal: p"),
        DBC % ("counts", ", signal: p") + "\n" + "fog: {protocol: none}",
        COUNTED + "\nestimation: {static_bias: {duration_s: 0}}",
        COUNTED + "\nestimation: {static_bias: {duration_s: 5, minimum_s: 5}}",
        COUNTED + "\noutput: {prefix: fleet/robot-7/drd}",
        COUNTED + "\noutput: {publish_on: wheels}\nfog: {protocol: none}",
        "encoders: {counts_per_revolution: 4096, cia406: {byte_offset: 4, byte_length: 4}}",
    ],
)
def test_keys_that_fit_together_are_taken(tmp_path: Path, text: str) -> None:
    text = text.replace("quantity: counts}", "quantity: counts}, counts_per_revolution: 100")
    load_config(write(tmp_path, text))


@pytest.mark.parametrize(
    ("text", "path"),
    [
        ("", "encoders.counts_per_revolution"),
        ("encoders: {layout: odrive, odrive: {message: counts}}", "encoders.counts_per_revolution"),
        (DBC % ("counts", ", signal: p"), "encoders.counts_per_revolution"),
        ("encoders: {layout: dbc, dbc: {quantity: speed}}", "encoders.dbc.file"),
        (DBC % ("speed", ""), "encoders.right.signal"),
        ("encoders: {layout: vesc, left: {node: 2}}", "encoders.right.node"),
        ("encoders: {counts_per_revolution: 9, left: {node: 7}, right: {node: 7}}", "encoders.right.node"),
        ("encoders: {counts_per_revolution: 9, cia406: {byte_offset: 5}}", "encoders.cia406.byte_length"),
        (COUNTED + "\nestimation: {static_bias: {duration_s: 4}}", "estimation.static_bias.minimum_s"),
        (COUNTED + "\noutput: {publish_on: gyro}\nfog: {protocol: none}", "output.publish_on"),
        ("encoders: {layout: agilex, interface: socketcann}", "encoders.interface"),
        (COUNTED + "\nfog: {latency_s: 0.2}", "estimation.reorder_s"),
        (COUNTED + "\nfog: {rate_hz: 2}\nestimation: {reorder_s: 1}", "fog.silent_after_s"),
        ("encoders: {layout: agilex, rate_hz: 2}", "encoders.silent_after_s"),
        ("encoders: {layout: agilex, latency_s: 0.4, gap_s: 0.1, silent_after_s: 1}", "encoders.gap_s"),
        *(
            (COUNTED + f"\noutput: {{prefix: '{p}'}}", "output.prefix")
            for p in ("a/*", "/a", "a/", "a//b", "a$b", "a?", "#", "@a", "a/@b")
        ),
    ],
)
def test_keys_that_contradict_each_other_are_refused_by_name(tmp_path: Path, text: str, path: str) -> None:
    file = write(tmp_path, text)
    with pytest.raises(ConfigError) as caught:
        load_config(file)
    assert caught.value.path == path
    # The line where the key stands, or the file alone where its default is in force.
    name = path.rpartition(".")[2]
    lines = [f"{file}:{n}" for n, line in enumerate(file.read_text().splitlines(), 1) if f"{name}:" in line]
    assert caught.value.where in (*lines, str(file))
    assert caught.value.expected
    assert caught.value.got
