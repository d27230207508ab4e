import json
import math
import os
from pathlib import Path

import pytest
from bench import clients, latency, timing
from bench.__main__ import BENCHMARKS, main
from bench.audience import HEARD_PER_POSE, check_heard
from bench.cpu import usage
from bench.report import Refused, table

from drd.estimation.filter import Filter, Outcome

FIGURES = {"filter": 3, "allocation": 4, "rates": 3, "latency": 8, "cpu": 4, "flood": 9, "clients": 17, "recording": 7,
           "replay": 3, "load": 15, "overload": 25, "fleet": 3, "realtime": 19}  # fmt: skip
PROCESSES = {"cpu", "flood", "clients", "recording", "load", "overload", "fleet", "realtime"}
# Zero is what they are to be; of `clients`, the idle share of a busy machine.
MAY_BE_ZERO = {"allocation", "realtime", "clients", "overload"}


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.process] if name in PROCESSES else []) for name in BENCHMARKS],
)
def test_each_benchmark_gives_all_its_figures(name: str) -> None:
    report = BENCHMARKS[name](True)
    # Where SCHED_FIFO is refused, load has only the first six.
    assert len(report.figures) in ({6, 15} if name == "load" else {FIGURES[name]})
    for figure in report.figures:
        assert math.isfinite(figure.value)
        assert figure.value > 0 or name in MAY_BE_ZERO
        assert figure.ratio is None or 0 < figure.ratio < math.inf
        assert figure.name in table(report)
    assert "\n" not in report.reading


def test_the_command_prints_a_table_and_writes_the_same_figures_as_json(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "bench.json"
    assert main(["--quick", "--json", str(file), "filter", "rates"]) == 0
    printed, written = capsys.readouterr().out, json.loads(file.read_text(encoding="utf-8"))
    assert list(written["benchmarks"]) == ["filter", "rates"]
    for report in written["benchmarks"].values():
        assert report["reading"] in printed
        for figure in report["figures"]:
            assert f"{figure['value']:.4g}" in printed
    assert written["machine"]["packages"]["filterpy"]


def test_an_unknown_benchmark_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["no-such-thing"])
    assert "no-such-thing" in capsys.readouterr().err


def test_no_ratio_is_printed_where_the_two_filters_disagree(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    update = Filter.update

    def wrong(self: Filter, rate_rad_s: float) -> Outcome:
        outcome = update(self, rate_rad_s)
        self.P[3, 3] *= 1.0 + 1e-8
        return outcome

    monkeypatch.setattr(Filter, "update", wrong)
    assert main(["--quick", "filter"]) == 1
    captured = capsys.readouterr()
    assert "FilterPy" not in captured.out
    assert "differ" in captured.err


def test_the_ratio_of_a_pair_is_second_over_first() -> None:
    def work(count: int) -> None:
        sum(range(count))

    pairing = timing.compare(lambda: work(1_000), lambda: work(100_000), 20)
    assert pairing.ratio > 10.0
    assert pairing.second_s > pairing.first_s


def test_percentiles_are_values_that_occurred() -> None:
    values = [float(i) for i in range(100, 0, -1)]
    assert timing.percentile(values, 50) == 50.0
    assert timing.percentile(values, 99) == 99.0
    assert timing.percentile([7.0], 50) == 7.0


def test_latencies_are_counted_to_the_first_arrival_before_the_next_packet() -> None:
    written_ns = [i * 1_000_000 for i in range(100)]
    arrived_ns = [t_ns + 250_000 for t_ns in written_ns]
    assert latency.latencies_us(written_ns, arrived_ns) == [250.0] * 80
    with pytest.raises(Refused, match="70 of 80"):
        latency.latencies_us(written_ns, arrived_ns[:90])


def test_usage_of_this_process_is_read_from_proc() -> None:
    used = usage(os.getpid())
    assert used.cpu_s > 0
    assert 1 << 20 < used.resident_bytes < 1 << 36


def test_a_cost_is_compared_within_its_pair_and_the_spread_is_told() -> None:
    costs = (1.0, 3.0), (10.0, 11.0), (100.0, 120.0)
    pairs = [([a * i for i in range(1, 5)], [b * i for i in range(1, 5)]) for a, b in costs]
    shown = [(figure.value, figure.ratio) for figure in clients.figures(pairs)]
    for i in range(1, 5):
        expected = [(10 * i, None), (11 * i, 1.2), (11 * i, 1.1), (3 * i, 3.0)]
        assert shown[4 * i - 4 : 4 * i] == expected


@pytest.mark.parametrize("deaf", HEARD_PER_POSE)
def test_a_client_that_hears_too_little_is_told(deaf: str) -> None:
    heard = {name: 100 * each for name, each in HEARD_PER_POSE.items()}
    check_heard(heard, 100)
    with pytest.raises(Refused, match=f"^{deaf} heard"):
        check_heard(heard | {deaf: 85 * HEARD_PER_POSE[deaf]}, 100)
