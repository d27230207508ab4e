"""Which kernel ran, and the table of faults, after the tests."""

import pytest
from vm import table


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Print the kernel, when each fault was noticed and when all was well again."""
    kernel = config.stash.get(table.KERNEL, None)
    verdicts = config.stash.get(table.VERDICTS, None)
    if kernel is None:
        return
    terminalreporter.section("virtual machine")
    terminalreporter.write_line(kernel)
    lates = ", ".join(f"{late_s:.3f}" for late_s in config.stash.get(table.LATE_S, []))
    terminalreporter.write_line(f"the gyros were late by at most {lates} s, each time that machines ran")
    for line in table.lines(verdicts) if verdicts else ():
        terminalreporter.write_line(line)
