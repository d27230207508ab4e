"""Which kernel the virtual machine takes; small scripts stand for the kernels."""

import logging
from collections.abc import Callable
from pathlib import Path

import pytest
from vm import kernel
from vm.kernel import Kernel, NoKernelError

RUNS = f"""\
echo 'Run /bin/true as init process'
echo 'Kernel panic - not syncing: {kernel.RAN}'
echo ' [<6069f509>] dump_stack+0x1a/0x1c'
exit 134
"""
DIES = """\
echo 'Run /bin/true as init process'
echo 'userspace - ptrace set fp regs failed, errno = 14' >&2
echo 'Kernel panic - not syncing: Attempted to kill init! exitcode=0x00000009'
exit 134
"""
PTRACE = "userspace - ptrace set fp regs failed, errno = 14"

Make = Callable[[str, str], Callable[[], Kernel]]


@pytest.fixture
def make(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Make:
    # The namespace needs root, and a script leaves nothing behind.
    monkeypatch.setattr(kernel, "CONTAINED", ())

    def write(title: str, script: str) -> Callable[[], Kernel]:
        (tmp_path / title).write_text(script)
        return lambda: Kernel(title, ("sh", str(tmp_path / title)), tmp_path)

    return write


def never() -> Kernel:
    raise AssertionError("it was fetched although the one before runs")


def cannot_be_fetched() -> Kernel:
    raise RuntimeError("mmdebstrap sid: exit status 25\nI: running apt-get update...\nE: no such suite\nI: removing")


def test_the_first_that_runs_is_taken_and_the_next_is_not_made(
    tmp_path: Path, make: Make, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.INFO, "drd.vm"):
        chosen, sentence = kernel.choose({"installed": make("6.1", RUNS), "newer": never}, tmp_path)
    assert (chosen.title, sentence) == ("6.1", "6.1 runs")
    assert caplog.messages == ["6.1 runs"]


def test_the_next_is_taken_where_the_first_dies(tmp_path: Path, make: Make) -> None:
    chosen, sentence = kernel.choose({"installed": make("6.1", DIES), "newer": make("7.2", RUNS)}, tmp_path)
    assert (chosen.title, sentence) == ("7.2", f"7.2 runs; 6.1 does not run: {PTRACE}")


def test_where_none_runs_the_words_say_what_each_said(tmp_path: Path, make: Make) -> None:
    with pytest.raises(NoKernelError) as error:
        kernel.choose(
            {"installed": make("6.1", DIES), "newer": make("7.2", "echo 'Killed by the host'; exit 1")}, tmp_path
        )
    assert str(error.value) == f"6.1 does not run: {PTRACE}; 7.2 does not run: Killed by the host"


def test_one_that_cannot_be_fetched_is_told_in_one_line(tmp_path: Path, make: Make) -> None:
    with pytest.raises(NoKernelError) as error:
        kernel.choose({"installed": make("6.1", "exit 0"), "newer": cannot_be_fetched}, tmp_path)
    told = "the newer kernel does not run: it cannot be had: E: no such suite"
    assert str(error.value) == f"6.1 does not run: it said nothing; {told}"


def test_one_that_hangs_is_ended(tmp_path: Path, make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernel, "TIMED", ("timeout", "--kill-after=1", "0.2"))
    reason = kernel.refusal(make("6.1", "echo 'Run /bin/true'; exec sleep 60")(), tmp_path)
    assert reason == f"no end after {kernel.LIMIT_S} s, at last Run /bin/true"


@pytest.mark.parametrize(
    ("wish", "tried"), [("", ["installed", "newer"]), ("installed", ["installed"]), ("newer", ["newer"])]
)
def test_the_environment_asks_for_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, wish: str, tried: list[str]
) -> None:
    monkeypatch.setenv(kernel.WISH, wish)
    assert list(kernel.makers(tmp_path)) == tried


def test_a_wish_for_another_is_refused_in_words(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(kernel.WISH, "7.2")
    with pytest.raises(NoKernelError, match=r"DRD_VM_KERNEL is '7\.2', expected one of installed, newer"):
        kernel.makers(tmp_path)
