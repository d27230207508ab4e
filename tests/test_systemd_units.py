import os
import re
import shutil
import subprocess
from collections.abc import Iterable
from pathlib import Path

import pytest

SYSTEMD = Path(__file__).parents[1] / "systemd"
UNIT = (SYSTEMD / "drd@.service").read_text()
PROGRAM = "/opt/drd/bin/drd"


def analyze(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    if shutil.which("systemd-analyze") is None:
        if "CI" in os.environ:
            pytest.fail("systemd-analyze is missing")
        pytest.skip("systemd-analyze is not installed")
    return subprocess.run(["systemd-analyze", *arguments], cwd=cwd, capture_output=True, text=True, check=False)


def installed(folder: Path, drop_ins: Iterable[str] = (), extra: str = "") -> None:
    """The unit as an installation has it, with a program that exists here in the place of drd."""
    (folder / "drd@.service").write_text(UNIT.replace(PROGRAM, "/bin/true") + extra)
    (folder / "drd@.service.d").mkdir()
    for name in drop_ins:
        shutil.copy(SYSTEMD / name, folder / "drd@.service.d")


def settings(text: str) -> list[tuple[str, str]]:
    return re.findall(r"^(\w+)=(.*)$", text, re.MULTILINE)


@pytest.mark.parametrize("drop_ins", [(), ("realtime.conf",), ("realtime.conf", "slcan.conf", "tls.conf")])
def test_systemd_has_nothing_to_say_against_the_unit(tmp_path: Path, drop_ins: tuple[str, ...]) -> None:
    installed(tmp_path, drop_ins)
    result = analyze("verify", "./drd@test.service", cwd=tmp_path)
    assert (result.stdout, result.stderr, result.returncode) == ("", "", 0)


def test_the_check_sees_an_unknown_key(tmp_path: Path) -> None:
    installed(tmp_path, extra="\n[Service]\nNoSuchKey=1\n")
    assert "NoSuchKey" in analyze("verify", "./drd@test.service", cwd=tmp_path).stderr


@pytest.mark.parametrize(
    ("drop_ins", "most"), [((), 14), (("tls.conf",), 14), (("slcan.conf",), 12), (("realtime.conf",), 16)]
)
def test_the_exposure_is_low(tmp_path: Path, drop_ins: tuple[str, ...], most: int) -> None:
    """Ten times systemd's figure. What is left is what the daemon does: network, CAN, serial devices."""
    installed(tmp_path, drop_ins)
    result = analyze("security", "--offline=yes", f"--threshold={most}", "./drd@.service", cwd=tmp_path)
    assert result.returncode == 0, result.stdout


def test_each_point_of_the_exposure_is_explained(tmp_path: Path) -> None:
    """README's table has as many points as systemd counts; two of them are of the devices."""
    installed(tmp_path)
    said = analyze("security", "--offline=yes", "--no-pager", "./drd@.service", cwd=tmp_path).stdout
    points = re.findall(r"^✗ ", said, re.MULTILINE)
    rows = re.findall(r"^\| [^|]+ \| (0\.\d) \| \S", (SYSTEMD / "README.md").read_text(), re.MULTILINE)
    assert len(rows) + 1 == len(points), said
    sizes = re.findall(r"^✗ .* (0\.\d)\s*$", said, re.MULTILINE)
    assert sum(map(float, rows)) == pytest.approx(sum(map(float, sizes)))


def test_nothing_but_the_state_can_be_written() -> None:
    """Neither drd's code nor its configuration, its unit or the system: the VM's probe tries them."""
    found = settings(UNIT)
    for name in ("realtime.conf", "slcan.conf", "tls.conf"):
        found += settings((SYSTEMD / name).read_text())
    keys = {key for key, _ in found}
    assert {("ProtectSystem", "strict"), ("ProtectHome", "yes"), ("DynamicUser", "yes")} <= set(found)
    opening = {
        "ReadWritePaths",
        "BindPaths",
        "User",
        "Group",
        "ConfigurationDirectory",
        "CacheDirectory",
        "LogsDirectory",
    }
    assert not keys & {*opening, "RuntimeDirectory"}
    assert [value for key, value in found if key == "StateDirectory"] == ["drd-%i"]


@pytest.mark.parametrize(
    "key",
    ["SystemCallFilter", "RestrictAddressFamilies", "DeviceAllow", "CapabilityBoundingSet", "SupplementaryGroups"],
)
def test_what_the_sandbox_lets_through_is_explained(key: str) -> None:
    """Each name stands in the comment above it; a setting with one value or none needs some comment."""
    lines = UNIT.splitlines()
    found = [i for i, line in enumerate(lines) if line.startswith(f"{key}=")]
    assert found
    for i in found:
        comment, j = "", i - 1
        while lines[j].startswith(("#", f"{key}=")):
            comment, j = f"{lines[j]} {comment}" if lines[j].startswith("#") else comment, j - 1
        assert len(comment) > 20, lines[i]
        for name in lines[i].split("=", 1)[1].split():
            if name.startswith(("@", "AF_")):
                assert re.search(rf"{name}\b", comment), name


def test_the_sandbox_leaves_what_the_daemon_needs() -> None:
    found = settings(UNIT)
    values = dict(found)
    assert values["ExecStart"] == f"{PROGRAM} run /etc/drd/%i.yaml"
    assert values["Type"] == "notify"
    assert {"AF_UNIX", "AF_INET", "AF_INET6", "AF_CAN"} <= set(values["RestrictAddressFamilies"].split())
    assert {"char-ttyUSB rw", "char-ttyACM rw", "char-ttyS rw"} <= {v for k, v in found if k == "DeviceAllow"}
    assert values["SupplementaryGroups"] == "dialout"
    assert not {"PrivateDevices", "PrivateNetwork"} & values.keys()
    assert values["Restart"] == "on-failure"


def test_the_drop_in_gives_back_what_real_time_needs() -> None:
    values = dict(settings((SYSTEMD / "realtime.conf").read_text()))
    assert values["RestrictRealtime"] == "no"
    assert values["LimitMEMLOCK"] == "infinity"
    assert int(values["LimitRTPRIO"]) >= int(values["CPUSchedulingPriority"])
    assert {"@resources", "@memlock"} == set(values["SystemCallFilter"].split())


def test_the_key_of_tls_is_where_the_shipped_zenoh_file_looks_for_it() -> None:
    name, _ = dict(settings((SYSTEMD / "tls.conf").read_text()))["LoadCredential"].split(":")
    shipped = (SYSTEMD.parent / "config" / "zenoh-tls.json5").read_text()
    assert f'listen_private_key: "/run/credentials/drd@mybot.service/{name}"' in shipped


def test_no_active_udev_rule_names_a_device_without_its_serial_number() -> None:
    rules = [line for line in (SYSTEMD / "99-drd.rules").read_text().splitlines() if line and not line.startswith("#")]
    naming = [rule for rule in rules if "SYMLINK" in rule]
    assert naming
    for rule in naming:
        assert "ATTRS{serial}==" in rule
        assert 'ENV{ID_MM_DEVICE_IGNORE}="1"' in rule
    for rule in rules:
        assert re.fullmatch(r'(?:\w+(?:\{\w+\})?(?:==|!=|=|\+=)"[^"]*"(?:, |$))+', rule), rule
