"""Lock file, licences, bill of materials and audit of what runs on a robot."""

import hashlib
import json
import re
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from drd.commands.locked import install_locked
from drd.config.schema import ConfigError
from drd_tools.supply import __main__ as supply
from drd_tools.supply.audit import audit
from drd_tools.supply.licences import COMPATIBLE, licence
from drd_tools.supply.packages import installed
from drd_tools.supply.sbom import bill_of_materials

SYSTEMD = Path(__file__).parents[3] / "systemd"
LOCK = SYSTEMD / "robot.lock"


def locked() -> dict[str, list[tuple[Requirement, int]]]:
    """Each package's lines, with how many hashes each has."""
    found: dict[str, list[tuple[Requirement, int]]] = {}
    for line in LOCK.read_text().replace("\\\n", "").splitlines():
        if not line.startswith(("#", " ")):
            requirement = Requirement(line.split(" --hash", 1)[0])
            hashes = re.findall(r"--hash=sha256:[0-9a-f]{64}\b", line)
            found.setdefault(canonicalize_name(requirement.name), []).append((requirement, len(hashes)))
    return found


def asked() -> list[Requirement]:
    """The run-time dependencies of pyproject.toml."""
    with (SYSTEMD.parent / "pyproject.toml").open("rb") as file:
        return [Requirement(text) for text in tomllib.load(file)["project"]["dependencies"]]


def test_the_lock_file_has_all_that_the_daemon_needs_at_one_version_with_hashes() -> None:
    found = locked()
    assert {canonicalize_name(r.name) for r in asked()} <= set(found), "run `make lock`"
    for lines in found.values():
        for requirement, hashes in lines:
            assert [s.operator for s in requirement.specifier] == ["=="]
            assert hashes >= 1


@pytest.mark.parametrize("machine", ["x86_64", "aarch64"])
@pytest.mark.parametrize("python", ["3.11", "3.12", "3.13"])
def test_each_python_and_machine_gets_each_package_once(machine: str, python: str) -> None:
    place = {"platform_machine": machine, "sys_platform": "linux", "python_version": python,
             "python_full_version": f"{python}.1"}  # fmt: skip
    for name, lines in locked().items():
        fitting = [r for r, _ in lines if r.marker is None or r.marker.evaluate(place)]
        assert len(fitting) == 1, name


def test_the_lock_file_keeps_to_what_drd_asks_for() -> None:
    found = locked()
    for requirement in asked():
        for line, _ in found[canonicalize_name(requirement.name)]:
            (version,) = line.specifier
            assert requirement.specifier.contains(version.version), line


def is_compatible(expression: str) -> bool:
    """Whether one of its alternatives is of compatible licences alone. Raises ValueError for parentheses."""
    if "(" in expression:
        raise ValueError(f"{expression}: parentheses are not read")
    return any(all(part in COMPATIBLE for part in choice.split(" AND ")) for choice in expression.split(" OR "))


def test_each_package_has_a_licence_that_goes_with_apache_2_and_is_listed() -> None:
    """What is installed here may be newer than what is locked and listed: then its licence alone is asked."""
    listed = dict(re.findall(r"^\| (\w\S+) \| ([^|]+) \|$", (SYSTEMD / "LICENCES.md").read_text(), re.MULTILINE))
    assert set(locked()) <= set(listed), "run `make licences`"
    for name, package in installed().items():
        assert is_compatible(licence(package)), name
    for name, text in listed.items():
        assert is_compatible(text), name


def test_other_licences_are_refused() -> None:
    for expression in ("GPL-3.0-only", "AGPL-3.0-or-later", "MIT AND GPL-2.0-only", "EPL-2.0", "proprietary"):
        assert not is_compatible(expression)
    assert is_compatible("GPL-2.0-only OR MIT AND BSD-3-Clause")


def test_the_bill_of_materials_is_cyclonedx() -> None:
    pytest.importorskip("jsonschema")
    validation = pytest.importorskip("cyclonedx.validation.json")
    schema = pytest.importorskip("cyclonedx.schema")
    validator = validation.JsonStrictValidator(schema.SchemaVersion.V1_6)
    bill = bill_of_materials(installed())
    assert validator.validate_str(json.dumps(bill)) is None
    assert validator.validate_str(json.dumps(bill | {"version": "one"})) is not None


def test_the_bill_of_materials_has_each_package_and_is_the_same_again(capsys: pytest.CaptureFixture[str]) -> None:
    packages = installed()
    assert supply.main(["sbom"]) == 0
    bill = json.loads(capsys.readouterr().out)
    assert bill == bill_of_materials(installed())
    found = {c["name"]: c["version"] for c in [bill["metadata"]["component"], *bill["components"]]}
    assert found == {name: p.version for name, p in packages.items()}
    names = {d["ref"] for d in bill["dependencies"]}
    assert {ref for d in bill["dependencies"] for ref in d["dependsOn"]} <= names


def answering(folder: Path, text: str) -> tuple[str, ...]:
    """A pip-audit that says this."""
    program = folder / "audit.py"
    program.write_text(text)
    return (sys.executable, str(program))


KNOWN = '{"name": "mcap", "version": "1.6.0", "vulns": [{"id": "PYSEC-1", "fix_versions": ["1.7"]}]}'


@pytest.mark.parametrize(
    ("code", "exit_code", "said"),
    [
        (f"""print('{{"dependencies": [{KNOWN}]}}')""", 1, "mcap 1.6.0: PYSEC-1, mended in 1.7"),
        ("""print('{"dependencies": [{"name": "mcap", "version": "1", "vulns": []}]}')""", 0, "1 packages, 0 known"),
        ("""print('{"dependencies": [{"name": "mcap", "skip_reason": "?"}]}')""", 0, "skipped: the registry tells of"),
        ("import sys; sys.exit('ConnectionError: no route')", 0, "skipped: ConnectionError: no route"),
        ("import time; time.sleep(60)", 0, "skipped: no answer within 1 s"),
    ],
)
def test_the_audit(tmp_path: Path, capsys: pytest.CaptureFixture[str], code: str, exit_code: int, said: str) -> None:
    timeout_s = 1.0 if "sleep" in code else 60.0
    assert audit(LOCK, answering(tmp_path, code), timeout_s) == exit_code
    assert said in capsys.readouterr().out


def wheel(folder: Path, content: str) -> Path:
    """A package `tiny` 1.0 that can be installed."""
    file = folder / "tiny-1.0-py3-none-any.whl"
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("tiny.py", content)
        archive.writestr("tiny-1.0.dist-info/METADATA", "Metadata-Version: 2.1\nName: tiny\nVersion: 1.0\n")
        archive.writestr("tiny-1.0.dist-info/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n")
        archive.writestr("tiny-1.0.dist-info/RECORD", "")
    return file


@pytest.mark.parametrize("changed", [False, True])
def test_pip_takes_what_was_locked_and_refuses_anything_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], changed: bool
) -> None:
    digest = hashlib.sha256(wheel(tmp_path, "honest = True").read_bytes()).hexdigest()
    lock = tmp_path / "robot.lock"
    lock.write_text(f"tiny==1.0 --hash=sha256:{digest}\n")
    if changed:
        wheel(tmp_path, "honest = False")
    for name, value in (("NO_INDEX", "1"), ("FIND_LINKS", str(tmp_path)), ("TARGET", str(tmp_path / "to")),
                        ("CACHE_DIR", str(tmp_path / "cache"))):  # fmt: skip
        monkeypatch.setenv(f"PIP_{name}", value)
    if changed:
        with pytest.raises(ConfigError, match="packages as they were locked"):
            install_locked(sys.executable, lock)
        assert "DO NOT MATCH THE HASHES" in capfd.readouterr().err
    else:
        install_locked(sys.executable, lock)
    assert (tmp_path / "to/tiny.py").exists() is not changed
