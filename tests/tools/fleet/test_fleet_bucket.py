"""A bucket works as a folder does, for recordings and for the store: against a server of this machine."""

import socket
from collections.abc import Iterator
from pathlib import Path

import pytest
from fleet_stub import fleet

from drd_tools.fleet.analysis import analysed
from drd_tools.fleet.discover import contents, discover, fetched
from drd_tools.fleet.engine import Engine
from drd_tools.fleet.files import Files
from drd_tools.fleet.store import Store
from drd_tools.fleet.update import Updated, update

server = pytest.importorskip("moto.server", reason="moto is not installed; `make setup` brings it")
s3fs = pytest.importorskip("s3fs", reason="s3fs is not installed; `make setup` brings it")


@pytest.fixture
def bucket(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    running = server.ThreadedMotoServer("127.0.0.1", port, verbose=False)
    running.start()
    for name, value in {
        "AWS_ENDPOINT_URL": f"http://127.0.0.1:{port}",
        "AWS_ACCESS_KEY_ID": "test",
        "AWS_SECRET_ACCESS_KEY": "test",
        "AWS_DEFAULT_REGION": "us-east-1",
    }.items():
        monkeypatch.setenv(name, value)
    s3fs.S3FileSystem.clear_instance_cache()
    # What the server keeps outlives it: another bucket each time.
    s3fs.S3FileSystem().mkdir(f"robots-{port}")
    yield f"s3://robots-{port}"
    s3fs.S3FileSystem.clear_instance_cache()
    running.stop()


def upload(folder: Path, bucket: str) -> None:
    files = Files(bucket)
    for file in folder.rglob("*.csv"):
        files.write(str(file.relative_to(folder)), file.read_bytes())


def test_a_bucket_works_as_a_folder_does(tmp_path: Path, bucket: str) -> None:
    runs = fleet(tmp_path / "runs", 3)
    upload(runs, f"{bucket}/2026")
    # No recordings for the analysis: it says so of each, in another process that reads the bucket, too.
    store = Store(f"{bucket}/fleet")
    made = update([f"{bucket}/2026"], store, (), Engine(), analysed)
    assert (made.found, made.analysed, len(made.failures)) == (3, 3, 3)
    assert made.failures[0][0] == "run_000"
    assert f"{bucket}/2026/run_000: robot.yaml: expected this file in the folder" in made.failures[0][1]
    assert update([f"{bucket}/2026"], Store(f"{bucket}/fleet"), (), Engine()) == Updated(3, 0, 0, 0, made.failures)
    assert store.pending() == []
    assert sorted(store.table("errors")["recording"].to_pylist()) == ["run_000", "run_001", "run_002"]
    assert "errors/unknown/undated.parquet" in store.files.below("", ".parquet")
    (runs / "run_001" / "fog.csv").write_text("100")
    upload(runs, f"{bucket}/2026")
    assert update([f"{bucket}/2026"], store, (), Engine()).analysed == 1


def test_what_is_fetched_from_a_bucket_is_what_lies_there(tmp_path: Path, bucket: str) -> None:
    runs = fleet(tmp_path / "runs", 2)
    upload(runs, bucket)
    for here, there in zip(discover([runs]), discover([bucket]), strict=True):
        assert (here.name, here.files) == (there.name, there.files)
        with fetched(here) as one, fetched(there) as two:
            assert contents(one, here) == contents(two, there)
        assert not two.exists()
