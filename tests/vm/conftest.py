"""The table of faults, after the tests."""

import pytest
from vm import table


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Print when each fault was noticed and when all was well again."""
    verdicts = config.stash.get(table.VERDICTS, None)
    if verdicts is None:
        return
    terminalreporter.section("virtual machine")
    for line in table.lines(verdicts):
        terminalreporter.write_line(line)
