"""Which system calls were refused, by name; the lines are of a 6.1 kernel and of systemd's journal."""

import ctypes
import subprocess

import pytest

from drd.cli import main
from drd.commands.refused import Refused, name, refused

X86_64 = 0xC000003E
KERNEL = (
    "audit: type=1326 audit(1795442464.597:12): auid=4294967295 uid={uid} gid=64321 ses=4294967295 subj=unconfined "
    'pid=345 comm="drd" exe="/usr/bin/python3.11" sig=0 arch=c000003e syscall={number} compat=0 ip=0x40a1 code=0x50001'
)
JOURNAL = KERNEL.replace("audit: type=1326 audit(1795442464.597:12):", "SECCOMP")


@pytest.mark.parametrize("line", [KERNEL, JOURNAL])
def test_a_refused_call_is_named(line: str) -> None:
    lines = ["usb 1-1: new device", line.format(uid=64321, number=227), line.format(uid=1000, number=227)]
    assert refused(lines) == [Refused(64321, 345, "drd", name(X86_64, 227))]


def test_the_names_are_libseccomps(monkeypatch: pytest.MonkeyPatch) -> None:
    if name(X86_64, 0) == "0":
        pytest.skip("libseccomp is not installed")
    assert (name(X86_64, 227), name(0xC00000B7, 112)) == ("clock_settime", "clock_settime")  # x86_64, aarch64
    assert name(X86_64, 9999) == "9999"

    def missing(_: str) -> object:
        raise OSError("no such library")

    monkeypatch.setattr(ctypes, "CDLL", missing)
    assert name(X86_64, 227) == "227"


def test_the_command_counts_them(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    said = "\n".join([KERNEL.format(uid=64321, number=227)] * 3)
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: subprocess.CompletedProcess([], 0, said, ""))
    assert main(["refused"]) == 0
    assert capsys.readouterr().out == f"{name(X86_64, 227)}: refused to drd, process 345, 3 times\n"
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: subprocess.CompletedProcess([], 0, "", ""))
    assert main(["refused"]) == 0
    assert "--log-refused" in capsys.readouterr().out


def test_without_a_journal_it_says_so(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("PATH", "")
    assert main(["refused"]) == 1
    assert "journalctl" in capsys.readouterr().err
