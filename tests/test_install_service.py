"""`drd install-service` under a folder of the test, which plays the root of a system."""

import grp
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from drd.cli import main
from drd.commands import install_service
from drd.commands.install_service import CONFIGS, DROP_INS, EXAMPLES, PROGRAM_IN_UNIT, RULES, UNIT
from drd.commands.installation import MANIFEST, Installation
from drd.config.schema import ConfigError

CHECKOUT = Path(__file__).parents[1]
PROGRAM = "/usr/lib/robots/drd"
CONFIG = f"{CONFIGS}/mybot.yaml"


def drd(root: Path, *arguments: str) -> int:
    return main(["install-service", "--root", str(root), *arguments])


def install(root: Path, *arguments: str) -> int:
    return drd(root, "mybot", "--program", PROGRAM, *arguments)


def tree(root: Path) -> dict[str, str]:
    """Every file by its path."""
    return {str(f.relative_to(root)): f.read_text() for f in sorted(root.rglob("*")) if f.is_file()}


def test_unit_rules_and_example_are_those_that_drd_carries(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert install(tmp_path, "--example", "odrive") == 0
    files = tree(tmp_path)
    assert sorted(files) == sorted([UNIT, RULES, CONFIG, MANIFEST])
    shipped = (CHECKOUT / "systemd/drd@.service").read_text()
    assert files[UNIT] == shipped.replace(f"ExecStart={PROGRAM_IN_UNIT} ", f"ExecStart={PROGRAM} ")
    assert f"ExecStart={PROGRAM} run /etc/drd/%i.yaml\n" in files[UNIT]
    assert files[RULES] == (CHECKOUT / "systemd/99-drd.rules").read_text()
    assert files[CONFIG] == (CHECKOUT / "config/odrive.yaml").read_text()
    output = capsys.readouterr().out
    for name in (UNIT, RULES, CONFIG):
        assert re.search(rf"^wrote +{tmp_path}/{re.escape(name)} ", output, re.MULTILINE)
    assert "systemctl" not in output, "a package is not started"


def test_the_examples_are_the_configurations_for_real_robots() -> None:
    assert sorted(EXAMPLES) == sorted({f.stem for f in (CHECKOUT / "config").glob("*.yaml")} - {"demo"})


def test_what_is_written_can_be_read_by_the_service_whatever_the_umask(tmp_path: Path) -> None:
    before = os.umask(0o077)
    try:
        install(tmp_path)
    finally:
        os.umask(before)
    for path in tmp_path.rglob("*"):
        assert path.stat().st_mode & 0o777 == (0o755 if path.is_dir() else 0o644), path


def test_a_second_time_changes_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    install(tmp_path, "--realtime", "--tls")
    before = tree(tmp_path)
    capsys.readouterr()
    assert install(tmp_path) == 0
    assert tree(tmp_path) == before
    assert not re.search(r"^(wrote|updated)", capsys.readouterr().out, re.MULTILINE)


def test_realtime_and_tls_bring_their_drop_ins_and_the_configuration_of_this_instance(tmp_path: Path) -> None:
    install(tmp_path, "--realtime", "--tls")
    files = tree(tmp_path)
    for name in ("realtime.conf", "tls.conf"):
        assert files[f"{DROP_INS}/{name}"] == (CHECKOUT / "systemd" / name).read_text()
    assert "/run/credentials/drd@mybot.service/robot.key" in files[f"{CONFIGS}/mybot-tls.json5"]


def test_another_version_replaces_what_nobody_has_changed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path, "--realtime")
    shipped = install_service._shipped
    monkeypatch.setattr(install_service, "_shipped", lambda folder, name: shipped(folder, name) + "# newer\n")
    assert drd(tmp_path, "mybot", "--program", "/opt/other/drd") == 0
    files = tree(tmp_path)
    for name in (UNIT, RULES, f"{DROP_INS}/realtime.conf"):
        assert files[name].endswith("# newer\n")
    assert "ExecStart=/opt/other/drd " in files[UNIT]
    assert not files[CONFIG].endswith("# newer\n"), "the configuration is its owner's"
    assert not [name for name in files if name.endswith(".new")]


@pytest.mark.parametrize("name", [UNIT, RULES])
def test_a_changed_file_is_kept_and_the_new_one_lies_beside_it(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    install(tmp_path)
    mine = (tmp_path / name).read_text() + "# mine\n"
    (tmp_path / name).write_text(mine)
    shipped = install_service._shipped
    monkeypatch.setattr(install_service, "_shipped", lambda folder, file: shipped(folder, file) + "# newer\n")
    assert install(tmp_path) == 0
    assert (tmp_path / name).read_text() == mine
    assert (tmp_path / f"{name}.new").read_text().endswith("# newer\n")
    assert re.search(rf"^kept +{tmp_path}/{re.escape(name)} .*{Path(name).name}\.new", capsys.readouterr().out, re.M)
    shutil.copy(tmp_path / f"{name}.new", tmp_path / name)
    assert install(tmp_path) == 0
    assert f"{name}.new" not in tree(tmp_path), "merged: no longer needed"


def test_a_file_that_somebody_else_put_there_is_kept_too(tmp_path: Path) -> None:
    (tmp_path / UNIT).parent.mkdir(parents=True)
    (tmp_path / UNIT).symlink_to("/dev/null")  # as `systemctl mask` does
    (tmp_path / CONFIG).parent.mkdir(parents=True)
    (tmp_path / CONFIG).write_text("mine")
    assert install(tmp_path) == 0
    assert (tmp_path / UNIT).readlink() == Path("/dev/null")
    assert (tmp_path / CONFIG).read_text() == "mine"
    assert drd(tmp_path, "--uninstall", "--purge") == 0
    assert tree(tmp_path) == {CONFIG: "mine"}
    assert (tmp_path / UNIT).is_symlink()


def test_uninstall_leaves_the_configuration_and_purge_leaves_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = tmp_path / "root"
    root.mkdir()
    install(root, "--realtime", "--tls")
    wants = root / "etc/systemd/system/multi-user.target.wants"
    wants.mkdir()
    (wants / "drd@mybot.service").symlink_to(f"/{UNIT}")
    (wants / "other.service").symlink_to("/elsewhere")
    for folder in ("var/lib/private/drd-mybot/recordings", "var/lib/drd-another"):
        (root / folder).mkdir(parents=True)
    (root / "var/lib/private/drd-mybot/recordings/run.mcap").write_text("data")
    (root / "var/lib/drd-mybot").symlink_to("private/drd-mybot")
    capsys.readouterr()
    assert drd(root, "--uninstall") == 0
    kept = [CONFIG, f"{CONFIGS}/mybot-tls.json5", "var/lib/private/drd-mybot"]
    output = capsys.readouterr().out
    assert [f"{root}/{name}" for name in kept] == re.findall(r"^kept +(\S+)", output, re.MULTILINE)
    assert sorted(tree(root)) == sorted([*kept[:2], MANIFEST, "var/lib/private/drd-mybot/recordings/run.mcap"])
    assert [link.name for link in wants.iterdir()] == ["other.service"]
    assert drd(root, "--uninstall", "--purge") == 0
    (wants / "other.service").unlink()
    wants.rmdir()
    assert tree(root) == {}
    assert sorted(str(p.relative_to(root)) for p in root.rglob("*")) == [
        "etc", "etc/systemd", "etc/systemd/system",  # they held somebody else's folder
        "var", "var/lib", "var/lib/drd-another", "var/lib/private",
    ]  # fmt: skip


def test_without_anybody_elses_files_not_even_a_folder_is_left(tmp_path: Path) -> None:
    install(tmp_path, "--realtime", "--tls")
    drd(tmp_path, "--uninstall", "--purge")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("in_two_steps", [False, True])
def test_the_state_goes_with_a_configuration_that_was_there_before(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], in_two_steps: bool
) -> None:
    (tmp_path / CONFIG).parent.mkdir(parents=True)
    (tmp_path / CONFIG).write_text("mine")
    install(tmp_path)
    state = tmp_path / "var/lib/private/drd-mybot"
    (state / "recordings").mkdir(parents=True)
    (tmp_path / "var/lib/drd-mybot").symlink_to("private/drd-mybot")
    if in_two_steps:
        assert drd(tmp_path, "--uninstall") == 0
        assert state.is_dir()
        assert re.search(rf"^kept +{state} +\(state", capsys.readouterr().out, re.M)
    assert drd(tmp_path, "--uninstall", "--purge") == 0
    assert re.search(rf"^removed +{state}", capsys.readouterr().out, re.M)
    assert list((tmp_path / "var/lib").rglob("drd*")) == []
    assert tree(tmp_path) == {CONFIG: "mine"}


def test_uninstall_keeps_what_was_changed_and_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    install(tmp_path)
    (tmp_path / RULES).write_text("my serial number")
    drd(tmp_path, "--uninstall")
    assert (tmp_path / RULES).read_text() == "my serial number"
    assert not (tmp_path / UNIT).exists()
    assert re.search(
        rf"^kept +{tmp_path}/{re.escape(RULES)} +\(changed; --purge removes it\)", capsys.readouterr().out, re.M
    )
    drd(tmp_path, "--uninstall", "--purge")
    assert list(tmp_path.iterdir()) == []


def test_nothing_to_uninstall_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert drd(tmp_path, "--uninstall", "--purge") == 0
    assert "nothing is installed" in capsys.readouterr().out


@pytest.mark.parametrize(
    "arguments", [(), ("--purge", "x"), ("--uninstall", "x"), ("../x",), ("a b",), ("x", "--example", "none")]
)
def test_bad_usage_is_refused_before_anything_is_written(tmp_path: Path, arguments: tuple[str, ...]) -> None:
    with pytest.raises(SystemExit) as end:
        drd(tmp_path, *arguments)
    assert end.value.code == 2
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "text",
    ["{", "[]", '{"version": 2}', '{"version": 1, "files": {"../../x": ""}, "folders": []}',
     '{"version": 1, "files": {"/etc/passwd": ""}, "folders": []}'],
)  # fmt: skip
def test_a_damaged_manifest_is_refused(tmp_path: Path, text: str, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / MANIFEST).parent.mkdir(parents=True)
    (tmp_path / MANIFEST).write_text(text)
    assert drd(tmp_path, "--uninstall", "--purge") == 2
    assert ".installed.json" in capsys.readouterr().err
    assert (tmp_path / MANIFEST).read_text() == text


def test_a_program_that_systemd_could_not_start_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for program in ("bin/drd", "/opt/my robot/drd", "/opt/50%/drd"):
        assert drd(tmp_path, "mybot", "--program", program) == 2
    assert list(tmp_path.iterdir()) == []
    assert "absolute path" in capsys.readouterr().err


def test_on_the_running_system_the_program_must_be_there_and_in_sight(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ConfigError, match="is not there"):
        install_service._program("/usr/bin/no-such-drd", Path("/"))
    monkeypatch.setattr(install_service, "HIDDEN", ("/usr/bin",))
    with pytest.raises(ConfigError, match="does not see"):
        install_service._program("/usr/bin/env", Path("/"))
    monkeypatch.setattr(install_service, "HIDDEN", (str(CHECKOUT),))
    with pytest.raises(ConfigError, match="does not see"):
        install_service._program(None, Path("/"))


@pytest.mark.parametrize(
    ("groups", "expected"), [(["dialout", "uucp"], "dialout"), (["uucp"], "uucp"), ([], "dialout")]
)
def test_the_group_of_unit_and_rules_is_the_one_that_the_system_has(
    monkeypatch: pytest.MonkeyPatch, groups: list[str], expected: str
) -> None:
    monkeypatch.setattr(grp, "getgrall", lambda: [SimpleNamespace(gr_name=name) for name in groups])
    assert install_service._serial_group(Path("/")) == expected
    assert f"SupplementaryGroups={expected}\n" in install_service._unit("/usr/bin/drd", expected)
    assert set(re.findall(r'GROUP="(\w+)"', install_service._rules(expected))) == {expected}


def test_a_folder_that_cannot_be_written_is_named_and_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(_: Installation, name: str, *__: Any) -> None:
        raise PermissionError(13, "Permission denied", f"/{name}")

    monkeypatch.setattr(Installation, "put", refuse)
    assert install(tmp_path) == 1
    assert capsys.readouterr().err == f"drd install-service: /{UNIT}: Permission denied; it needs root\n"


def test_systemd_takes_the_installed_unit(tmp_path: Path) -> None:
    if shutil.which("systemd-analyze") is None:
        pytest.skip("systemd-analyze is not installed")
    drd(tmp_path, "mybot", "--program", "/bin/true", "--realtime", "--tls")
    command = ["systemd-analyze", "verify", "./drd@mybot.service"]
    done = subprocess.run(command, cwd=(tmp_path / UNIT).parent, capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr, done.returncode) == ("", "", 0)


def test_the_installed_example_is_good(tmp_path: Path) -> None:
    install(tmp_path)
    done = subprocess.run(
        [sys.executable, "-m", "drd", "check", str(tmp_path / CONFIG)], capture_output=True, check=False
    )
    assert done.returncode == 0


def fake_environment(folder: Path, exit_code: int = 0) -> Path:
    """A program with a Python beside it, which writes down what it is called with."""
    (folder / "bin").mkdir()
    for name in ("drd", "python3"):
        (folder / "bin" / name).write_text(f'#!/bin/sh\necho "$@" > {folder}/called\nexit {exit_code}\n')
        (folder / "bin" / name).chmod(0o755)
    return folder / "bin/drd"


@pytest.mark.parametrize(
    ("given", "used"), [("shipped", CHECKOUT / "systemd/robot.lock"), ("/x/my.lock", "/x/my.lock")]
)
def test_a_lock_file_is_installed_first_with_its_hashes_required(tmp_path: Path, given: str, used: object) -> None:
    program = fake_environment(tmp_path)
    arguments = install_service._parser().parse_args(["mybot", "--program", str(program), "--lock", given])
    install_service._install(tmp_path / "root", arguments)
    called = (tmp_path / "called").read_text().split()
    assert called[:3] == ["-m", "pip", "install"]
    assert {"--require-hashes", "--only-binary=:all:"} < set(called)
    assert called[-2:] == ["--requirement", str(used)]
    assert (tmp_path / "root" / UNIT).exists()


def test_packages_that_are_not_as_locked_install_nothing(tmp_path: Path) -> None:
    program = fake_environment(tmp_path, exit_code=1)
    arguments = install_service._parser().parse_args(["mybot", "--program", str(program), "--lock", "shipped"])
    with pytest.raises(ConfigError, match="packages as they were locked"):
        install_service._install(tmp_path / "root", arguments)
    assert tree(tmp_path / "root") == {}


def test_a_lock_file_goes_with_the_running_system_only(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        install(tmp_path, "--lock", "shipped")
    assert "--lock goes with" in capsys.readouterr().err
