"""The command of the gains of `monitor.apply`."""

import pytest

from drd_tools.trial.applied import main


@pytest.mark.parametrize("option", ["--seed", "--each", "--jobs"])
def test_what_is_no_such_number_is_refused(option: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main([option, "-1"])
    assert ended.value.code == 2
    assert f"{option}: expected a whole number" in capsys.readouterr().err
