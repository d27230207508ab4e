"""Rate-table files: what is wrong with one is said with file, line and column, and with the likely cause."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from rate_table_data import samples, write_csv, write_table

from drd.arrays import Array
from drd.config.schema import ConfigError
from drd_tools.calibrate.gyro.rate_table import RateTable, data_sets, files_in, read_rate_table

HEADER = "time_s,table_rate_deg_s,rate_deg_s,temperature_c\n"
Columns = tuple[Array, Array, Array, Array]


def refused(file: Path, text: str) -> str:
    file.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        read_rate_table(file)
    return str(caught.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "expected the header time_s,table_rate_deg_s,rate_deg_s,temperature_c (in any order"),
        (HEADER, "expected at least 1 row of numbers, got 0"),
        (
            "time_s,table_rate_deg_s,rate_deg_s\n1,2,3\n",
            ":1: header: expected time_s,table_rate_deg_s,rate_deg_s,temperature_c",
        ),
        (HEADER.replace(",", ";") + "1;2;3;4\n", "commas between them"),
        (HEADER + "1,2,3,4\n2,2,nan,4\n", ":3: rate_deg_s: expected a finite number, got 'nan'"),
        (
            HEADER + "1,2,3,4\n2,2,3,\n",
            ":3: temperature_c: expected a finite number (of a gyro without a sensor, a thermometer's), got ''",
        ),
        (
            HEADER + "1,2,3,4\n2,2,3\n",
            ":3: temperature_c: expected a finite number (of a gyro without a sensor, a thermometer's), got ''",
        ),
        (HEADER + "1,2,3,4\n\n2,fast,3,4\n", ":4: table_rate_deg_s: expected a finite number, got 'fast'"),
        (HEADER + "1,2,3,4\n2,inf,3,4\n", ":3: table_rate_deg_s: expected a finite number, got 'inf'"),
        (HEADER + "1,2,3,4\n2,2,3,4\n2,2,3,4\n", ":4: time_s: expected a time after 2, got 2"),
    ],
)
def test_a_bad_file_is_refused_with_its_line_and_column(tmp_path: Path, text: str, said: str) -> None:
    message = refused(tmp_path / "rates.csv", text)
    assert "rates.csv" in message
    assert said in message


def test_columns_may_stand_in_any_order_beside_others(tmp_path: Path) -> None:
    file = tmp_path / "rates.csv"
    file.write_bytes(
        b"\xef\xbb\xbfnote,rate_deg_s, time_s,temperature_c,table_rate_deg_s\r\nx,1,2,3,4\r\ny,5,6,7,8\r\n"
    )
    table = read_rate_table(file)
    assert table.time_s.tolist() == [2.0, 6.0]
    assert table.table_rate_deg_s.tolist() == [4.0, 8.0]
    assert table.temperature_c.tolist() == [3.0, 7.0]
    assert table.rate_deg_s.tolist() == [1.0, 5.0]
    assert len(table.sha256) == 64


def test_files_and_folders_are_found_and_none_is_taken_twice(tmp_path: Path) -> None:
    for name in ("b.csv", "a.csv", "notes.txt"):
        (tmp_path / name).write_text("")
    assert [file.name for file in files_in([tmp_path])] == ["a.csv", "b.csv"]
    with pytest.raises(ConfigError, match=r"a\.csv.*twice"):
        files_in([tmp_path, tmp_path / "a.csv"])
    (tmp_path / "empty").mkdir()
    with pytest.raises(ConfigError, match=r"rate-table files \*\.csv, got none"):
        files_in([tmp_path / "empty"])
    with pytest.raises(ConfigError, match="No such file"):
        read_rate_table(tmp_path / "nowhere.csv")


def table(columns: Columns) -> RateTable:
    return RateTable(Path("rates.csv"), *columns, "0" * 64)


def plain(seed: int = 1) -> Columns:
    return samples(np.random.default_rng(seed))


MIX_UPS: dict[str, tuple[Callable[[Columns], Columns], str]] = {
    "table and gyro": (lambda c: (c[0], c[2], c[1], c[3]), "rate_deg_s is held: the two columns look swapped"),
    "gyro and temperature": (
        lambda c: (c[0], c[1], c[3], c[2]),
        "while temperature_c does: the two columns look swapped",
    ),
    "table and temperature": (
        lambda c: (c[0], c[3], c[2], c[1]),
        "table_rate_deg_s and temperature_c look swapped",
    ),
    "sign": (lambda c: (c[0], c[1], -c[2], c[3]), "opposite signs; check the table's sign and fog.positive"),
    "gyro in rad/s": (lambda c: (c[0], c[1], np.radians(c[2]), c[3]), "rate_deg_s looks like rad/s"),
    "table in rad/s": (lambda c: (c[0], np.radians(c[1]), c[2], c[3]), "table_rate_deg_s looks like rad/s"),
    "volts": (
        lambda c: (c[0], c[1], 0.4 * c[2], c[3]),
        "the two columns do not belong together, or their units differ",
    ),
    "another run": (lambda c: (c[0], c[1], np.roll(c[2], 300), c[3]), "the two columns do not belong together"),
    "kelvin": (lambda c: (*c[:3], c[3] + 273.15), "it looks like kelvin"),
}


@pytest.mark.parametrize("name", MIX_UPS)
def test_columns_that_contradict_each_other_are_refused_with_the_likely_cause(name: str) -> None:
    mix_up, said = MIX_UPS[name]
    with pytest.raises(ConfigError) as caught:
        data_sets([table(mix_up(plain()))])
    assert said in str(caught.value)
    assert str(caught.value).startswith("rates.csv: ")


def one_rate_each(rates: tuple[float, ...]) -> list[Columns]:
    return [samples(np.random.default_rng(k), (rate,), settle_s=0.0) for k, rate in enumerate(rates)]


def test_one_file_for_each_rate_is_as_good_and_is_checked_as_a_whole() -> None:
    parts = one_rate_each((-80.0, -40.0, 0.0, 40.0, 80.0))
    files = [RateTable(Path(f"{k}.csv"), *part, "0" * 64) for k, part in enumerate(parts)]
    assert data_sets(files).table_rate_deg_s.tolist() == pytest.approx([-80.0, -40.0, 0.0, 40.0, 80.0])
    turned = [RateTable(Path(f"{k}.csv"), p[0], p[1], -p[2], p[3], "0" * 64) for k, p in enumerate(parts)]
    with pytest.raises(ConfigError, match=r"5 files: rate_deg_s.*opposite signs"):
        data_sets(turned)


@pytest.mark.parametrize("rate", [0.0, 30.0])
def test_a_table_that_never_turns_is_for_another_command(rate: float) -> None:
    with pytest.raises(ConfigError, match=rf"got {rate:g} deg/s throughout.*`drd calibrate noise`"):
        data_sets([table(one_rate_each((rate,))[0])])


def test_dwells_shorter_than_the_settling_time_are_an_error() -> None:
    with pytest.raises(ConfigError, match=r"settling time of 9 s.*--settle"):
        data_sets([table(plain())], settle_s=9.0)


def test_the_earths_rate_at_the_latitude_is_part_of_the_true_rate() -> None:
    without, north, south = (data_sets([table(plain())], latitude_deg=lat) for lat in (None, 90.0, -30.0))
    assert north.table_rate_deg_s - without.table_rate_deg_s == pytest.approx(15.041 / 3600.0)
    assert south.error_deg_s - without.error_deg_s == pytest.approx(0.5 * 15.041 / 3600.0)


def test_good_files_give_their_data_sets_with_their_places(tmp_path: Path) -> None:
    folder = write_table(tmp_path / "table", np.random.default_rng(1), temperatures=(0, 40), spikes=0.03)
    data = data_sets([read_rate_table(file) for file in files_in([folder])])
    assert len(data) == 22
    assert data.label[0] == "rates_+0c.csv, 1.1 to 8.0 s"
    assert data.spikes.sum() > 20


def test_low_noise_readings_on_steps_are_not_taken_for_the_table(tmp_path: Path) -> None:
    t, w, g, T = plain()
    file = write_csv(tmp_path / "rates.csv", (t, w, 0.5 * np.round(g / 0.5), T))
    assert len(data_sets([read_rate_table(file)])) == 11
